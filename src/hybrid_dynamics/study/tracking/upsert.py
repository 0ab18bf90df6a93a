"""Writing records to MLflow: a run for each digest that is not there yet. MLflow is imported only if there is one."""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import os
import sqlite3
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from typing import Any

from hybrid_dynamics.study.tracking.location import Store, git_revision, make_relative
from hybrid_dynamics.study.tracking.logged_models import log_models
from hybrid_dynamics.study.tracking.records import RunRecord
from hybrid_dynamics.types import Notify

DIGEST_TAG = "result_digest"
#: ``true`` on the newest run of a dataset and method and on its nested runs: filter the comparison by it.
LATEST_TAG = "latest"
#: ``result`` or, of a nested run, ``step`` or ``question``.
KIND_TAG = "kind"
#: What MLflow takes at once.
MOST_METRICS, MOST_PARAMS = 1000, 100
NOTE = (
    "One run per dataset and method, logged from the result files of the pipeline. Filter by tags.latest = 'true' and "
    "tags.kind = 'result' for the newest results. Metrics are named split/measure/joint; what a closed loop identified "
    "is parameter/effect/place/name with std_error/... beside it. Start and duration are those of the training."
)


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
    missing = [_absolute(record) for record in missing]
    revision = _common_tags(code)
    # Artifacts lie at paths relative to the root, so that they move with it.
    with _locked(store), contextlib.chdir(store.database.parent):
        client = _client(store)
        experiment = _experiment(client, store)
        logged = []
        for record in missing:
            if client.search_runs([experiment], f"tags.{DIGEST_TAG} = '{record.digest}'", max_results=1):
                continue
            _log(client, experiment, record, revision, notify)
            logged.append(record)
            notify(f"mlflow: {record.dataset} {record.method}")
    return logged


def _absolute(record: RunRecord) -> RunRecord:
    """The same record, whose files are found from anywhere."""
    places = {name: path.resolve() for name in ("features", "model", "logs") if (path := getattr(record, name))}
    return replace(record, **places)


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
    if found is None:
        # The kind decides which columns and views MLflow's page opens with.
        tags = {"mlflow.experimentKind": "custom_model_development", "mlflow.note.content": NOTE}
        own = client.create_experiment(store.experiment, artifact_location=store.location, tags=tags)
        found = client.get_experiment(own)
    if found.artifact_location != store.location:
        make_relative(store, str(found.experiment_id), found.artifact_location)
    return str(found.experiment_id)


def _common_tags(code: str | os.PathLike[str]) -> dict[str, str]:
    revision = git_revision(code)
    tags = {"git_revision": revision, "mlflow.source.type": "LOCAL", "mlflow.source.name": "dvc repro"}
    if revision != "unknown":
        tags["mlflow.source.git.commit"] = revision.removesuffix("-dirty")
    experiment = os.environ.get("DVC_EXP_NAME")
    return {**tags, "dvc_experiment": experiment} if experiment else tags


def _log(client: Any, experiment: str, record: RunRecord, tags: dict[str, str], notify: Notify) -> None:
    """One finished run. The digest is written last: a run that broke off is logged again, not taken for complete."""
    from mlflow.entities import RunTag

    own = {**tags, **record.tags, "dataset": record.dataset, "method": record.method, KIND_TAG: "result"}
    start, end = _times(record)
    run = client.create_run(experiment, start_time=start, run_name=f"{record.dataset} {record.method}", tags=own)
    run_id = run.info.run_id
    _batch(client, run_id, record.metrics, record.params, end)
    _inputs(client, run_id, record)
    for path, text in record.texts.items():
        client.log_text(run_id, text, path)
    if record.model is not None:
        client.log_artifacts(run_id, str(record.model), "result")
    crowned = log_models(client, run_id, record, notify)
    nested = []
    for step in record.steps:
        # A step has no time of its own: it stands where the training ended, without a duration.
        child = client.create_run(
            experiment, start_time=end, run_name=step.name, tags={**own, **step.tags, "mlflow.parentRunId": run_id}
        )
        _batch(client, child.info.run_id, step.metrics, step.params, end)
        client.set_terminated(child.info.run_id, end_time=end)
        nested.append(child.info.run_id)
    client.set_terminated(run_id, end_time=end)
    for other in _all_runs(
        client,
        experiment,
        f"tags.dataset = '{record.dataset}' AND tags.method = '{record.method}' AND tags.{LATEST_TAG} = 'true'",
    ):
        client.set_tag(other.info.run_id, LATEST_TAG, "false")
    for child_id in nested:
        client.set_tag(child_id, LATEST_TAG, "true")
    client.log_batch(run_id, tags=[*crowned, RunTag(LATEST_TAG, "true"), RunTag(DIGEST_TAG, record.digest)])


def _times(record: RunRecord) -> tuple[int, int]:
    """Start and end of the training [ms since the epoch]; of a method without training, now."""
    end = time.time() if record.finished is None else record.finished
    return round(1000 * (end - (record.wall or 0.0))), round(1000 * end)


def _all_runs(client: Any, experiment: str, query: str) -> list[Any]:
    found, token = [], None
    while True:
        page = client.search_runs([experiment], query, page_token=token)
        found += page
        token = page.token
        if not token:
            return found


def _batch(client: Any, run_id: str, metrics: Mapping[str, float], params: Mapping[str, str], at: int) -> None:
    from mlflow.entities import Metric, Param

    values = [Metric(key, value, timestamp=at, step=0) for key, value in metrics.items()]
    texts = [Param(key, value) for key, value in params.items()]
    for k in range(0, len(values), MOST_METRICS):
        client.log_batch(run_id, metrics=values[k : k + MOST_METRICS])
    for k in range(0, len(texts), MOST_PARAMS):
        client.log_batch(run_id, params=texts[k : k + MOST_PARAMS])


def _inputs(client: Any, run_id: str, record: RunRecord) -> None:
    """The data a result was made from, as MLflow's dataset inputs."""
    from mlflow.entities import Dataset, DatasetInput, InputTag

    client.log_inputs(
        run_id,
        [
            DatasetInput(
                Dataset(
                    name=own.name,
                    digest=own.digest,
                    source_type="local",
                    source=json.dumps({"uri": own.source}),
                    schema=own.schema,
                    profile=own.profile,
                ),
                [InputTag("mlflow.data.context", own.context)],
            )
            for own in record.inputs
        ],
    )
