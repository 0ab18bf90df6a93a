"""Models as MLflow's pyfuncs: a script of this package beside the model's own files; nothing is pickled."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Collection
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.parquet as pq

from hybrid_dynamics.features import feature_names
from hybrid_dynamics.study.tracking.card import CARD_FILE
from hybrid_dynamics.study.tracking.records import MODEL_FILE, RunRecord
from hybrid_dynamics.study.tracking.registry import crown, held_out_error, register
from hybrid_dynamics.trajectory import iter_trajectories
from hybrid_dynamics.types import Notify

SCRIPT = Path(__file__).with_name("torque_model.py")
LOOP_SCRIPT = Path(__file__).with_name("loop_model.py")
EXAMPLE_ROWS = 5
#: Of a log: enough for the loop's filter at 100 Hz and above.
EXAMPLE_SAMPLES = 400


def log_models(client: Any, run_id: str, record: RunRecord, notify: Notify) -> list[Any]:
    """The model as a pyfunc; of a closed loop a version in the registry too. Tags that say which."""
    from mlflow.entities import RunTag

    if record.model is None:
        return []
    if record.is_estimator:
        _log_estimator(run_id, record)
        return []
    name = record.registered
    if name is None or record.logs is None:
        return []
    logged = _log_loop(run_id, record, record.logs)
    error = held_out_error(record.model / MODEL_FILE, record.urdf, record.logs)
    tags = {key: record.tags[key] for key in ("provenance", "data_digest", "verdict")}
    version = register(client, name, logged, run_id, record.texts[CARD_FILE], tags, error)
    crown(client, name, version, error, record.logs, notify)
    if math.isfinite(error):
        client.log_metric(run_id, "held_out/relative_error", error)
    return [RunTag("registered_model", name), RunTag("registered_version", version)]


def _log_estimator(run_id: str, record: RunRecord) -> None:
    from hybrid_dynamics.study.tracking.torque_model import load, predict_frame

    assert record.model is not None
    example = _example(record.features)
    _pyfunc(run_id, SCRIPT, {"model": str(record.model)}, example, predict_frame(load(record.model), example))


def _log_loop(run_id: str, record: RunRecord, logs: Path) -> Any:
    """The closed loop's model as a pyfunc over a log: model.json, the URDF, the model card."""
    from hybrid_dynamics.loop.model import load_model
    from hybrid_dynamics.robots import Robot
    from hybrid_dynamics.study.tracking.loop_model import torque_frame

    assert record.model is not None
    example = _log_example(logs)
    torque = torque_frame(load_model(record.model / MODEL_FILE, Robot.from_urdf(record.urdf)), example)
    with tempfile.TemporaryDirectory() as folder:
        card = Path(folder) / CARD_FILE
        card.write_text(record.texts[CARD_FILE], "utf-8")
        files = {"model": str(record.model / MODEL_FILE), "robot": str(record.urdf), "card": str(card)}
        # Speed is taken where it is measured; a log without it is predicted too.
        speeds = [column for column in example.columns if column.startswith("dq")]
        return _pyfunc(run_id, LOOP_SCRIPT, files, example, torque, speeds)


def _pyfunc(
    run_id: str,
    script: Path,
    files: dict[str, str],
    example: pd.DataFrame,
    answer: pd.DataFrame,
    optional: Collection[str] = (),
) -> Any:
    """Log a model whose input looks like ``example`` and its output like ``answer``, numbers throughout."""
    import mlflow
    from mlflow.models import ModelSignature
    from mlflow.types import ColSpec, Schema

    inputs = Schema([ColSpec("double", name, required=name not in optional) for name in example.columns])
    signature = ModelSignature(inputs, Schema([ColSpec("double", name) for name in answer.columns]))
    with mlflow.start_run(run_id=run_id):
        return mlflow.pyfunc.log_model(
            name="model",
            python_model=str(script),
            artifacts=files,
            signature=signature,
            input_example=example,
            pip_requirements=["hybrid-dynamics"],
        )


def _log_example(logs: Path) -> pd.DataFrame:
    """The beginning of the first run of ``logs``: time, position, and speed where it is measured."""
    run = next(iter_trajectories(logs))
    columns = {"time": run.time[:EXAMPLE_SAMPLES]}
    for name in ("q", "dq"):
        if name in run:
            columns |= {f"{name}{j + 1}": run[name][:EXAMPLE_SAMPLES, j] for j in range(run.n_joints)}
    return pd.DataFrame(columns)


def _example(features: Path) -> pd.DataFrame:
    """The first rows of the features, in the order the estimators expect."""
    file = pq.ParquetFile(features)
    n_joints = sum(name.startswith("tau_gravity") for name in file.schema_arrow.names)
    columns = list(feature_names(n_joints))
    first: pd.DataFrame = next(file.iter_batches(batch_size=EXAMPLE_ROWS, columns=columns)).to_pandas()
    return first[columns]
