"""MLflow: one run per dataset and method, upserted by digest, models without pickle, a database that stays put."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.reporting_study import write_dataset

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.features import feature_names
from hybrid_dynamics.files import write_json
from hybrid_dynamics.study.layout import LOOP_COLUMNS
from hybrid_dynamics.study.tracking import collect, known_digests, root, store, upsert
from hybrid_dynamics.study.tracking.records import RunRecord, flatten


def test_the_database_is_at_the_root_of_the_main_repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DVC_ROOT", raising=False)
    main = tmp_path / "project"
    (main / ".dvc").mkdir(parents=True)
    (main / "stages").mkdir()
    assert root(main) == root(main / "stages") == main
    copy = main / ".dvc" / "tmp" / "exps" / "tmpabc" / "stages"
    (copy.parent / ".dvc").mkdir(parents=True)
    copy.mkdir()
    assert root(copy) == main
    assert store(copy).database == main / "mlflow.db"
    monkeypatch.setenv("DVC_ROOT", str(copy.parent))  # as a stage in the copy would see it without DVC's own override
    assert root(copy) == main
    monkeypatch.setenv("DVC_ROOT", str(main))
    assert root(copy) == main
    other = tmp_path / "other"
    (other / ".dvc").mkdir(parents=True)
    monkeypatch.setenv("DVC_ROOT", str(other))
    assert root(main) == main  # a stale variable does not lead a run elsewhere
    assert root(tmp_path / "nowhere") == tmp_path / "nowhere"


def test_a_git_worktree_belongs_to_its_main_checkout(tmp_path: Path) -> None:
    def git(*arguments: str) -> None:
        identity = ["-c", "user.name=t", "-c", "user.email=t@localhost"]
        subprocess.run(["git", *identity, "-C", str(tmp_path / "main"), *arguments], check=True, capture_output=True)

    (tmp_path / "main").mkdir()
    git("init", "-q")
    git("commit", "-q", "--allow-empty", "-m", "start")
    git("worktree", "add", "-q", str(tmp_path / "tree"))
    assert root(tmp_path / "tree") == tmp_path / "main"


def test_nested_parameters_are_flattened() -> None:
    assert flatten({"a": 1, "b": {"c": [1, 2], "d": {"e": None}}}) == {"a": 1, "b.c": [1, 2], "b.d.e": None}


def loop_rows(folder: Path) -> Path:
    rows = [
        ("panda", "simulated", step, effect, joint, "test", "all", j, 1.0 / step, 0.5 / step)
        for step, effect, joint in ((1, "viscous_friction", "panda_joint1"), (2, "payload", ""))
        for j in (1, 2)
    ]
    path = folder / "loop.csv"
    pd.DataFrame(rows, columns=list(LOOP_COLUMNS)).to_csv(path, index=False)
    return path


def as_loop(data: Path) -> None:
    """Turn the network's errors into those of the loop, whose model needs more than the features."""
    path = data / "panda" / "errors.parquet"
    errors = pd.read_parquet(path)
    errors.loc[errors["method"] == "nn", "method"] = "loop"
    errors[errors["method"].isin(["rigid_body", "sr", "loop"])].to_parquet(path)
    (data / "panda" / "models" / "nn").rename(data / "panda" / "models" / "loop")
    write_json(data / "panda" / "models" / "loop" / "model.json", {"schema": 1, "effects": []})


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tracked")
    write_dataset(folder / "data" / "panda", runs=(1, 1))
    as_loop(folder / "data")
    loop_rows(folder)
    return folder


def records(project: Path, threshold: float = 0.01) -> list[RunRecord]:
    return collect(project / "data", ["panda"], {"sr": {"sindy": {"threshold": threshold}}}, project / "loop.csv")


def test_a_record_holds_what_the_files_say(project: Path) -> None:
    by_method = {record.method: record for record in records(project)}
    assert set(by_method) == {"rigid_body", "sr", "loop"}
    sr = by_method["sr"]
    assert sr.metrics["test/relative_rmse/joint3"] < 5e-4 < by_method["rigid_body"].metrics["test/relative_rmse/joint3"]
    assert {"train/relative_error", "test/rmse/joint7", "training/wall_s"} <= set(sr.metrics)
    assert sr.params == {"dataset": "panda", "method": "sr", "sindy.threshold": "0.01"}
    assert r"\dot{q}_{1}" in sr.texts["expressions/joint1.tex"]
    assert "tau_inertia1" in sr.texts["expressions/joint1.txt"]
    assert sr.tags["provenance"] == "simulated"
    assert len(sr.tags["data_digest"]) == 64
    assert sr.is_estimator
    assert not by_method["loop"].is_estimator
    assert [step.tags["effect"] for step in by_method["loop"].steps] == ["viscous_friction", "payload"]
    assert by_method["loop"].steps[1].metrics["test/rmse_after/joint2"] == 0.25


def test_the_digest_follows_the_result_and_nothing_else(project: Path) -> None:
    before = {record.method: record.digest for record in records(project)}
    timing = project / "data" / "panda" / "timing" / "sr.json"
    kept = timing.read_text()
    write_json(timing, {"wall_s": 99.0, "peak_memory_mb": 1.0})
    assert {record.method: record.digest for record in records(project)} == before
    timing.write_text(kept)
    model = project / "data" / "panda" / "models" / "sr" / "model.json"
    kept = model.read_text()
    model.write_text(kept + "\n")
    changed = {record.method: record.digest for record in records(project)}
    assert [method for method in before if changed[method] != before[method]] == ["sr"]
    model.write_text(kept)
    other = {record.method: record.digest for record in records(project, threshold=0.02)}
    assert [method for method in before if other[method] != before[method]] == ["sr"]
    with pytest.raises(InputError, match=r"errors\.parquet"):
        collect(project / "data", ["wam"])


@pytest.fixture(scope="module")
def logged(project: Path) -> Path:
    """The project after one upsert by two processes at once on a database that did not exist."""
    program = (
        "import sys; from pathlib import Path; sys.path[:0] = [sys.argv[2]]\n"
        "from test_tracking import records; from hybrid_dynamics.study.tracking import Store, upsert\n"
        "p = Path(sys.argv[1]); s = Store(p / 'mlflow.db', p / 'mlartifacts')\n"
        "print(len(upsert(records(p), s, notify=lambda _: None)))"
    )
    arguments = [sys.executable, "-c", program, str(project), str(Path(__file__).parent)]
    both = [subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    counts = [int(process.communicate(timeout=240)[0]) for process in both]
    assert sum(counts) == 3
    return project


def test_each_result_is_one_run_however_many_write(logged: Path) -> None:
    mlflow = pytest.importorskip("mlflow")
    target = store(logged)
    client = mlflow.MlflowClient(target.uri)
    experiment = client.get_experiment_by_name(target.experiment)
    assert experiment.artifact_location == "mlartifacts/hybrid_dynamics"
    runs = client.search_runs([experiment.experiment_id])
    parents = {run.data.tags["method"]: run for run in runs if run.data.tags["kind"] == "result"}
    assert set(parents) == {"rigid_body", "sr", "loop"}
    assert all(run.info.status == "FINISHED" for run in runs)
    assert all(run.data.tags["latest"] == "true" for run in parents.values())
    nested = [run for run in runs if run.data.tags.get("mlflow.parentRunId") == parents["loop"].info.run_id]
    assert sorted(run.data.tags["effect"] for run in nested) == ["payload", "viscous_friction"]
    shared = ("dataset", "method", "provenance", "data_digest", "robot", "git_revision", "latest")
    parent = parents["loop"].data.tags
    assert [[run.data.tags[key] for key in shared] for run in nested] == [[parent[key] for key in shared]] * 2
    assert known_digests(target) == {record.digest for record in records(logged)}


def test_unchanged_results_are_not_logged_and_mlflow_is_not_even_imported(logged: Path) -> None:
    program = (
        "import sys; from pathlib import Path; sys.path[:0] = [sys.argv[2]]\n"
        "from test_tracking import records; from hybrid_dynamics.study.tracking import Store, upsert\n"
        "p = Path(sys.argv[1]); s = Store(p / 'mlflow.db', p / 'mlartifacts')\n"
        "print(len(upsert(records(p), s)), 'mlflow' in sys.modules)"
    )
    arguments = [sys.executable, "-c", program, str(logged), str(Path(__file__).parent)]
    assert subprocess.run(arguments, capture_output=True, text=True, check=True).stdout.split() == ["0", "False"]


def test_the_model_comes_back_without_pickle_and_predicts_the_same(logged: Path) -> None:
    mlflow = pytest.importorskip("mlflow")
    assert not [path for path in (logged / "mlartifacts").rglob("*") if path.suffix in (".pkl", ".pickle", ".joblib")]
    models = [json.loads(p.read_text()) for p in (logged / "mlartifacts").rglob("serving_input_example.json")]
    assert len(models) == 2  # rigid_body and sr; the loop's model needs the robot
    folders = [path.parent for path in (logged / "mlartifacts").rglob("MLmodel")]
    columns = list(feature_names(7))
    example = pd.read_parquet(logged / "data" / "panda" / "features.parquet")[columns].iloc[:4]
    for folder in folders:
        loaded = mlflow.pyfunc.load_model(str(folder))
        assert loaded.metadata.signature.inputs.input_names()[:2] == ["q1", "q2"]
        torque = loaded.predict(example[columns[::-1]])
        rigid = example.to_numpy()[:, 28:].reshape(-1, 3, 7).sum(axis=1)
        np.testing.assert_allclose(torque.to_numpy(), rigid, rtol=1e-12)


def test_a_changed_result_is_a_new_run_and_the_old_one_is_no_longer_the_latest(logged: Path) -> None:
    mlflow = pytest.importorskip("mlflow")
    target = store(logged)
    new = [record for record in records(logged, threshold=0.02) if record.method == "sr"]
    assert len(upsert(new, target, notify=lambda _: None)) == 1
    client = mlflow.MlflowClient(target.uri)
    experiment = client.get_experiment_by_name(target.experiment).experiment_id
    runs = client.search_runs([experiment], "tags.method = 'sr'")
    assert sorted((run.data.params["sindy.threshold"], run.data.tags["latest"]) for run in runs) == [
        ("0.01", "false"),
        ("0.02", "true"),
    ]
