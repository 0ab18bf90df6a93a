"""What is logged, collected from the result files alone; knows nothing of MLflow."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from hybrid_dynamics.loop.diagnosis import Diagnosis
from hybrid_dynamics.strict_json import read_json
from hybrid_dynamics.study.expressions import LONGEST, to_latex
from hybrid_dynamics.study.layout import LOOP_COLUMNS, POOL, DatasetFiles
from hybrid_dynamics.study.results import DatasetResults, read_csv, read_dataset
from hybrid_dynamics.study.tracking.card import CARD_FILE, model_card
from hybrid_dynamics.study.tracking.identified import Identified, identified
from hybrid_dynamics.study.tracking.inputs import InputRecord, input_records
from hybrid_dynamics.study.tracking.registry import registered_name
from hybrid_dynamics.trajectory import SIMULATED

LOOP_METHOD = "loop"
MODEL_FILE = "model.json"
DIAGNOSIS_FILE = "diagnosis.json"
MEASURES = ("rmse", "relative_rmse")
#: What a run holds. Another number logs every result anew.
FORMAT = 2


@dataclass(frozen=True)
class StepRecord:
    """A nested run: one step of the loop (the effect that was added, the errors before and after), or a question that
    was asked with the calibrated model. ``tags["kind"]`` says which."""

    name: str
    tags: Mapping[str, str]
    metrics: Mapping[str, float]
    params: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class RunRecord:
    """One run: a dataset and a method. ``texts`` maps artifact paths to their content.

    ``digest`` covers everything that decides the result (data, model, errors, parameters), nothing that changes from
    run to run (time, git revision, timing). ``model`` is the folder of the model's files, None where there is none;
    ``is_estimator`` says that it holds an estimator of the feature matrix, which is then logged as a pyfunc.
    ``logs`` are the trajectories a closed loop was made from, None for other methods. ``finished`` and ``wall`` [s]
    are when the training ended (since the epoch) and how long it took, None where nothing was trained.
    """

    dataset: str
    method: str
    provenance: str
    digest: str
    metrics: Mapping[str, float]
    params: Mapping[str, str]
    tags: Mapping[str, str]
    texts: Mapping[str, str]
    features: Path
    model: Path | None = None
    is_estimator: bool = False
    steps: tuple[StepRecord, ...] = field(default=())
    inputs: tuple[InputRecord, ...] = ()
    logs: Path | None = None
    finished: float | None = None
    wall: float | None = None

    @property
    def registered(self) -> str | None:
        """Name in the registry: the closed loop's models have one."""
        known = self.method == LOOP_METHOD and self.logs is not None and self.model is not None
        return registered_name(self.dataset, self.provenance) if known else None

    @property
    def urdf(self) -> Path:
        """The dataset's robot."""
        return self.features.with_name("robot.urdf")


def collect(
    data: Path,
    datasets: Sequence[str],
    params: Mapping[str, Mapping[str, Any]] | None = None,
    loop: Path | None = None,
) -> list[RunRecord]:
    """Records of every method of every dataset below ``data``.

    ``params`` maps a method to its parameters; ``loop`` is ``reports/loop.csv`` (its rows become nested runs of the
    method ``loop``). Raises :class:`InputError` naming a result file that is missing.
    """
    rows = read_csv(loop, LOOP_COLUMNS) if loop is not None and loop.exists() else None
    return [record for name in datasets for record in _dataset(read_dataset(data / name), params or {}, rows)]


def _dataset(
    result: DatasetResults, params: Mapping[str, Mapping[str, Any]], loop: pd.DataFrame | None
) -> Iterator[RunRecord]:
    features, logs = result.folder / "features.parquet", _logs(result)
    digests = {path: file_digest(path) for path in {features, logs} if path.exists()}
    for method in result.methods:
        errors = result.errors[result.errors["method"] == method]
        expressions = result.expressions[result.expressions["method"] == method]
        folder = result.folder / "models" / method
        chosen = texts_of(params.get(method, {}))
        closed = _closed(result, folder / DIAGNOSIS_FILE, loop) if method == LOOP_METHOD else _Closed()
        data = logs if closed.diagnosis is not None else features
        inputs = input_records(data, digests[data], result.name, result.provenance, result.source)
        measures = {key: value for key, value in _error_metrics(errors) if math.isfinite(value)}
        texts = dict(_expression_texts(expressions))
        if closed.diagnosis is not None:
            name = registered_name(result.name, result.provenance)
            texts[CARD_FILE] = model_card(name, closed.diagnosis, result.provenance, inputs, measures)
        timing = _timing(result.folder / "timing" / f"{method}.json")
        yield RunRecord(
            dataset=result.name,
            method=method,
            provenance=result.provenance,
            digest=result_digest(result.name, method, digests[data], measures, chosen, folder, closed.steps),
            metrics={**measures, **closed.found.metrics, **timing.metrics},
            params={"dataset": result.name, "method": method, **chosen, **closed.found.params},
            tags={
                **closed.found.tags,
                "provenance": result.provenance,
                "data_digest": digests[data],
                "robot": result.robot,
            },
            texts=texts,
            features=features,
            model=folder if (folder / MODEL_FILE).exists() else None,
            is_estimator=_is_estimator(folder / MODEL_FILE),
            steps=closed.steps,
            inputs=inputs,
            logs=data if closed.diagnosis is not None else None,
            finished=timing.finished,
            wall=timing.wall,
        )


@dataclass(frozen=True)
class _Closed:
    """What only a closed loop has: its diagnosis, that as metrics and tags, its nested runs."""

    diagnosis: Diagnosis | None = None
    found: Identified = field(default_factory=lambda: Identified({}, {}, {}))
    steps: tuple[StepRecord, ...] = ()


def _closed(result: DatasetResults, path: Path, loop: pd.DataFrame | None) -> _Closed:
    steps = tuple(_steps(loop[loop["dataset"] == result.name])) if loop is not None else ()
    steps += tuple(_questions(result.folder / "questions"))
    if not path.exists():
        return _Closed(steps=steps)
    diagnosis = read_diagnosis(path)
    return _Closed(diagnosis, identified(diagnosis), steps)


def _logs(result: DatasetResults) -> Path:
    """What the loop reads: for simulated data the derivatives, which put torque and state at one instant."""
    files = DatasetFiles(result.name)
    return result.folder / (files.derivatives if result.provenance == SIMULATED else files.trajectories).name


@dataclass(frozen=True)
class _Timing:
    metrics: Mapping[str, float]
    finished: float | None = None
    wall: float | None = None


def _timing(path: Path) -> _Timing:
    """How long the training took, and when it ended (when its file was written, where that does not say)."""
    if not path.exists():
        return _Timing({})
    value = read_json(path, "the timing that a training stage writes")
    measures = {f"training/{key}": float(value[key]) for key in ("wall_s", "peak_memory_mb") if key in value}
    return _Timing(measures, float(value.get("finished", path.stat().st_mtime)), value.get("wall_s"))


def read_diagnosis(path: Path) -> Diagnosis:
    """What a closed loop found; :class:`InputError` names a file that is missing or no diagnosis."""
    return Diagnosis.from_json(read_json(path, "the diagnosis.json that close_loop writes"))


def _questions(folder: Path) -> Iterator[StepRecord]:
    for path in sorted(folder.glob(f"*/{DIAGNOSIS_FILE}")):
        name, found = path.parent.name, identified(read_diagnosis(path))
        tags = {**found.tags, "kind": "question", "question": name}
        yield StepRecord(f"question: {name}", tags, found.metrics, found.params)


def _is_estimator(path: Path) -> bool:
    """Whether ``path`` is a model of :mod:`hybrid_dynamics.models` (the loop's model needs the robot and time)."""
    if not path.exists():
        return False
    document = json.loads(path.read_text("utf-8"))
    return isinstance(document.get("model"), dict) and "kind" in document["model"]


def _error_metrics(errors: pd.DataFrame) -> Iterator[tuple[str, float]]:
    pool = errors[errors["trajectory"] == POOL]
    for row in pool.to_dict("records"):
        for measure in MEASURES:
            yield f"{row['split']}/{measure}/joint{row['joint']}", float(row[measure])
        yield f"{row['split']}/relative_error", float(row["relative_error"])


def _expression_texts(expressions: pd.DataFrame) -> Iterator[tuple[str, str]]:
    for row in expressions.itertuples():
        text = str(row.expression)
        yield f"expressions/joint{row.joint}.txt", text + "\n"
        # A long polynomial is no formula to print; its text is there.
        if len(text) <= LONGEST:
            yield f"expressions/joint{row.joint}.tex", to_latex(text) + "\n"


def _steps(rows: pd.DataFrame) -> Iterator[StepRecord]:
    for (step, effect, joints), own in rows.fillna({"effect_joints": ""}).groupby(
        ["step", "effect", "effect_joints"], sort=True
    ):
        metrics = {}
        pool = own[own["trajectory"] == POOL]
        for row in (pool if len(pool) else own).itertuples():
            run = "" if len(pool) else f"/{row.trajectory}"
            for measure in ("rmse_before", "rmse_after"):
                value = float(getattr(row, measure))
                if math.isfinite(value):
                    metrics[f"{row.split}/{measure}{run}/joint{row.joint}"] = value
        tags = {"kind": "step", "step": str(step), "effect": str(effect), "effect_joints": str(joints)}
        yield StepRecord(f"step {step}: {effect} {joints}".strip(), tags, metrics)


def file_digest(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def result_digest(
    dataset: str,
    method: str,
    data: str,
    metrics: Mapping[str, float],
    params: Mapping[str, str],
    model: Path,
    steps: Sequence[StepRecord],
) -> str:
    """What decides a result, as one number: ``data`` is a digest, ``model`` the folder of its files."""
    content = {
        "format": FORMAT,
        "run": [dataset, method],
        "data": data,
        "metrics": {key: repr(value) for key, value in metrics.items()},
        "params": dict(params),
        "model": {
            str(path.relative_to(model)): file_digest(path) for path in sorted(model.rglob("*")) if path.is_file()
        },
        "steps": [[step.name, {key: repr(value) for key, value in step.metrics.items()}] for step in steps],
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def texts_of(values: Mapping[str, Any]) -> dict[str, str]:
    """Nested parameters as MLflow takes them: ``a.b.c`` -> text."""
    return {key: _text(value) for key, value in flatten(values).items()}


def flatten(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested parameters as ``a.b.c`` -> value."""
    out: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            out |= flatten(value, f"{prefix}{key}.")
        else:
            out[f"{prefix}{key}"] = value
    return out


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, default=str)
