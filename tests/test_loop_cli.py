"""The command line of the loop: verdicts, files, and one clear line for unusable input."""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from tests.small_arm import write_logs

from hybrid_dynamics.cli import main
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.loop.model import load_model
from hybrid_dynamics.readers import write_log
from hybrid_dynamics.robots import Robot, find_description, lock_joints
from hybrid_dynamics.simulation.excitation import excitations

FINGERS = ("panda_finger_joint1", "panda_finger_joint2")


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return int(stop.value.code or 0)


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert len(lines) == 1
    return lines[0]


@pytest.fixture(scope="module")
def logs(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    (folder / "panda.urdf").write_text(lock_joints(find_description("panda.urdf"), FINGERS))
    panda = Robot.from_urdf(folder / "panda.urdf")
    effects = [
        Effect("viscous_friction", ("panda_joint1",), {"viscous_coefficient": 2.0}),
        Effect("torque_offset", ("panda_joint6",), {"offset": 0.3}),
    ]
    train, test = excitations(panda, effects, train=2, test=1, duration=8.0)
    for trajectory in [*train, *test]:
        write_log(folder / f"{trajectory.name}.parquet", trajectory, panda.joint_names)
    return folder


def test_close_loop_writes_its_three_files_and_predict_uses_them(logs, tmp_path, capsys):
    out = tmp_path / "out"
    arguments = (
        "close-loop",
        "--ignore-dynamics",
        "--robot",
        logs / "panda.urdf",
        "--train",
        logs / "train_1.parquet",
        logs / "train_2.parquet",
    )
    assert run(*arguments, "--test", logs / "test_1.parquet", "--out", out) == 0
    assert sorted(p.name for p in out.iterdir()) == ["diagnosis.json", "model.json", "report.html"]
    diagnosis = json.loads((out / "diagnosis.json").read_text())
    found = {(e["effect"], *e["joints"]) for e in diagnosis["effects"]}
    assert found == {("viscous_friction", "panda_joint1"), ("torque_offset", "panda_joint6")}
    assert diagnosis["verdict"] == "explained"
    assert "explained" in capsys.readouterr().out

    # In a folder that holds nothing but the URDF and the logs the diagnosis has the same bytes.
    bare = tmp_path / "bare"
    shutil.copytree(logs, bare)
    arguments = (
        "close-loop",
        "--ignore-dynamics",
        "--robot",
        bare / "panda.urdf",
        "--train",
        bare / "train_1.parquet",
        bare / "train_2.parquet",
    )
    assert run(*arguments, "--test", bare / "test_1.parquet", "--out", bare / "out") == 0
    assert (bare / "out" / "diagnosis.json").read_bytes() == (out / "diagnosis.json").read_bytes()

    table = tmp_path / "predicted.parquet"
    model = ("predict", "--model", out / "model.json", "--robot", logs / "panda.urdf")
    assert run(*model, "--data", logs / "test_1.parquet", "--out", table) == 0
    predicted = pq.read_table(table).to_pandas()
    assert list(predicted.columns)[:8] == ["time", *(f"tau{j}" for j in range(1, 8))]
    log = pd.read_parquet(logs / "test_1.parquet")
    measured = np.interp(predicted["time"], log["time"], log["tau1"].rolling(21, center=True, min_periods=1).mean())
    assert np.std(predicted["tau1"] - measured) < 0.1 * np.std(measured)

    # Starting from the completed model nothing is missing.
    again = (*arguments, "--model", out / "model.json", "--out", tmp_path / "again")
    assert run(*again) == 0
    assert json.loads((tmp_path / "again" / "diagnosis.json").read_text())["verdict"] == "nothing_missing"
    robot = Robot.from_urdf(logs / "panda.urdf")
    assert load_model(tmp_path / "again" / "model.json", robot).effects == load_model(out / "model.json", robot).effects


def test_a_tenth_of_the_samples_missing_changes_nothing(logs, tmp_path):
    rng = np.random.default_rng(0)
    files = []
    for name in ("train_1", "train_2", "test_1"):
        frame = pd.read_parquet(logs / f"{name}.parquet")
        keep = rng.random(len(frame)) > 0.1
        keep[[0, -1]] = True
        files.append(tmp_path / f"{name}.csv")
        frame[keep].to_csv(files[-1], index=False)
    out = tmp_path / "out"
    robot = ("--robot", logs / "panda.urdf", "--ignore-dynamics")
    arguments = ("close-loop", *robot, "--train", *files[:2], "--test", files[2], "--out", out)
    assert run(*arguments) == 0
    diagnosis = json.loads((out / "diagnosis.json").read_text())
    found = {(e["effect"], *e["joints"]) for e in diagnosis["effects"]}
    assert found == {("viscous_friction", "panda_joint1"), ("torque_offset", "panda_joint6")}


def test_unusable_input_is_one_line_and_leaves_nothing(logs, tmp_path, capsys):
    out = tmp_path / "out"
    start = ("close-loop", "--robot", logs / "panda.urdf", "--out", out)
    assert run(*start, "--train", logs / "none.csv") == 2
    assert "none.csv" in one_line(capsys)
    frame = pd.read_parquet(logs / "train_1.parquet")
    frame["tau4"] *= -1
    frame.to_csv(tmp_path / "flipped.csv", index=False)
    assert run(*start, "--train", tmp_path / "flipped.csv") == 2
    assert "joint panda_joint4: the measured torque (tau4) has the wrong sign" in one_line(capsys)
    (tmp_path / "model.json").write_text("{}")
    assert run(*start, "--train", logs / "train_1.parquet", "--model", tmp_path / "model.json") == 2
    assert "model.json: top level: 'schema' is a required property" in one_line(capsys)
    for setting, complaint in (
        ("magic=1", "setting 'magic' is unknown; known are"),
        ("block=long", "block is 'long'; expected a number"),
        ("block=-1", "block is -1.0; expected 0.05 <= block <= 60"),
        ("effects=[viscous]", "effect 'viscous' is unknown; known are"),
        ("process.cutoff=0", "cutoff is 0.0; expected 0 < cutoff"),
        ("sign_widths=0.1", "sign_widths is 0.1; expected a list"),
    ):
        assert run(*start, "--train", logs / "train_1.parquet", "--set", setting) == 2
        assert complaint in one_line(capsys)
    assert not out.exists()


def test_what_was_not_looked_for_is_not_told_to_be_outside_the_catalogue(tmp_path, capsys):
    write_logs(tmp_path)
    asked = ["close-loop", "--robot", str(tmp_path / "robot.urdf"), "--train", str(tmp_path / "train_1.parquet")]
    asked += ["--test", str(tmp_path / "test_1.parquet"), "--out", str(tmp_path / "out")]
    with pytest.raises(SystemExit) as end:
        main([*asked, "--set", "effects=[torque_offset]"])
    assert end.value.code == 0
    said = capsys.readouterr()
    assert "nothing looked for explains it" in said.out
    assert "catalogue" not in said.out
    assert "looked for torque_offset and nothing else" in said.out + said.err
