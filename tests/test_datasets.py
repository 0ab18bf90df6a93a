"""Datasets as configured: every dataset of conf/ is well-formed; payloads and twins obey their physics."""

from pathlib import Path

import numpy as np
import pytest

from hybrid_dynamics.differentiate import DifferentiateSettings
from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.twin import DriveFriction
from hybrid_dynamics.study.config import convert, load_params, section
from hybrid_dynamics.study.datasets import (
    CarriedBody,
    ReaderSettings,
    RecordedRun,
    RobotSettings,
    StudySimulation,
    TwinSettings,
    read_run,
    robot_description,
    taken_in,
    true_torque,
)
from hybrid_dynamics.study.sources import SourceSettings
from hybrid_dynamics.trajectory import Trajectory

PARAMS = load_params(Path(__file__).resolve().parents[1] / "params.yaml")


@pytest.fixture(scope="module")
def ur10():
    settings = RobotSettings(urdf="package:ur_description/urdf/ur10_joint_limited_robot.urdf")
    return Robot.from_text(robot_description(settings), "ur10")


@pytest.mark.parametrize("name", sorted(PARAMS["dataset"]))
def test_every_dataset_of_conf_is_well_formed(name):
    section(PARAMS, f"dataset.{name}.differentiate", DifferentiateSettings)
    robot = section(PARAMS, f"dataset.{name}.robot", RobotSettings)
    assert section(PARAMS, f"dataset.{name}.title", str)
    own = PARAMS["dataset"][name]
    if not {"source", "simulation"} & set(own) and "runs" in own:
        check_own_logs(name, PARAMS)
        return
    if robot.urdf.startswith("source:") and not robot.fallback:
        # Of a recording that cannot be had without its own description; it is left out then.
        check_recorded(name, robot)
        return
    n = Robot.from_text(robot_description(robot), name).n_joints
    if "simulation" in PARAMS["dataset"][name]:
        assert len(section(PARAMS, f"dataset.{name}.simulation", StudySimulation).damping) == n
        return
    files = check_recorded(name, robot)
    twin = section(PARAMS, f"dataset.{name}.twin", TwinSettings | None)
    if twin is not None:
        assert set(twin.follow) <= files
        assert len(twin.friction.viscous) == n


def check_own_logs(name, params):
    """Of one's own logs the files are elsewhere than in a clone: what is read in them must be said well. They stand for
    themselves, without a twin, and nothing is fetched."""
    assert not section(params, f"dataset.{name}.robot", RobotSettings).urdf.startswith("source:"), "source is missing"
    assert params["dataset"][name].get("twin") is None
    section(params, f"dataset.{name}.reader", ReaderSettings)
    runs = section(params, f"dataset.{name}.runs", list[RecordedRun])
    assert "train" in {run.split for run in runs}
    assert len({run.name for run in runs}) == len({run.file for run in runs}) == len(runs)


def test_own_logs_need_no_source():
    """As the recipe of CONTRIBUTING.md has them; the control: one that stands twice."""
    run = {"name": "first", "split": "train", "file": "logs/first.csv"}
    own = {"robot": {"urdf": "logs/robot.urdf"}, "reader": {"format": "log"}, "runs": [run], "twin": None}
    check_own_logs("mine", {"dataset": {"mine": own}})
    with pytest.raises(AssertionError):
        check_own_logs("mine", {"dataset": {"mine": {**own, "runs": [run, {**run, "name": "second"}]}}})
    with pytest.raises(AssertionError, match="source is missing"):
        check_own_logs("mine", {"dataset": {"mine": {**own, "robot": {"urdf": "source:robot.urdf"}}}})
    with pytest.raises(ConfigError, match="format"):
        check_own_logs("mine", {"dataset": {"mine": {**own, "reader": {"format": "excel"}}}})


def check_recorded(name, robot):
    """The paths its source pins; every file that it reads must be among them."""
    reader = section(PARAMS, f"dataset.{name}.reader", ReaderSettings)
    source = section(PARAMS, f"dataset.{name}.source", SourceSettings)
    runs = section(PARAMS, f"dataset.{name}.runs", list[RecordedRun])
    files = {file.path for file in source.files}
    read = {robot.urdf.removeprefix("source:")} if robot.urdf.startswith("source:") else set()
    for run in runs:
        patterns = (reader.log.files if reader.log else {}) or {"q": ""}
        for pattern in patterns.values():
            place = Path(run.file)
            whole = place.parent / pattern.replace("{run}", place.name) if "{run}" in pattern else place / pattern
            read.add(whole.as_posix())
    assert read <= files, "what is read must be pinned in the source"
    assert {"train", "test"} == {run.split for run in runs}
    assert source.twin == (section(PARAMS, f"dataset.{name}.twin", TwinSettings | None) is not None)
    return files


def test_payload_weighs_what_it_says(ur10):
    """At rest the torque it adds is mass times gravity times the horizontal lever, whatever the pose."""
    payload = CarriedBody(2.0, (0.0, 0.0, 0.1), (0.01, 0.01, 0.01))
    carrying = payload.added_to(ur10)
    q = np.random.default_rng(0).uniform(-2, 2, (20, 6))
    still = np.zeros_like(q)
    added = carrying.inverse_dynamics(q, still, still) - ur10.inverse_dynamics(q, still, still)
    np.testing.assert_allclose(added[:, 0], 0.0, atol=1e-9, err_msg="a vertical first joint feels no weight")
    reach = np.abs(added[:, 1]).max() / (2.0 * 9.81)
    assert 0.3 < reach < 1.5, "the shoulder's lever is at most the arm's length"
    assert ur10.model.inertias[6].mass != carrying.model.inertias[6].mass


def test_true_torque_is_rigid_body_plus_declared_losses(ur10):
    rng = np.random.default_rng(1)
    q, dq, ddq = rng.normal(size=(3, 5, 6))
    run = Trajectory("r", "train", np.arange(5) * 0.01, {"q": q, "dq": dq, "ddq": ddq})
    friction = DriveFriction(viscous=(2.0,) * 6, coulomb=(1.0,) * 6, offset=(0.5,) * 6, armature=(0.3,) * 6)
    expected = ur10.inverse_dynamics(q, dq, ddq) + 2.0 * dq + np.sign(dq) + 0.5 + 0.3 * ddq
    np.testing.assert_allclose(true_torque(ur10, friction, run), expected, atol=1e-9)


def test_a_users_log_is_read_from_where_it_was_taken_in(ur10, tmp_path):
    time = np.arange(200) * 0.01
    q = np.sin(time)[:, None] * np.ones(6)
    header = ",".join(["time", *(f"q{j}" for j in range(1, 7)), *(f"tau{j}" for j in range(1, 7))])
    copy = tmp_path / taken_in("/logs/run1.csv")
    copy.parent.mkdir()
    np.savetxt(copy, np.column_stack([time, q, q + 1.0]), delimiter=",", header=header, comments="")
    parts = read_run(ReaderSettings("log"), RecordedRun("run1", "train", "/logs/run1.csv"), tmp_path, ur10, print)
    np.testing.assert_allclose(parts[0]["tau"], q + 1.0, atol=1e-12)


def test_wrong_settings_are_named():
    with pytest.raises(ConfigError, match=r"reader\.format is 'xml'"):
        convert({"format": "xml"}, "dataset.x.reader", ReaderSettings)
    with pytest.raises(ConfigError, match=r"run a: rows is \[1\]"):
        convert([{"name": "a", "split": "train", "file": "f", "rows": [1]}], "dataset.x.runs", list[RecordedRun])
    with pytest.raises(InputError, match="cannot be found"):
        robot_description(RobotSettings(urdf="nowhere.urdf"))
