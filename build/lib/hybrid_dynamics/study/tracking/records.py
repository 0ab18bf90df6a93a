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

from hybrid_dynamics.study.expressions import LONGEST, to_latex
from hybrid_dynamics.study.layout import LOOP_COLUMNS, POOL
from hybrid_dynamics.study.results import DatasetResults, read_csv, read_dataset

LOOP_METHOD = "loop"
MODEL_FILE = "model.json"
MEASURES = ("rmse", "relative_rmse")


@dataclass(frozen=True)
class StepRecord:
    """One step of the loop, a nested run: the effect that was added and the errors before and after."""

    name: str
    tags: Mapping[str, str]
    metrics: Mapping[str, float]


@dataclass(frozen=True)
class RunRecord:
    """One run: a dataset and a method. ``texts`` maps artifact paths to their content.

    ``digest`` covers everything that decides the result (data, model, errors, parameters), nothing that changes from
    run to run (time, git revision, timing). ``model`` is the folder of the model's files, None where there is none;
    ``is_estimator`` says that it holds an estimator of the feature matrix, which is then logged as a pyfunc.
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
    data_digest = file_digest(result.folder / "features.parquet")
    timing: dict[str, Any] = {str(row.method): row for row in result.timing.itertuples()}
    for method in result.methods:
        errors = result.errors[result.errors["method"] == method]
        folder = result.folder / "models" / method
        chosen = {key: _text(value) for key, value in flatten(params.get(method, {})).items()}
        steps: tuple[StepRecord, ...] = ()
        if loop is not None and method == LOOP_METHOD:
            steps = tuple(_steps(loop[loop["dataset"] == result.name]))
        metrics = dict(_error_metrics(errors))
        digest = _digest(result.name, method, data_digest, metrics, chosen, folder, steps)
        if method in timing:
            metrics |= {f"training/{key}": float(getattr(timing[method], key)) for key in ("wall_s", "peak_memory_mb")}
        yield RunRecord(
            dataset=result.name,
            method=method,
            provenance=result.provenance,
            digest=digest,
            metrics={key: value for key, value in metrics.items() if math.isfinite(value)},
            params={"dataset": result.name, "method": method, **chosen},
            tags={"provenance": result.provenance, "data_digest": data_digest, "robot": result.robot},
            texts=dict(_expression_texts(result.expressions[result.expressions["method"] == method])),
            features=result.folder / "features.parquet",
            model=folder if (folder / MODEL_FILE).exists() else None,
            is_estimator=_is_estimator(folder / MODEL_FILE),
            steps=steps,
        )


def _is_estimator(path: Path) -> bool:
    """Whether ``path`` is a model of :mod:`hybrid_dynamics.models` (the loop's model needs the robot and time)."""
    if not path.exists():
        return False
    document = json.loads(path.read_text("utf-8"))
    return isinstance(document.get("model"), dict) and "kind" in document["model"]


def _error_metrics(errors: pd.DataFrame) -> Iterator[tuple[str, float]]:
    pool = errors[errors["trajectory"] == POOL]
    for row in pool.itertuples():
        for measure in MEASURES:
            yield f"{row.split}/{measure}/joint{row.joint}", float(getattr(row, measure))
        yield f"{row.split}/relative_error", float(row.relative_error)


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
        tags = {"step": str(step), "effect": str(effect), "effect_joints": str(joints)}
        yield StepRecord(f"step {step}: {effect} {joints}".strip(), tags, metrics)


def file_digest(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _digest(
    dataset: str,
    method: str,
    data: str,
    metrics: Mapping[str, float],
    params: Mapping[str, str],
    model: Path,
    steps: Sequence[StepRecord],
) -> str:
    content = {
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
