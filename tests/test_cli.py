"""The command line as a stranger uses it: one line for unusable input, exit code 2, nothing written, nothing lost."""

import importlib
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import yaml
from stages.common import training_runs

from hybrid_dynamics.cli import main
from hybrid_dynamics.differentiate import DifferentiateSettings, differentiate_trajectory
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.errors import InputError, run_main
from hybrid_dynamics.loop.model import Model, save_model
from hybrid_dynamics.readers import write_log
from hybrid_dynamics.robots import Robot, find_description, lock_joints
from hybrid_dynamics.simulation.excitation import excitations
from hybrid_dynamics.study.layout import DatasetFiles
from hybrid_dynamics.trajectory import Trajectory, read_trajectories, write_trajectories

FINGERS = ("panda_finger_joint1", "panda_finger_joint2")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    """A robot, a run of it and its completed model."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "robot.urdf").write_text(lock_joints(find_description("panda.urdf"), FINGERS))
    robot = Robot.from_urdf(folder / "robot.urdf")
    effects = (Effect("viscous_friction", ("panda_joint1",), {"viscous_coefficient": 2.0}),)
    (run,), _ = excitations(robot, effects, train=1, test=0, duration=4.0)
    write_log(folder / "run.parquet", run, robot.joint_names)
    save_model(folder / "model.json", Model(robot, effects))
    return folder


@pytest.fixture
def here(recorded, tmp_path, monkeypatch) -> Path:
    """A working folder with copies of the recorded files."""
    for file in recorded.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return int(stop.value.code or 0)


def refused(folder: Path, capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line that refuses ``arguments``; no file may appear, change or vanish."""
    before = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    assert run(*arguments) == 2
    assert {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()} == before
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("error: ")
    return lines[0]


CLOSE = ("close-loop", "--robot", "robot.urdf", "--train", "run.parquet", "--out")
PREDICT = ("predict", "--model", "model.json", "--robot", "robot.urdf", "--data", "run.parquet", "--out")
IMPORT = ("import", "--robot", "robot.urdf", "--data", "run.parquet", "--out")


def test_predict_needs_no_torque(here):
    log = pd.read_parquet("run.parquet")
    torque = [name for name in log if name.startswith("tau")]  # type: ignore[attr-defined]
    log.drop(columns=torque).to_csv("motion.csv", index=False)
    assert run(*PREDICT, "full.parquet") == 0
    assert run(*PREDICT[:-3], "--data", "motion.csv", "--out", "motion.parquet") == 0
    full, motion = (pq.read_table(f"{name}.parquet").to_pandas() for name in ("full", "motion"))
    np.testing.assert_allclose(full[motion.columns].to_numpy(), motion.to_numpy(), atol=1e-9)
    # The control: the prediction is this run's torque, but for noise.
    measured = np.interp(full["time"], log["time"], log["tau2"].rolling(21, center=True, min_periods=1).mean())
    assert np.std(full["tau2"] - measured) < 0.1 * np.std(measured)


@pytest.mark.parametrize("name", ["tau.csv", "tau.parquet"])
def test_predict_replaces_its_own_file_and_no_log(here, name):
    assert run(*PREDICT, name) == 0
    assert run(*PREDICT, name) == 0
    log = Path(here / "run.parquet").read_bytes()
    other = here / f"other_{name}"
    other.write_bytes(log)
    assert run(*PREDICT, other.name) == 2
    assert other.read_bytes() == log
    assert run(*PREDICT, other.name, "--force") == 0


def of_log(log: pd.DataFrame, name: str) -> tuple[str, ...]:
    """A prediction along ``log``, written as ``name``.csv."""
    log.to_csv(f"{name}.csv", index=False)
    return (*PREDICT[:-3], "--data", f"{name}.csv", "--out", f"{name}.parquet")


def test_predict_says_where_no_model_would_be_better(here, capsys):
    """A gain that no unit has, of all joints and of one, and a log too slow: told; the log as it is: nothing."""
    log = pd.read_parquet("run.parquet")
    assert run(*PREDICT, "plain.parquet") == 0
    said = capsys.readouterr().err
    assert "worse than" not in said
    assert "too slow" not in said
    assert run(*of_log(log.assign(**{f"tau{j}": 0.3 * log[f"tau{j}"] for j in range(1, 8)}), "weak")) == 0
    assert re.search(
        r"note: the model predicts this log worse than no model at all: \d+% of the torque is left; .*"
        r"run hybrid-dynamics check on the log",
        capsys.readouterr().err,
    )
    assert run(*of_log(log.assign(tau4=0.3 * log["tau4"]), "one")) == 0
    assert re.search(r"worse than no model at all on some joints: \d+% on panda_joint4 of the", capsys.readouterr().err)
    step = round(0.2 / float(np.median(np.diff(log["time"]))))
    wide = pd.concat([log.assign(time=log["time"] + k * (log["time"].iloc[-1] + 0.002)) for k in range(20)])
    assert run(*of_log(wide.iloc[::step], "slow")) == 0
    assert "5 Hz is too slow for dynamics; expected at least 10 Hz" in capsys.readouterr().err


def test_predict_refuses_a_log_whose_torque_cannot_be_of_its_motion(here, capsys):
    """What check and close-loop refuse: a number along such a log would be wrong without a word."""
    log = pd.read_parquet("run.parquet")
    names = {f"{s}{a}": f"{s}{b}" for s in ("q", "dq", "tau") for a, b in ((2, 4), (4, 2))}
    torques = [f"tau{j}" for j in range(1, 8)]
    for what, (spoilt, message) in {
        "swapped": (log.rename(columns=names), "of panda_joint2 and panda_joint4 are exchanged"),
        "turned": (log.assign(tau4=-log["tau4"]), "joint panda_joint4: the measured torque (tau4) has the wrong sign"),
        "Nmm": (log.assign(**{t: 1e3 * log[t] for t in torques}), "it looks like N mm: convert it"),
        "late": (
            log.assign(**{t: np.roll(log[t], 100) for t in torques}),
            "s later than the positions; expected one clock",
        ),
    }.items():
        arguments = of_log(spoilt, what)
        assert message in refused(here, capsys, *arguments)
    # The control: the log as it is; and where there is no torque, nothing can be said of it.
    assert run(*of_log(log, "plain")) == 0
    assert run(*of_log(log.rename(columns=names).drop(columns=torques), "motion")) == 0


def test_import_replaces_no_file_unasked(here, capsys):
    """Another run's log of the same name is a recording too."""
    assert run(*IMPORT, "log.parquet") == 0
    Path("log.parquet").write_bytes(b"old")
    capsys.readouterr()
    line = refused(here, capsys, *IMPORT, "log.parquet")
    assert line == "error: log.parquet: exists; give another name, or --force to replace it"
    assert "is an input" in refused(here, capsys, *IMPORT, "run.parquet", "--force")
    assert run(*IMPORT, "log.parquet", "--force") == 0
    assert len(pd.read_parquet("log.parquet")) == len(pd.read_parquet("run.parquet"))


def test_predict_reads_logs_in_another_form(here):
    """Columns by name in degrees, motor side with its sign turned: the same prediction as for the plain log."""
    log = pd.read_parquet("run.parquet")
    other = pd.DataFrame({"ms": 1e3 * log["time"], "state": 1})
    for j in range(1, 8):
        other[f"pos_{j}"] = -100 * np.degrees(log[f"q{j}"])
        other[f"trq_{j}"] = log[f"tau{j}"] / -100
    other.to_csv("other.csv.gz", index=False, sep=";")
    Path("log.yaml").write_text("columns: {time: ms, tau: 'trq_{i}'}\ngear_ratio: -100\nmotor_side: [q, tau]\n")
    form = ("--log", "log.yaml", "--columns", "q=pos_{i}", "--units", "deg,ms")
    assert run(*PREDICT[:-3], "--data", "other.csv.gz", *form, "--out", "other.parquet") == 0
    log[["time", *(c for c in log if c.startswith(("q", "tau")))]].to_csv("plain.csv", index=False)  # type: ignore[attr-defined]
    assert run(*PREDICT[:-3], "--data", "plain.csv", "--out", "plain.parquet") == 0
    given, plain = (pq.read_table(f"{name}.parquet").to_pandas() for name in ("other", "plain"))
    np.testing.assert_allclose(given.to_numpy(), plain.to_numpy(), atol=1e-5, equal_nan=True)


@pytest.mark.parametrize(
    ("command", "out", "message"),
    [
        (PREDICT, "run.parquet", "run.parquet: is an input and would be overwritten"),
        (PREDICT, "model.json", "model.json: expected a file name that ends in .parquet or .csv"),
        (PREDICT, "folder.parquet", "folder.parquet: is a folder"),
        (PREDICT, "robot.urdf/p.parquet", "robot.urdf: is a file"),
        (IMPORT, "run.parquet", "run.parquet: is an input and would be overwritten"),
        (IMPORT, "folder.parquet", "folder.parquet: is a folder"),
        (IMPORT, "robot.urdf/p.parquet", "robot.urdf: is a file"),
        (CLOSE, "robot.urdf", "robot.urdf: is a file"),
        (CLOSE, "robot.urdf/sub/out", "robot.urdf: is a file"),
        ((*CLOSE[:-1], "--model", "model.json", "--out"), ".", "model.json: is an input and would be overwritten"),
        (
            (*CLOSE[:-1], "--model", "folder.parquet", "--out"),
            "out",
            "folder.parquet: is a folder; give the model.json",
        ),
        ((*CLOSE[:-1], "--test", "run.parquet", "--out"), "out", "run.parquet: is given to --train and to --test"),
        ((*IMPORT[:-1], "--topic", "/joint_states", "--out"), "out.parquet", "a table has no topics"),
        ((*IMPORT[:-1], "--units", "inch", "--out"), "out.parquet", "--units inch: 'inch' is unknown"),
        ((*CLOSE[:-1], "--log", "none.yaml", "--out"), "out", "none.yaml: no such file; give the path of a log.yaml"),
        ((*PREDICT[:-1], "--columns", "q=pos_{i}", "--out"), "p.parquet", "column 'pos_1' of q is missing"),
    ],
)
def test_outputs_never_replace_inputs(here, capsys, command, out, message):
    (here / "folder.parquet").mkdir()
    assert message in refused(here, capsys, *command, out)


@pytest.mark.parametrize(
    ("pattern", "replacement", "message"),
    [
        ("<inertial>.*?</inertial>", "", "panda_link1, moved by joint panda_joint1, has no inertia"),
        (r"<inertia .*?/>", "", "<inertial> without <inertia>"),
        ('<mass value="[^"]*"', '<mass value="heavy"', "<mass> value is 'heavy'; expected a finite number"),
        ('<mass value="[^"]*"', '<mass value="inf"', "<mass> value is 'inf'"),
        ('ixx="[^"]*"', 'ixx="-5"', "ixx -5.0"),
        ('ixx="[^"]*"', 'ixx="1,5"', "<inertia> ixx is '1,5'"),
        ('<axis xyz="[^"]*"', '<axis xyz="0 0 0"', "joint panda_joint1: its axis is zero"),
        ('<axis xyz="[^"]*"', '<axis xyz="0 1"', "<axis> xyz is '0 1'; expected 3 finite numbers"),
        ("<limit .*?/>", "", "joint panda_joint1 has no <limit>"),
        ('<parent link="panda_link0"', '<parent link="floor"', "parent link 'floor' is not in the file"),
        ('<parent link="panda_link0"', '<parent link="panda_link3"', "carries itself|hang on no joint"),
        ("</robot>", "", "not valid XML"),
    ],
)
def test_faulty_urdf_is_named(here, capsys, pattern, replacement, message):
    text = Path("robot.urdf").read_text()
    faulty = re.sub(pattern, replacement, text, flags=re.DOTALL)
    assert faulty != text
    Path("faulty.urdf").write_text(faulty)
    line = refused(here, capsys, "close-loop", "--robot", "faulty.urdf", "--train", "run.parquet", "--out", "out")
    assert re.search(message, line), line


def test_locking_every_joint_is_refused(here, capsys):
    joints = [f"panda_joint{j}" for j in range(1, 8)]
    assert "all joints are locked" in refused(here, capsys, *CLOSE, "out", "--lock", *joints)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("block=[1", "--set block=[1: cannot be read"),
        ("process=3", "--set process: is a group"),
        ("families=3", "setting 'families' is unknown"),
        ("block", "--set block: expected NAME=VALUE"),
    ],
)
def test_faulty_setting_is_named(here, capsys, setting, message):
    assert message in refused(here, capsys, *CLOSE, "out", "--set", setting)


def test_interrupted_run_leaves_nothing(here):
    # A test runner in the background hands down an ignored SIGINT; a person's terminal does not.
    listen = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    process = subprocess.Popen(
        [sys.executable, "-c", f"{listen}; from hybrid_dynamics.cli import main; main()", *CLOSE, "out"],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    assert process.stderr is not None
    # The first stage of the loop is announced.
    first = process.stderr.readline()
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    rest = process.communicate(timeout=60)[1]
    assert process.returncode == 130, first + rest
    assert "Traceback" not in first + rest
    assert rest.splitlines()[-1] == "interrupted"
    assert not Path("out").exists()


def stage(name: str, *arguments: str) -> int:
    program = importlib.import_module(f"stages.{name}").main
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [name, *arguments])
        with pytest.raises(SystemExit) as stop:
            run_main(program)
    return int(stop.value.code or 0)


@pytest.mark.parametrize(
    ("urdf", "runs", "message"),
    [
        ("", [("a", "train", "run.parquet")], "error: empty path: is a folder"),
        (".", [("a", "train", "run.parquet")], r"error: \.: is a folder"),
        ("none.urdf", [("a", "train", "run.parquet")], "none.urdf: no such file"),
        ("robot.urdf", [("a", "train", "sub")], "sub: is a folder"),
        ("robot.urdf", [("a", "test", "run.parquet")], "no run with split 'train'"),
        ("robot.urdf", [("a", "train", "run.parquet"), ("a", "test", "robot.urdf")], "name 'a' stands twice"),
        ("robot.urdf", [("a", "train", "run.parquet"), ("b", "test", "run.parquet")], "'run.parquet' stands twice"),
    ],
)
def test_own_logs_are_checked_before_they_are_taken_in(here, capsys, urdf, runs, message):
    (here / "sub").mkdir()
    rows = [dict(zip(("name", "split", "file"), run, strict=True)) for run in runs]
    Path("params.yaml").write_text(yaml.safe_dump({"dataset": {"custom": {"robot": {"urdf": urdf}, "runs": rows}}}))
    assert stage("fetch", "custom") == 2
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert re.search(message, error), error
    assert not Path("data").exists()


def test_text_in_a_column_and_features_without_training_runs(here, capsys):
    time = np.arange(0.0, 1.0, 0.01)
    signals = {s: np.ones((len(time), 1)) for s in ("q", "tau")}
    write_trajectories("data/x/features.parquet", [Trajectory("a", "test", time, signals)], {})
    with pytest.raises(InputError, match="no run with split 'train'"):
        training_runs(DatasetFiles("x"))
    table = pq.read_table("data/x/features.parquet")
    text = [str(value) for value in table.column("q1").to_pylist()]
    pq.write_table(table.set_column(table.schema.get_field_index("q1"), "q1", [text]), "text.parquet")
    with pytest.raises(InputError, match=r"text.parquet: column 'q1' holds string; expected numbers"):
        read_trajectories("text.parquet")


def test_a_joint_that_stands_still_leaves_the_others_their_bandwidth():
    time = np.arange(0.0, 8.0, 0.01)
    q = np.column_stack([np.sin(2 * time), np.cos(3 * time)]) + 1e-4 * np.random.default_rng(0).normal(size=(800, 2))
    moving = Trajectory("a", "train", time, {"q": q, "tau": q})
    still = Trajectory("a", "train", time, {k: np.column_stack([q, np.full(800, 0.3)]) for k in ("q", "tau")})
    settings = DifferentiateSettings(method="butterworth")
    (alone, first), (beside, second) = (differentiate_trajectory(run, settings) for run in (moving, still))
    assert first["cutoff_hz"] == second["cutoff_hz"]
    np.testing.assert_allclose(alone["ddq"], beside["ddq"][:, :2], atol=1e-12)
    np.testing.assert_allclose(beside["ddq"][:, 2], 0.0, atol=1e-8)
