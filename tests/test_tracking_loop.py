"""A closed loop in MLflow: what it identified, when, from which data; its model in the registry, the champion."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from tests.small_arm import HIDDEN, URDF, arm, runs

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.features import add_features
from hybrid_dynamics.files import write_json, write_text
from hybrid_dynamics.loop import Model
from hybrid_dynamics.loop.diagnosis import Change, Diagnosis, Errors, NamedEffect, write_diagnosis
from hybrid_dynamics.loop.model import save_model
from hybrid_dynamics.loop.prediction import predict
from hybrid_dynamics.study.evaluation import ERROR_COLUMNS
from hybrid_dynamics.study.tracking import RunRecord, collect, store, upsert
from hybrid_dynamics.study.tracking.card import LONGEST, description
from hybrid_dynamics.study.tracking.identified import identified
from hybrid_dynamics.study.tracking.registry import held_out_error, registered_name
from hybrid_dynamics.trajectory import Trajectory, write_trajectories

NAME = "hybrid_dynamics.arm"
FINISHED, WALL = 1.7e9, 12.5


def diagnosis_of(effects: tuple[Effect, ...], contradicted: tuple[Effect, ...] = ()) -> Diagnosis:
    errors = Errors((3.3, 1.5), (0.5, 0.4), 0.4), Errors((0.1, 0.2), (0.05, 0.04), 0.03)
    named = [NamedEffect(e, (), errors[0].rmse, errors[1].rmse, True, (-0.9, 0.01)) for e in effects]
    named += [NamedEffect(e, (), errors[0].rmse, errors[0].rmse, False, (0.1, 0.02), "worse") for e in contradicted]
    change = Change(*errors)
    floor = (0.1, 0.2)
    return Diagnosis(
        "arm", ("shoulder", "elbow"), "explained", tuple(named), {"train": change, "test": change}, floor, ()
    )


def model_of(viscous: float) -> tuple[Effect, Effect]:
    """What the logs hold, but for the viscous coefficient."""
    joint, elbow = HIDDEN
    return (
        replace(joint, parameters={"viscous_coefficient": viscous}, std_errors={"viscous_coefficient": 0.02}),
        replace(elbow, std_errors={"coulomb_torque": 0.01}),
    )


def write_dataset(data: Path, viscous: float, provenance: str = "recorded") -> None:
    """Result files of data set ``arm``, whose loop found viscous friction ``viscous`` (3.0 is what the logs hold)."""
    folder = data / "arm"
    write_text(folder / "robot.urdf", URDF)
    metadata = {"dataset": "arm", "provenance": provenance}
    logs = [run for split in runs(train=1, test=1, duration=4.0) for run in split]
    write_trajectories(folder / "trajectories.parquet", logs, metadata)
    zeros = np.zeros_like(logs[0]["q"])
    states = [
        Trajectory(r.name, r.split, r.time, {"q": r["q"], "dq": zeros, "ddq": zeros, "dddq": zeros, "tau": r["tau"]})
        for r in logs
    ]
    write_trajectories(folder / "features.parquet", [add_features(arm(), s) for s in states], metadata)
    rows = [("arm", provenance, "test", "all", m, j, 0.1, 0.05, 0.02) for m in ("rigid_body", "loop") for j in (1, 2)]
    pd.DataFrame(rows, columns=list(ERROR_COLUMNS)).to_parquet(folder / "errors.parquet")
    found = model_of(viscous)
    loop = folder / "models" / "loop"
    save_model(loop / "model.json", Model(arm(), found))
    write_diagnosis(loop / "diagnosis.json", diagnosis_of(found))
    tool = Effect("payload", (), dict.fromkeys(PAYLOAD, 0.0) | {"mass": 0.5}, {}, dict.fromkeys(PAYLOAD, 0.01))
    asked = diagnosis_of((tool,))
    write_diagnosis(folder / "questions" / "tool" / "diagnosis.json", asked)
    write_json(folder / "timing" / "loop.json", {"wall_s": WALL, "peak_memory_mb": 300.0, "finished": FINISHED})


COUPLING = {"viscous_coefficient": 0.2, "coulomb_torque": 0.1, "armature": 0.0}
PAYLOAD = ("mass", "com_x", "com_y", "com_z", *(f"inertia_{k}" for k in ("xx", "xy", "yy", "xz", "yz", "zz")))


def loop_record(project: Path) -> RunRecord:
    return next(r for r in collect(project / "data", ["arm"]) if r.method == "loop")


def test_keys_say_what_and_where_so_that_two_results_compare() -> None:
    ripple = {"amplitude": 0.3, "phase": 0.1, "harmonic": 6.0}
    coupling = Effect("joint_coupling", ("elbow",), COUPLING, {"from_joint": "shoulder"})
    twice = Effect("torque_ripple", ("elbow",), ripple), Effect("torque_ripple", ("elbow",), ripple | {"harmonic": 9.0})
    gone = Effect("armature", ("shoulder",), {"armature": 0.1}, {}, {"armature": 0.3})
    found = identified(diagnosis_of((*HIDDEN, coupling, *twice), (gone,)))
    m = found.metrics
    assert m["parameter/viscous_friction/joint1/viscous_coefficient"] == 3.0
    assert m["parameter/joint_coupling/joint2_from_joint1/viscous_coefficient"] == 0.2
    assert m["parameter/torque_ripple/joint2/harmonic"] == 6.0
    assert m["parameter/torque_ripple/joint2_2/harmonic"] == 9.0
    assert (m["confirmed/armature/joint1"], m["confirmed/viscous_friction/joint1"]) == (0.0, 1.0)
    assert m["std_error/armature/joint1/armature"] == 0.3
    assert "std_error/viscous_friction/joint1/viscous_coefficient" not in m  # none is known, so none is shown
    assert (m["loop/test/before/rmse/joint1"], m["loop/test/after/relative_error"]) == (3.3, 0.03)
    assert m["noise_floor/joint2"] == 0.2
    assert found.params["effect.torque_ripple"] == "elbow"
    assert found.params["contradicted.armature"] == "shoulder"
    assert "effect.armature" not in found.params
    assert found.tags["verdict"] == "explained"
    assert "torque_ripple (1 joint)" in found.tags["effects"]
    # Another order of finding changes no key.
    assert identified(diagnosis_of((coupling, *twice[::-1], *HIDDEN[::-1]), (gone,))).metrics == m


def test_a_recorded_arm_and_its_twin_have_each_a_registered_model() -> None:
    assert registered_name("arm", "recorded") == NAME
    assert registered_name("arm", "simulated twin") == f"{NAME}.simulated_twin"


def test_a_card_that_is_too_long_is_cut_at_a_line_and_says_so() -> None:
    assert description("short") == "short"
    cut = description("a line of the card\n" * 1000)
    assert len(cut) <= LONGEST
    assert "model_card.md" in cut.splitlines()[-1]
    assert all(line in ("a line of the card", "") for line in cut.splitlines()[:-1])


def test_the_held_out_error_is_that_of_the_test_runs(tmp_path: Path) -> None:
    write_dataset(tmp_path, 3.0)
    folder = tmp_path / "arm"
    files = folder / "models" / "loop" / "model.json", folder / "robot.urdf"
    right = held_out_error(*files, folder / "trajectories.parquet")
    test = runs(train=1, test=1, duration=4.0)[1][0]
    assert right == pytest.approx(predict(Model(arm(), HIDDEN), test).relative_error(), rel=1e-6)
    save_model(files[0], Model(arm()))
    assert held_out_error(*files, folder / "trajectories.parquet") > 5 * right
    write_trajectories(folder / "none.parquet", runs(train=1, test=1, duration=4.0)[0], {})
    assert np.isnan(held_out_error(*files, folder / "none.parquet"))


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project whose loop was logged once, off by 0.4 N m s/rad."""
    pytest.importorskip("mlflow")
    folder = tmp_path_factory.mktemp("closed")
    (folder / ".dvc").mkdir()
    write_dataset(folder / "data", 2.6)
    log(folder)
    return folder


def log(project: Path) -> list[str]:
    lines: list[str] = []
    assert len(upsert([loop_record(project)], store(project), notify=lines.append)) == 1
    return lines


@pytest.fixture
def client(project: Path) -> Callable[[], Any]:
    import mlflow

    def make() -> Any:
        mlflow.set_tracking_uri(store(project).uri)
        return mlflow.MlflowClient(store(project).uri)

    return make


def only_run(client: Any, query: str) -> Any:
    found = client.search_runs([client.get_experiment_by_name("hybrid_dynamics").experiment_id], query)
    assert len(found) == 1
    return found[0]


def test_a_run_has_the_parameters_the_data_and_the_time_of_the_training(project: Path, client: Any) -> None:
    run = only_run(client(), "tags.kind = 'result' AND tags.method = 'loop'")
    assert run.data.metrics["parameter/viscous_friction/joint1/viscous_coefficient"] == 2.6
    assert run.data.metrics["std_error/viscous_friction/joint1/viscous_coefficient"] == 0.02
    assert run.data.params["effect.coulomb_friction"] == "elbow"
    assert (run.info.start_time, run.info.end_time) == (round(1e3 * (FINISHED - WALL)), round(1e3 * FINISHED))
    inputs = {i.dataset.name: i for i in run.inputs.dataset_inputs}
    assert set(inputs) == {"arm train", "arm test"}
    for name, own in inputs.items():
        assert run.data.tags["data_digest"].startswith(own.dataset.digest)
        assert json.loads(own.dataset.source) == {"uri": "data/arm/trajectories.parquet"}
        assert json.loads(own.dataset.profile)["rows"] == 1600
        assert own.tags[0].value == {"arm train": "training", "arm test": "testing"}[name]
    question = only_run(client(), "tags.kind = 'question'")
    assert question.data.metrics["parameter/payload/robot/mass"] == 0.5
    assert question.data.tags["mlflow.parentRunId"] == run.info.run_id


def test_the_registered_model_predicts_a_log_as_the_library_does(project: Path, client: Any) -> None:
    import mlflow

    version = client().get_model_version_by_alias(NAME, "champion")
    assert "viscous coefficient | 2.600 ± 0.020 N m s/rad |" in version.description
    assert "tau1" in version.description or "Torque [N m]" in version.description
    stored = list((project / "mlartifacts").rglob("*"))
    assert not [path for path in stored if path.suffix in (".pkl", ".pickle", ".joblib")]
    assert [path for path in stored if path.name == "model_card.md"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(project)
        model = mlflow.pyfunc.load_model(f"models:/{NAME}@champion")
    assert model.metadata.signature.inputs.input_names() == ["time", "q1", "q2"]
    assert model.metadata.signature.outputs.input_names() == ["tau1", "tau2"]
    log = runs(train=1, test=1, duration=4.0)[1][0]
    frame = pd.DataFrame({"time": log.time, "q1": log["q"][:, 0], "q2": log["q"][:, 1]})
    expected = predict(Model(arm(), model_of(2.6)), log)
    np.testing.assert_allclose(model.predict(frame), expected.tau, rtol=1e-9, atol=1e-9)


def test_the_champion_changes_only_for_a_smaller_error_on_the_runs_held_out_now(project: Path, client: Any) -> None:
    def champion() -> int:
        return int(client().get_model_version_by_alias(NAME, "champion").version)

    first = champion()
    write_dataset(project / "data", 3.0)
    assert any("is champion now" in line for line in log(project))
    assert champion() == first + 1
    write_dataset(project / "data", 3.3)
    assert any("does not replace" in line for line in log(project))
    assert champion() == first + 1
    assert len(client().search_model_versions(f"name = '{NAME}'")) == first + 2
    # A champion that cannot be asked is not passed over in silence.
    hidden = project / "mlartifacts" / "hybrid_dynamics" / "models"
    hidden.rename(hidden.with_name("gone"))
    write_dataset(project / "data", 3.01)
    lines = log(project)
    assert any("cannot be compared" in line for line in lines), lines
    assert champion() == first + 1


def test_a_moved_project_keeps_its_artifacts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mlflow = pytest.importorskip("mlflow")
    old, new = tmp_path / "old", tmp_path / "new"
    (old / ".dvc").mkdir(parents=True)
    write_dataset(old / "data", 3.0)
    target = store(old)
    # A store of before, whose locations were absolute.
    mlflow.set_tracking_uri(target.uri)
    place = (old / "mlartifacts" / "hybrid_dynamics").as_uri()
    own = mlflow.MlflowClient(target.uri).create_experiment("hybrid_dynamics", artifact_location=place)
    before = mlflow.MlflowClient(target.uri).create_run(own).info.run_id
    mlflow.MlflowClient(target.uri).log_text(before, "kept", "note.txt")
    log(old)
    shutil.move(old, new)
    monkeypatch.chdir(new)
    uri = store(new).uri
    mlflow.set_tracking_uri(uri)
    client = mlflow.MlflowClient(uri)
    assert Path(client.download_artifacts(before, "note.txt")).read_text() == "kept"
    run = only_run(client, "tags.kind = 'result'")
    assert Path(client.download_artifacts(run.info.run_id, "model_card.md")).read_text().startswith(f"# {NAME}\n")
    assert mlflow.pyfunc.load_model(f"models:/{NAME}@champion").metadata.signature is not None
