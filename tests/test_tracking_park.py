"""Arms of the park in MLflow: what the loop found on a recording, beside the models it is compared with."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from tests.small_arm import HIDDEN, URDF, arm, runs
from tests.test_tracking_loop import diagnosis_of, model_of

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.files import write_json, write_text
from hybrid_dynamics.loop import Model
from hybrid_dynamics.loop.diagnosis import write_diagnosis
from hybrid_dynamics.loop.model import save_model
from hybrid_dynamics.study.layout import DatasetFiles
from hybrid_dynamics.study.park.tables import COLUMNS
from hybrid_dynamics.study.tracking import RunRecord, park_records, store, upsert
from hybrid_dynamics.trajectory import write_trajectories


def write_arm(root: Path, viscous: float = 3.0, provenance: str = "recorded", name: str = "lab") -> Path:
    """What stage park_arm leaves of arm ``name``, whose loop found viscous friction ``viscous``."""
    folder = DatasetFiles(name, root).park
    write_json(folder / "summary.json", {"dataset": name, "provenance": provenance, "repository": "a/b"})
    if provenance != "recorded":
        return folder
    write_text(folder / "robot.urdf", URDF)
    write_trajectories(folder / "trajectories.parquet", [r for part in runs(1, 1, duration=2.0) for r in part], {})
    found = model_of(viscous)
    save_model(folder / "loop" / "model.json", Model(arm(), found))
    write_diagnosis(folder / "loop" / "diagnosis.json", diagnosis_of(found))
    errors = {"rigid_body": 3.0, "least_squares": 0.5, "loop": 0.25, "black_box": 0.24, "loop_confirmed": 0.26}
    against = {"against_least_squares": -0.75, "against_least_squares_error": 0.125}
    whole = {f"arm_{key}": value for key, value in against.items()}
    row = {"dataset": name, "joint": [1, 2], **errors, **against, **whole, "explained_share": [0.9, None]}
    pd.DataFrame(row).reindex(columns=list(COLUMNS)).to_csv(folder / "joints.csv", index=False)
    for table in ("regimes", "parameters"):
        write_text(folder / f"{table}.csv", "dataset\n")
    return folder


def only(root: Path) -> RunRecord:
    [record] = park_records(root, ["lab"], {"block": 0.5})
    return record


def test_an_arm_is_a_run_with_what_was_found_and_what_it_is_beside(tmp_path: Path) -> None:
    write_arm(tmp_path)
    record = only(tmp_path)
    assert record.metrics["parameter/viscous_friction/joint1/viscous_coefficient"] == 3.0
    assert record.metrics["std_error/viscous_friction/joint1/viscous_coefficient"] == 0.02
    assert record.metrics["noise_floor/joint2"] == 0.2
    for model, size in (("rigid_body", 3.0), ("least_squares", 0.5), ("loop", 0.25)):
        assert record.metrics[f"park/test/rmse/{model}/joint2"] == size
    assert record.metrics["park/test/against_least_squares/arm"] == -0.75
    assert record.metrics["park/test/against_least_squares_error/joint1"] == 0.125
    assert "park/test/explained_share/joint2" not in record.metrics  # there is none, and no number stands for it
    assert record.params["verdict"] == "explained"
    assert record.params["loop.block"] == "0.5"
    assert (record.tags["arm"], record.tags["provenance"]) == ("lab", "recorded")
    assert [own.source for own in record.inputs] == ["data/lab/park/trajectories.parquet"] * 2
    # An arm's loop is no version of the data set's registered model.
    assert record.registered is None


def test_an_arm_without_its_recording_has_no_run_and_a_broken_one_is_named(tmp_path: Path) -> None:
    write_arm(tmp_path, provenance="absent")
    assert park_records(tmp_path, ["lab"]) == []
    folder = write_arm(tmp_path)
    (folder / "loop" / "diagnosis.json").unlink()
    with pytest.raises(InputError, match=r"diagnosis\.json"):
        park_records(tmp_path, ["lab"])


def test_the_digest_follows_what_was_found(tmp_path: Path) -> None:
    write_arm(tmp_path)
    before = only(tmp_path).digest
    assert only(tmp_path).digest == before
    write_arm(tmp_path, viscous=3.1)
    assert only(tmp_path).digest != before


def test_an_arm_is_logged_once_with_its_files_at_relative_places(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mlflow = pytest.importorskip("mlflow")
    (tmp_path / ".dvc").mkdir()
    write_arm(tmp_path)
    target = store(tmp_path)
    for count in (1, 0):
        assert len(upsert([only(tmp_path)], target, notify=lambda line: None)) == count
    monkeypatch.chdir(tmp_path)
    mlflow.set_tracking_uri(target.uri)
    client = mlflow.MlflowClient(target.uri)
    experiment = client.get_experiment_by_name("hybrid_dynamics").experiment_id
    [run] = client.search_runs([experiment], "tags.method = 'park' AND tags.latest = 'true'")
    assert run.data.tags["arm"] == "lab"
    assert not Path(run.info.artifact_uri.removeprefix("file:")).is_absolute()
    joints = Path(client.download_artifacts(run.info.run_id, "park/joints.csv"))
    assert pd.read_csv(joints)["loop"].tolist() == [0.25, 0.25]
    assert Path(client.download_artifacts(run.info.run_id, "result/diagnosis.json")).is_file()
    assert not client.search_registered_models()
    assert len(HIDDEN) == int(run.data.metrics["effects/named"])
