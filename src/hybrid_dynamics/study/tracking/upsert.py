"""Writing records to MLflow: a run for each digest that is not there yet. MLflow is imported only if there is one."""

from __future__ import annotations

import fcntl
import logging
import os
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.parquet as pq

from hybrid_dynamics.features import feature_names
from hybrid_dynamics.study.tracking.location import Store, git_revision
from hybrid_dynamics.study.tracking.records import RunRecord
from hybrid_dynamics.types import Notify

DIGEST_TAG = "result_digest"
#: ``true`` on the newest run of a dataset and method: filter the comparison by it.
LATEST_TAG = "latest"
EXAMPLE_ROWS = 5
NOTE = (
    "One run per dataset and method, logged from the result files of the pipeline. Filter by tags.latest = 'true' for "
    "the newest results; metrics are named split/measure/joint."
)
SCRIPT = Path(__file__).with_name("torque_model.py")


def known_digests(store: Store) -> set[str]:
    """Digests of the results that are logged, read from the database without importing MLflow (a second saved).

    Empty where there is no database yet, or none that can be read this way: then MLflow itself is asked.
    """
    if not store.database.exists():
        return set()
    query = (
        "SELECT t.value FROM tags t JOIN runs r ON r.run_uuid = t.run_uuid "
        "WHERE t.key = ? AND r.lifecycle_stage = 'active'"
    )
    with closing(sqlite3.connect(f"file:{store.database}?mode=ro", uri=True)) as connection:
        try:
            return {row[0] for row in connection.execute(query, (DIGEST_TAG,))}
        except sqlite3.DatabaseError:
            return set()


def upsert(
    records: Sequence[RunRecord],
    store: Store,
    notify: Notify = print,
    code: str | os.PathLike[str] = ".",
) -> list[RunRecord]:
    """Log every record whose digest is not logged yet; returns those that were. ``code`` is the checkout that ran."""
    known = known_digests(store)
    missing = [record for record in records if record.digest not in known]
    if not missing:
        return []
    with _locked(store):
        client = _client(store)
        experiment = _experiment(client, store)
        tags = _common_tags(code)
        logged = []
        for record in missing:
            if client.search_runs([experiment], f"tags.{DIGEST_TAG} = '{record.digest}'", max_results=1):
                continue
            _log(client, experiment, record, tags)
            logged.append(record)
            notify(f"mlflow: {record.dataset} {record.method}")
    return logged


@contextmanager
def _locked(store: Store) -> Iterator[None]:
    """One writer at a time: the first initialises the database, the others find it ready."""
    store.database.parent.mkdir(parents=True, exist_ok=True)
    with store.lock.open("w") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        yield


def _client(store: Store) -> Any:
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")
    os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
    import mlflow

    logging.getLogger("mlflow").setLevel(logging.WARNING)

    mlflow.set_tracking_uri(store.uri)
    return mlflow.MlflowClient(store.uri)


def _experiment(client: Any, store: Store) -> str:
    found = client.get_experiment_by_name(store.experiment)
    if found is not None:
        return str(found.experiment_id)
    location = (store.artifacts / store.experiment).resolve().as_uri()
    # The kind decides which columns and views MLflow's page opens with.
    tags = {"mlflow.experimentKind": "custom_model_development", "mlflow.note.content": NOTE}
    return str(client.create_experiment(store.experiment, artifact_location=location, tags=tags))


def _common_tags(code: str | os.PathLike[str]) -> dict[str, str]:
    revision = git_revision(code)
    tags = {"git_revision": revision, "mlflow.source.type": "LOCAL", "mlflow.source.name": "dvc repro"}
    if revision != "unknown":
        tags["mlflow.source.git.commit"] = revision.removesuffix("-dirty")
    experiment = os.environ.get("DVC_EXP_NAME")
    return {**tags, "dvc_experiment": experiment} if experiment else tags


def _log(client: Any, experiment: str, record: RunRecord, tags: dict[str, str]) -> None:
    """One finished run. The digest is written last: a run that broke off is logged again, not taken for complete."""
    from mlflow.entities import RunTag

    name = f"{record.dataset} {record.method}"
    run = client.create_run(
        experiment,
        run_name=name,
        tags={**tags, **record.tags, "dataset": record.dataset, "method": record.method},
    )
    run_id = run.info.run_id
    _batch(client, run_id, record.metrics, record.params)
    for path, text in record.texts.items():
        client.log_text(run_id, text, path)
    if record.model is not None:
        client.log_artifacts(run_id, str(record.model), "result")
        if record.is_estimator:
            _log_model(run_id, record)
    for step in record.steps:
        nested = client.create_run(
            experiment, run_name=step.name, tags={**tags, **step.tags, "mlflow.parentRunId": run_id}
        )
        _batch(client, nested.info.run_id, step.metrics, {})
        client.set_terminated(nested.info.run_id)
    client.set_terminated(run_id)
    older = client.search_runs(
        [experiment],
        f"tags.dataset = '{record.dataset}' AND tags.method = '{record.method}' AND tags.{LATEST_TAG} = 'true'",
    )
    for other in older:
        client.set_tag(other.info.run_id, LATEST_TAG, "false")
    client.log_batch(run_id, tags=[RunTag(LATEST_TAG, "true"), RunTag(DIGEST_TAG, record.digest)])


def _batch(client: Any, run_id: str, metrics: Any, params: Any) -> None:
    from mlflow.entities import Metric, Param

    client.log_batch(
        run_id,
        metrics=[Metric(key, value, timestamp=0, step=0) for key, value in metrics.items()],
        params=[Param(key, value) for key, value in params.items()],
    )


def _log_model(run_id: str, record: RunRecord) -> None:
    """The estimator as a pyfunc: a script of this package and the model's own files; nothing is pickled."""
    import mlflow
    from mlflow.models import infer_signature

    from hybrid_dynamics.study.tracking.torque_model import load, predict_frame

    assert record.model is not None
    example = _example(record.features)
    signature = infer_signature(example, predict_frame(load(record.model), example))
    with mlflow.start_run(run_id=run_id):
        mlflow.pyfunc.log_model(
            name="model",
            python_model=str(SCRIPT),
            artifacts={"model": str(record.model)},
            signature=signature,
            input_example=example,
            pip_requirements=["hybrid-dynamics"],
        )


def _example(features: Path) -> pd.DataFrame:
    """The first rows of the features, in the order the estimators expect."""
    file = pq.ParquetFile(features)
    n_joints = sum(name.startswith("tau_gravity") for name in file.schema_arrow.names)
    columns = list(feature_names(n_joints))
    return next(file.iter_batches(batch_size=EXAMPLE_ROWS, columns=columns)).to_pandas()[columns]
