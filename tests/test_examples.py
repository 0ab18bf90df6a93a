"""The examples run as they are, and what they print is true."""

import re
import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run an example in an empty folder; returns what it prints."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(EXAMPLES))

    def go(name, *arguments):
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return go


def test_a_bag_gives_the_hidden_friction(run, tmp_path):
    said = run("ros2_bag.py")
    assert re.search(r"viscous_friction \(shoulder\): viscous_coefficient (2\.9|3\.0|3)", said)
    assert re.search(r"coulomb_friction \(elbow\): coulomb_torque 1\.[45]", said)
    assert (tmp_path / "model.json").is_file()


def test_mujoco_moves_as_the_robot_did_only_with_the_completed_model(run, tmp_path):
    said = run("mujoco_before_after.py")
    pairs = re.findall(r"(\S+) rad with the URDF alone, (\S+) rad with the completed model", said)
    assert len(pairs) == 2
    assert all(float(after) < float(before) / 10 for before, after in pairs)
    assert (tmp_path / "before_after.png").stat().st_size > 10_000


def test_pinocchio_predicts_better_with_the_completed_model(run):
    pairs = re.findall(r"(\S+) with the URDF alone, (\S+) with the completed model", run("pinocchio_predict.py"))
    assert len(pairs) == 2
    assert all(float(after) < float(before) / 5 for before, after in pairs)


def test_the_arm_writes_files_for_the_commands_and_replaces_none(run, tmp_path):
    said = run("demo_arm.py", "--out", "demo")
    names = ["robot.urdf", "test_1.parquet", "train_1.parquet", "train_2.parquet"]
    assert sorted(p.name for p in (tmp_path / "demo").iterdir()) == names
    assert "hidden: coulomb_friction (elbow): coulomb_torque 1.5" in said
    with pytest.raises(SystemExit, match="demo: holds files already"):
        run("demo_arm.py", "--out", "demo")


def test_every_example_is_run_here():
    tested = {"ros2_bag.py", "mujoco_before_after.py", "pinocchio_predict.py", "demo_arm.py"}
    assert {path.name for path in EXAMPLES.glob("*.py")} == tested
