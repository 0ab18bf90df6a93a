"""Bad inputs as a new user gives them: what is wrong, the command, and the one line that comes out.

``make pages`` writes the table of ``docs/bad_inputs.md``; the test
beside this file runs every case and compares.
"""

# A row a case: the lines are as long as their cases.
# ruff: noqa: E501

from __future__ import annotations

import contextlib
import io
import json
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))


from tests.small_arm import HIDDEN, URDF, arm

from hybrid_dynamics.cli import main
from hybrid_dynamics.loop.model import Model, save_model
from hybrid_dynamics.simulation.excitation import excitations

PAGE = Path(__file__).resolve().parents[1] / "docs" / "bad_inputs.md"
CLOSE = ("close-loop", "--robot", "robot.urdf", "--train", "bad.csv", "b.csv", "--test", "test.csv", "--out", "out")
CHECK = ("check", "--robot", "robot.urdf", "--data", "bad.csv")
PREDICT = ("predict", "--robot", "robot.urdf", "--model", "bad.json", "--data", "test.csv", "--out", "tau.csv")
PREDICT_LOG = ("predict", "--robot", "robot.urdf", "--model", "model.json", "--data", "bad.csv", "--out", "tau.csv")
OTHER_ORDER = ["time", "q2", "q1", "tau2", "tau1"]
OTHER_URDF = ("check", "--robot", "bad.urdf", "--data", "a.csv")


@dataclass(frozen=True)
class Case:
    """``what`` is wrong, in words; ``make`` writes the bad files into a folder of good ones; ``code`` expected.

    ``told``: the finding by which ``check`` tells what it can do without (code 0).
    """

    what: str
    arguments: tuple[str, ...]
    make: Callable[[Path], object] = lambda folder: None
    code: int = 2
    told: str = ""


def frame(change: Callable[[pd.DataFrame], Any], name: str = "bad.csv") -> Callable[[Path], object]:
    """A log with ``change`` (in place, or returning a new one)."""

    def make(folder: Path) -> None:
        table = pd.read_csv(folder / "a.csv")
        changed = change(table)
        (table if changed is None else changed).to_csv(folder / name, index=False)

    return make


def put(column: str, row: int, value: Any) -> Callable[[Path], object]:
    """One cell (row as an editor counts) is ``value``."""

    def change(table: pd.DataFrame) -> pd.DataFrame:
        out = table.astype(object)
        out.loc[row - 2, column] = value
        return out

    return frame(change)


def shifted(column: str, by: float) -> Callable[[Path], object]:
    """One sample from the middle of the log is off."""
    return frame(lambda t: t.assign(**{column: t[column] + by * (t.index == len(t) // 3)}))


def scaled(factor: Any, *columns: str) -> Callable[[Path], object]:
    def change(table: pd.DataFrame) -> None:
        for k, column in enumerate(columns):
            table[column] *= np.broadcast_to(factor, len(columns))[k]

    return frame(change)


def written(name: str, content: str | bytes) -> Callable[[Path], object]:
    def make(folder: Path) -> None:
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)

    return make


def lines(change: Callable[[list[str]], list[str]]) -> Callable[[Path], object]:
    """The lines of a CSV log, changed."""
    return lambda folder: (
        (folder / "bad.csv").write_text("".join(change((folder / "a.csv").read_text().splitlines(True)))) and None
    )


def urdf(old: str, new: str, count: int = 1) -> Callable[[Path], object]:
    assert old in URDF, old
    return written("bad.urdf", URDF.replace(old, new, count))


def model(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path], object]:
    def make(folder: Path) -> None:
        value = json.loads((folder / "model.json").read_text())
        changed = change(value)
        (folder / "bad.json").write_text(json.dumps(value if changed is None else changed))

    return make


def velocity(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], object]:
    def make(table: pd.DataFrame) -> None:
        q = table[["q1", "q2"]].to_numpy()
        dq = change(np.gradient(q, table["time"].to_numpy(), axis=0))
        table["dq1"], table["dq2"] = dq[:, 0], dq[:, 1]

    return frame(make)


def several(*makes: Callable[[Path], object]) -> Callable[[Path], object]:
    def make(folder: Path) -> None:
        for one in makes:
            one(folder)

    return make


def setting(*pairs: str) -> tuple[str, ...]:
    return ("close-loop", "--robot", "robot.urdf", "--train", "a.csv", "--out", "out", "--set", *pairs)


def described(text: str, data: str = "a.csv") -> tuple[tuple[str, ...], Callable[[Path], object]]:
    return ("check", "--robot", "robot.urdf", "--data", data, "--log", "log.yaml"), written("log.yaml", text)


def entry(value: dict[str, Any]) -> dict[str, Any]:
    return value["effects"][0]


def parameter(value: dict[str, Any]) -> dict[str, Any]:
    return entry(value)["parameters"][0]


LINK = '<link name="{0}"><inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
JOINT = '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/>{4}</joint>'
MORE = LINK.format("third") + "\n</robot>"


def with_joint(
    kind: str = "revolute", name: str = "wrist", extra: str = "", parent: str = "fore"
) -> Callable[[Path], object]:
    return urdf("</robot>", LINK.format("third") + JOINT.format(name, kind, parent, "third", extra) + "</robot>")


CASES: list[Case] = [
    # ------------------------------------------------------------------ files and arguments
    Case("no command", ()),
    Case("an unknown command", ("closeloop",)),
    Case("an option that does not exist", (*CLOSE, "--verbose")),
    Case("no --robot", ("close-loop", "--train", "a.csv", "--out", "out")),
    Case("no --train", ("close-loop", "--robot", "robot.urdf", "--out", "out")),
    Case("no --out", ("close-loop", "--robot", "robot.urdf", "--train", "a.csv")),
    Case("a log that does not exist", (*CLOSE[:4], "none.csv", "--out", "out")),
    Case("a folder as log", ("check", "--robot", "robot.urdf", "--data", "folder"), lambda f: (f / "folder").mkdir()),
    Case("a log with an unknown suffix", ("check", "--robot", "robot.urdf", "--data", "a.xls"), written("a.xls", "x")),
    Case("a picture called .csv", CHECK, written("bad.csv", bytes(range(256)) * 20)),
    Case("an empty file", CHECK, written("bad.csv", "")),
    Case("a header and nothing else", CHECK, lines(lambda t: t[:1])),
    Case("no header", CHECK, lines(lambda t: t[1:])),
    Case("an Excel file called .csv", CHECK, written("bad.csv", b"PK\x03\x04" + bytes(200))),
    Case("a text file called .parquet", (*CHECK[:4], "bad.parquet"), written("bad.parquet", "time,q1\n0,1\n")),
    Case("a text file called .npz", (*CHECK[:4], "bad.npz"), written("bad.npz", "time,q1\n0,1\n")),
    Case("a text file called .mat", (*CHECK[:4], "bad.mat"), written("bad.mat", "time,q1\n0,1\n" * 100)),
    Case("a bag that is none", (*CHECK[:4], "bad.bag"), written("bad.bag", "#ROSBAG V2.0\nnot really")),
    Case("an MCAP file that is none", (*CHECK[:4], "bad.mcap"), written("bad.mcap", bytes(100))),
    Case("a .csv.gz that is not packed", (*CHECK[:4], "bad.csv.gz"), written("bad.csv.gz", "time,q1\n")),
    Case("the same log as training and test", (*CLOSE[:4], "a.csv", "--test", "a.csv", "--out", "out")),
    Case(
        "a copy of a training log as test",
        (*CLOSE[:4], "a.csv", "--test", "bad.csv", "--out", "out"),
        frame(lambda t: t.assign(time=t["time"] + 7.0).round(8)),
    ),
    Case(
        "a part of a training log as test",
        (*CLOSE[:4], "a.csv", "--test", "bad.csv", "--out", "out"),
        frame(lambda t: t.iloc[300:1100]),
    ),
    Case("the same training log twice", (*CLOSE[:4], "a.csv", "./a.csv", "--out", "out")),
    Case("the same test log twice", (*CLOSE[:4], "a.csv", "--test", "test.csv", "test.csv", "--out", "out")),
    Case("the same log twice, in check", (*CHECK[:4], "a.csv", "a.csv")),
    Case(
        "a copy of a training log among the training logs",
        (*CLOSE[:4], "a.csv", "bad.csv", "--test", "test.csv", "--out", "out"),
        frame(lambda t: t.assign(time=t["time"] + 7.0).round(8)),
    ),
    Case("a file where the results go", (*CLOSE[:4], "a.csv", "--out", "a.csv")),
    Case(
        "a folder with other files where the results go",
        (*CLOSE[:4], "a.csv", "--out", "mine"),
        lambda f: ((f / "mine").mkdir(), (f / "mine" / "thesis.txt").write_text("x")),  # type: ignore[func-returns-value]
    ),
    Case(
        "the prediction over its own log", (*PREDICT[:3], "--model", "model.json", "--data", "a.csv", "--out", "a.csv")
    ),
    Case(
        "the prediction over another log", (*PREDICT[:3], "--model", "model.json", "--data", "a.csv", "--out", "b.csv")
    ),
    Case("a prediction into an unknown format", (*PREDICT[:-1], "tau.xlsx"), model(lambda m: m)),
    Case(
        "an import over another log",
        ("import", "--robot", "robot.urdf", "--data", "a.csv", "--out", "b.parquet"),
        written("b.parquet", "an earlier log"),
    ),
    Case("a joint to lock that does not exist", (*CHECK[:3], "--lock", "wirst", "--data", "a.csv")),
    Case("all joints locked", (*CHECK[:3], "--lock", "shoulder", "elbow", "--data", "a.csv")),
    Case("a suggestion over a file that is there", (*CHECK[:4], "a.csv", "--apply-suggestion", "a.csv")),
    Case("a configuration that does not exist", ("check", "--config", "none.yaml")),
    Case(
        "a configuration with an unknown key",
        ("check", "--config", "c.yaml", "--robot", "robot.urdf", "--data", "a.csv"),
        written("c.yaml", "colour: red\n"),
    ),
    # ------------------------------------------------------------------ columns of a log
    Case("no time column", CHECK, frame(lambda t: t.drop(columns="time"))),
    Case(
        "two columns that look like the time",
        CHECK,
        frame(lambda t: t.rename(columns={"time": "t"}).assign(stamp=t.time)),
    ),
    Case("no position", CHECK, frame(lambda t: t.drop(columns=["q1", "q2"]))),
    Case("one position missing", CHECK, frame(lambda t: t.drop(columns="q2"))),
    Case("no torque", CHECK, frame(lambda t: t.drop(columns=["tau1", "tau2"]))),
    Case("one torque missing", CHECK, frame(lambda t: t.drop(columns="tau1"))),
    Case("one velocity missing", CHECK, frame(lambda t: t.assign(dq1=0.1))),
    Case("a joint too many", CHECK, frame(lambda t: t.assign(q3=0.0, tau3=0.0))),
    Case(
        "columns numbered from 0",
        CHECK,
        frame(lambda t: t.rename(columns={f"{s}{j}": f"{s}{j - 1}" for s in ("q", "tau") for j in (1, 2)})),
    ),
    Case("a column twice", CHECK, lines(lambda t: [t[0].replace("q2", "q1"), *t[1:]])),
    Case(
        "semicolons and decimal commas",
        CHECK,
        lines(lambda t: [x.replace(",", ";").replace(".", ",") for x in t]),
    ),
    Case("decimal commas", CHECK, lines(lambda t: [t[0], *(x.replace(".", ",") for x in t[1:])])),
    Case("a row cut off", CHECK, lines(lambda t: [*t[:-1], t[-1][: len(t[-1]) // 2]])),
    Case("a row with a value too many", CHECK, lines(lambda t: [*t[:40], t[40].strip() + ",1.0\n", *t[41:]])),
    Case("a blank line in the middle", CHECK, lines(lambda t: [*t[:40], "\n", *t[40:]])),
    Case("a second header in the middle", CHECK, lines(lambda t: [*t[:40], t[0], *t[40:]])),
    Case("a word for a number", CHECK, put("tau1", 50, "high")),
    Case("1_0 for a number", CHECK, put("q1", 50, "1_0")),
    Case("a number with its unit", CHECK, put("tau1", 50, "1.5Nm")),
    Case("an empty cell", CHECK, put("tau2", 50, "")),
    Case("NaN", CHECK, put("q2", 50, "nan")),
    Case("inf", CHECK, put("tau1", 50, "inf")),
    Case("1e999, which is inf", CHECK, put("tau1", 50, "1e999")),
    Case("a hexadecimal number", CHECK, put("q1", 50, "0x1F")),
    Case(
        "true and false",
        (*CHECK[:4], "bad.parquet"),
        lambda f: pd.read_csv(f / "a.csv").assign(q1=True).to_parquet(f / "bad.parquet"),
    ),
    Case(
        "texts in a Parquet column",
        (*CHECK[:4], "bad.parquet"),
        lambda f: pd.read_csv(f / "a.csv").assign(q1="x").to_parquet(f / "bad.parquet"),
    ),
    Case(
        "a truncated Parquet file",
        (*CHECK[:4], "bad.parquet"),
        lambda f: (
            (
                pd.read_csv(f / "a.csv").to_parquet(f / "bad.parquet"),
                (f / "bad.parquet").write_bytes((f / "bad.parquet").read_bytes()[:500]),
            )
        ),
    ),
    # ------------------------------------------------------------------ time
    Case("time in milliseconds", CHECK, scaled(1e3, "time")),
    Case("time in nanoseconds", CHECK, scaled(1e9, "time")),
    Case("time goes back", CHECK, frame(lambda t: t.iloc[np.r_[0:400, 300:1200]])),
    Case("time repeats", CHECK, frame(lambda t: t.iloc[np.r_[0:400, 399:1200]])),
    Case("time stands still", CHECK, frame(lambda t: t.assign(time=0.0))),
    Case("stamps coarser than the samples", CHECK, frame(lambda t: t.assign(time=(t["time"] / 0.02).round() * 0.02))),
    Case("time is a date", CHECK, put("time", 50, "2024-05-01 12:00:00")),
    Case("five rows", CHECK, frame(lambda t: t.iloc[:5])),
    Case("half a second", CHECK, frame(lambda t: t.iloc[:110])),
    Case("5 Hz", CHECK, frame(lambda t: t.iloc[::40])),
    Case("5 Hz, in close-loop", CLOSE, frame(lambda t: t.iloc[::40])),
    Case("3 Hz of motion at 15 Hz", CHECK, lambda f: _fast(f)),
    Case("gaps everywhere", CHECK, frame(lambda t: t.assign(time=t["time"] + 0.3 * (np.arange(len(t)) // 30)))),
    Case(
        "dq says that time runs ten times too slow",
        CHECK,
        several(
            velocity(lambda d: d),
            lambda f: (
                pd.read_csv(f / "bad.csv").assign(time=lambda t: 10 * t["time"]).to_csv(f / "bad.csv", index=False)
            ),
        ),
    ),
    # ------------------------------------------------------------------ positions and velocities
    Case("positions in degrees", CHECK, scaled(np.rad2deg(1), "q1", "q2")),
    Case("positions in degrees, in close-loop", CLOSE, scaled(np.rad2deg(1), "q1", "q2")),
    Case("positions in encoder counts", CHECK, scaled(1e4, "q1", "q2")),
    Case("velocities in deg/s", CHECK, velocity(np.rad2deg)),
    Case("velocities in deg/s, in close-loop", CLOSE, velocity(np.rad2deg)),
    Case("velocities in deg/s, in predict", PREDICT_LOG, velocity(np.rad2deg)),
    Case("positions in degrees, in predict", PREDICT_LOG, scaled(np.rad2deg(1), "q1", "q2")),
    Case("joints exchanged, in predict", PREDICT_LOG, frame(lambda t: t.set_axis(OTHER_ORDER, axis=1))),
    Case("torque in N mm, in predict", PREDICT_LOG, scaled(1e3, "tau1", "tau2")),
    Case("torques with the wrong sign, in predict", PREDICT_LOG, scaled(-1, "tau1", "tau2")),
    Case("one torque with the wrong sign, in predict", PREDICT_LOG, scaled(-1, "tau2")),
    Case("velocities in rpm", CHECK, velocity(lambda d: d * 60 / (2 * np.pi))),
    Case("velocities of the motor", CHECK, velocity(lambda d: d * [100.0, 80.0])),
    Case("velocities with the wrong sign", CHECK, velocity(lambda d: -d)),
    Case("one velocity with the wrong sign", CLOSE, velocity(lambda d: d * [1.0, -1.0])),
    Case("velocities exchanged", CHECK, velocity(lambda d: d[:, ::-1])),
    Case("velocities 0.2 s late", CHECK, velocity(lambda d: np.roll(d, 40, axis=0))),
    Case("accelerations for velocities", CHECK, velocity(lambda d: np.gradient(d, 0.005, axis=0))),
    Case(
        "positions do not change", (*CLOSE[:4], "bad.csv", "--out", "out"), frame(lambda t: t.assign(q1=0.3, q2=-0.2))
    ),
    Case(
        "the arm rests in the test run",
        (*CLOSE[:4], "a.csv", "--test", "bad.csv", "--out", "out"),
        frame(lambda t: t.assign(q1=0.3, q2=-0.2)),
    ),
    # ------------------------------------------------------------------ torque
    Case("torque is zero", CHECK, scaled(0.0, "tau1", "tau2")),
    Case("torque is constant", CHECK, frame(lambda t: t.assign(tau1=3.0, tau2=1.0))),
    Case("torque in N mm", CHECK, scaled(1e3, "tau1", "tau2")),
    Case(
        "torque in N mm, in close-loop",
        CLOSE,
        several(
            scaled(1e3, "tau1", "tau2"),
            lambda f: (
                pd.read_csv(f / "b.csv")
                .assign(tau1=lambda t: 1e3 * t["tau1"], tau2=lambda t: 1e3 * t["tau2"])
                .to_csv(f / "b.csv", index=False)
            ),
        ),
    ),
    Case("torque in N cm", CHECK, scaled(1e2, "tau1", "tau2")),
    Case("torque in kN m", CHECK, scaled(1e-3, "tau1", "tau2")),
    Case("torque on the motor's side", CHECK, scaled((1 / 100, 1 / 50), "tau1", "tau2")),
    Case("torque to which the controller adds gravity itself", CHECK, lambda f: _without_weight(f)),
    Case("torque to which the controller adds gravity itself, in close-loop", CLOSE, lambda f: _without_weight(f)),
    Case(
        "torque to which the controller adds gravity itself, in predict",
        PREDICT_LOG,
        lambda f: _without_weight(f),
    ),
    Case("all torques with the wrong sign", CHECK, scaled(-1.0, "tau1", "tau2")),
    Case(
        "torques without their sign",
        CHECK,
        frame(lambda t: t.assign(tau1=t["tau1"].abs(), tau2=t["tau2"].abs())),
    ),
    Case("one torque with the wrong sign", CHECK, scaled(-1.0, "tau1")),
    Case(
        "one torque with the wrong sign, in the test log",
        (*CLOSE[:4], "a.csv", "--test", "bad.csv", "--out", "out"),
        lambda f: pd.read_csv(f / "test.csv").assign(tau1=lambda t: -t["tau1"]).to_csv(f / "bad.csv", index=False),
    ),
    Case("the wrong sign in one training log of two", CLOSE, scaled(-1.0, "tau1", "tau2")),
    Case("torques exchanged", CHECK, frame(lambda t: t.rename(columns={"tau1": "tau2", "tau2": "tau1"}))),
    Case(
        "torque 0.2 s late",
        CHECK,
        frame(lambda t: t.assign(tau1=t["tau1"].shift(40, fill_value=0.0), tau2=t["tau2"].shift(40, fill_value=0.0))),
    ),
    Case(
        "torque 0.2 s late, in close-loop",
        CLOSE,
        frame(lambda t: t.assign(tau1=t["tau1"].shift(40, fill_value=0.0), tau2=t["tau2"].shift(40, fill_value=0.0))),
    ),
    Case("a position that counts backwards", CHECK, scaled(-1.0, "q1")),
    # ------------------------------------------------------------------ the robot
    # What the logs can be read without: told, and no reason to stop.
    Case("a torque sample that is 300 N m off", CHECK, shifted("tau1", 300.0), 0, "glitch"),
    Case("a torque sample that is 3000 N m off", CHECK, shifted("tau1", 3000.0), 0, "glitch"),
    Case("a torque sample of 1e300", CHECK, put("tau1", 50, 1e300), 0, "glitch"),
    Case("a position sample that is 0.5 rad off", CHECK, shifted("q2", 0.5), 0, "glitch"),
    Case("velocities of zero", CHECK, velocity(lambda d: 0 * d), 0, "dq_zero"),
    Case("a gap of half a second", CHECK, frame(lambda t: t.drop(range(300, 400))), 0, "gaps"),
    Case(
        "a torque that is cut off at 20 N m",
        CHECK,
        frame(lambda t: t.assign(tau1=t["tau1"].clip(-20, 20))),
        0,
        "saturation",
    ),
    Case("a joint that stands still", CHECK, frame(lambda t: t.assign(q2=0.3)), 0, "range"),
    Case("time that runs ten times too slow", CHECK, frame(lambda t: t.assign(time=10 * t["time"]))),
    Case(
        "columns of two joints exchanged",
        CHECK,
        frame(lambda t: t.rename(columns={"q1": "q2", "q2": "q1", "tau1": "tau2", "tau2": "tau1"})),
    ),
    Case("no URDF", (*OTHER_URDF[:2], "none.urdf", "--data", "a.csv")),
    Case("a URDF that is no XML", OTHER_URDF, written("bad.urdf", "robot: arm\n")),
    Case("a URDF cut off", OTHER_URDF, written("bad.urdf", URDF[:400])),
    Case("an empty URDF", OTHER_URDF, written("bad.urdf", "")),
    Case("an MJCF file", OTHER_URDF, written("bad.urdf", '<mujoco model="x"/>')),
    Case("an SDF file", OTHER_URDF, written("bad.urdf", '<sdf version="1.6"><model name="x"/></sdf>')),
    Case(
        "xacro, not expanded",
        OTHER_URDF,
        written("bad.urdf", '<robot xmlns:xacro="http://ros.org/wiki/xacro" name="x"><xacro:macro name="m"/></robot>'),
    ),
    Case("xacro expressions left over", OTHER_URDF, urdf('value="4"', 'value="${mass}"')),
    Case("a document type definition", OTHER_URDF, written("bad.urdf", '<!DOCTYPE robot [<!ENTITY a "b">]>' + URDF)),
    Case("no joint that moves", OTHER_URDF, urdf('type="revolute"', 'type="fixed"', 2)),
    Case("a floating base", OTHER_URDF, urdf('type="revolute"', 'type="floating"')),
    Case("a planar joint", OTHER_URDF, urdf('type="revolute"', 'type="planar"')),
    Case("a joint of unknown type", OTHER_URDF, urdf('type="revolute"', 'type="hinge"')),
    Case("a joint without a name", OTHER_URDF, urdf('joint name="elbow"', 'joint name=""')),
    Case("two joints with one name", OTHER_URDF, urdf('joint name="elbow"', 'joint name="shoulder"')),
    Case("a link without a name", OTHER_URDF, urdf('link name="fore"', 'link name=""')),
    Case("two links with one name", OTHER_URDF, urdf('<link name="fore">', '<link name="upper">')),
    Case("a joint to a link that is not there", OTHER_URDF, urdf('child link="fore"', 'child link="hand"')),
    Case("two bases", OTHER_URDF, urdf('<link name="base"/>', '<link name="base"/><link name="table"/>')),
    Case("a closed chain", OTHER_URDF, urdf('<parent link="base"/>', '<parent link="fore"/>')),
    Case(
        "a link on two joints",
        OTHER_URDF,
        urdf("</robot>", JOINT.format("again", "revolute", "base", "fore", "") + "</robot>"),
    ),
    Case("a negative mass", OTHER_URDF, urdf('mass value="4"', 'mass value="-4"')),
    Case("a mass that is no number", OTHER_URDF, urdf('mass value="4"', 'mass value="heavy"')),
    Case("a mass of 1_0", OTHER_URDF, urdf('mass value="4"', 'mass value="1_0"')),
    Case("no mass at all", OTHER_URDF, urdf('<mass value="2"/>', "")),
    Case("a moving link without inertia", OTHER_URDF, urdf('mass value="2"', 'mass value="0"')),
    Case("a negative moment of inertia", OTHER_URDF, urdf('ixx="0.06"', 'ixx="-0.06"')),
    Case("moments of inertia no body has", OTHER_URDF, urdf('izz="0.01"', 'izz="0.9"')),
    Case("an axis of zero", OTHER_URDF, urdf('axis xyz="0 1 0"', 'axis xyz="0 0 0"')),
    Case("an axis of two numbers", OTHER_URDF, urdf('axis xyz="0 1 0"', 'axis xyz="0 1"')),
    Case("a place that is no number", OTHER_URDF, urdf('xyz="0 0 0.4"', 'xyz="0 0 nan"')),
    Case("no limits", OTHER_URDF, urdf('<limit lower="-2.5" upper="2.5" velocity="4" effort="60"/>', "")),
    Case("limits the wrong way round", OTHER_URDF, urdf('lower="-2.5" upper="2.5"', 'lower="2.5" upper="-2.5"')),
    Case("a negative effort limit", OTHER_URDF, urdf('effort="60"', 'effort="-60"')),
    Case("damping that drives", OTHER_URDF, urdf("</joint>", '<dynamics damping="-1"/></joint>')),
    Case("damping that is no number", OTHER_URDF, urdf("</joint>", '<dynamics damping="some"/></joint>')),
    Case("a joint that mimics nothing", OTHER_URDF, with_joint(extra='<mimic joint="none"/>')),
    Case("a mimic factor that is no number", OTHER_URDF, with_joint(extra='<mimic joint="elbow" multiplier="x"/>')),
    Case("a robot with a joint more than the log", OTHER_URDF, with_joint()),
    # ------------------------------------------------------------------ model.json
    Case("no model", (*PREDICT[:3], "--model", "none.json", *PREDICT[5:])),
    Case("a model that is no JSON", PREDICT, written("bad.json", "not json")),
    Case("an empty model", PREDICT, written("bad.json", "")),
    Case(
        "a model cut off", PREDICT, lambda f: (f / "bad.json").write_text((f / "model.json").read_text()[:300]) and None
    ),
    Case("a list for a model", PREDICT, written("bad.json", "[1, 2]")),
    Case("deeply nested JSON", PREDICT, written("bad.json", "[" * 100_000)),
    Case(
        "NaN in a model",
        PREDICT,
        lambda f: (f / "bad.json").write_text((f / "model.json").read_text().replace("3.0", "NaN", 1)),
    ),
    Case(
        "1e999 in a model",
        PREDICT,
        lambda f: (f / "bad.json").write_text((f / "model.json").read_text().replace("3.0", "1e999", 1)),
    ),
    Case(
        "a key twice in a model",
        PREDICT,
        lambda f: (f / "bad.json").write_text((f / "model.json").read_text().replace("{", '{"schema": 1,', 1)),
    ),
    Case("a model of a newer schema", PREDICT, model(lambda m: m | {"schema": 99, "colour": "red"})),
    Case("a model without effects", PREDICT, model(lambda m: {k: v for k, v in m.items() if k != "effects"})),
    Case("a model with an unknown key", PREDICT, model(lambda m: m | {"colour": "red"})),
    Case("an unknown effect", PREDICT, model(lambda m: entry(m).update(effect="magic"))),
    Case("an effect on a joint that is not there", PREDICT, model(lambda m: entry(m).update(joints=["hip"]))),
    Case("an effect without its joint", PREDICT, model(lambda m: entry(m).update(joints=[]))),
    Case("an unknown setting of an effect", PREDICT, model(lambda m: entry(m).update(settings={"colour": 1}))),
    Case("a parameter called otherwise", PREDICT, model(lambda m: parameter(m).update(name="strength"))),
    Case("a text for a value", PREDICT, model(lambda m: parameter(m).update(value="3"))),
    Case("true for a value", PREDICT, model(lambda m: parameter(m).update(value=True))),
    Case("null for a value", PREDICT, model(lambda m: parameter(m).update(value=None))),
    Case("a number that no robot has", PREDICT, model(lambda m: parameter(m).update(value=1e300))),
    Case("friction that drives", PREDICT, model(lambda m: parameter(m).update(value=-3.0))),
    Case("joints in another order", PREDICT, model(lambda m: m.update(joints=["elbow", "shoulder"]))),
    Case(
        "a model of another robot with the same joints",
        ("predict", "--robot", "bad.urdf", "--model", "model.json", "--data", "test.csv", "--out", "tau.csv"),
        urdf('mass value="2"', 'mass value="8"'),
    ),
    # ------------------------------------------------------------------ settings
    Case("an unknown setting", setting("magic=1")),
    Case("a setting without a value", setting("block")),
    Case("a word for a number in a setting", setting("block=long")),
    Case("a setting out of range", setting("block=-1")),
    Case("an effect that is not in the catalogue", setting("effects=[viscous]")),
    Case("an effect twice", setting("effects=[armature,armature]")),
    Case("a number where a list is expected", setting("sign_widths=0.1")),
    Case("a cut-off of zero", setting("process.cutoff=0")),
    Case("a group of settings for one", setting("process=1")),
    Case("half an effect", setting("max_effects=1.5")),
    # ------------------------------------------------------------------ logs in another form
    Case("a log.yaml that does not exist", (*CHECK[:4], "a.csv", "--log", "none.yaml")),
    Case("a log.yaml that is no YAML", *described("columns: [")),
    Case("a log.yaml with an unknown key", *described("colums: {q: 'q{i}'}")),
    Case("a log.yaml with an unknown unit", *described("units: {q: grad}")),
    Case("a column that is not in the log", *described("columns: {q: 'actual_q_{i}'}")),
    Case("a current without a torque constant", *described("units: {tau: A}")),
    Case("gravity of a kind that is not known", *described("gravity: compensate")),
    Case("three signs for two joints", *described("sign: {tau: [1, -1, 1]}")),
    Case("a sign of 2", *described("sign: {tau: [2, 1]}")),
    Case("a gear ratio of zero", *described("gear_ratio: [0, 1]\nmotor_side: [tau]")),
    Case("a list for a log.yaml", *described("- q\n- tau")),
    Case("--units with an unknown word", (*CHECK[:4], "a.csv", "--units", "furlong")),
    Case("--columns without a name", (*CHECK[:4], "a.csv", "--columns", "q")),
]


def _fast(folder: Path) -> None:
    time = np.arange(0, 40, 1 / 15)
    q = np.sin(2 * np.pi * np.outer(time, [3.0, 3.3]))
    table = pd.DataFrame({"time": time, "q1": q[:, 0], "q2": q[:, 1], "tau1": 5 * q[:, 1], "tau2": q[:, 0]})
    table.to_csv(folder / "bad.csv", index=False)


def _without_weight(folder: Path) -> None:
    table = pd.read_csv(folder / "a.csv")
    q = table[["q1", "q2"]].to_numpy()
    table[["tau1", "tau2"]] -= arm().inverse_dynamics(q, 0 * q, 0 * q)
    table.to_csv(folder / "bad.csv", index=False)


def good(folder: Path) -> None:
    """The files that nothing is wrong with: robot.urdf, a.csv, b.csv, test.csv, model.json."""
    (folder / "robot.urdf").write_text(URDF, encoding="utf-8")
    train, test = excitations(arm(), HIDDEN, train=2, test=1, duration=6.0, rate=200.0)
    for name, run in zip(("a", "b", "test"), (*train, *test), strict=True):
        columns = {"time": run.time} | {f"{s}{j + 1}": run[s][:, j] for s in ("q", "tau") for j in range(2)}
        # As many digits as every machine computes alike: an error may quote a row.
        pd.DataFrame(columns).to_csv(folder / f"{name}.csv", index=False, float_format="%.9g")
    save_model(folder / "model.json", Model(arm(), HIDDEN))


def outcome(case: Case, folder: Path) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of ``case`` in ``folder``, which holds the good files and the bad one."""
    out, err = io.StringIO(), io.StringIO()
    code = 0
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(list(case.arguments))
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else 1
    return code, out.getvalue(), err.getvalue()


def line_of(case: Case, out: str, err: str) -> str:
    """What the user reads first: the error; for ``check`` the first finding that is wrong, or the one that tells it."""
    findings = [line.split() for line in out.splitlines() if len(line.split()) > 1]
    found = [" ".join(words) for words in findings if words[0] == "WRONG" or words[1] == case.told]
    errors = [line for line in err.splitlines() if line.startswith("error:")]
    return " ".join((found or errors or [""])[0].split())


def page(rows: list[tuple[Case, int, str]]) -> str:
    """The table as Markdown."""
    head = """# Bad inputs

What comes out when something is wrong with what goes in: the command's exit code and its line. Written by
`make pages`; the tests run every row and compare. In the commands `bad.*` is the file that is wrong;
the others are good. `check` prints all findings as a table, of which one is shown here: with exit code 2 the first that is wrong,
with 0 the one that tells how the logs are read all the same.

| what is wrong | command | exit | line |
|---|---|---|---|
"""
    cells = []
    for case, code, line in rows:
        words = " ".join(("hybrid-dynamics", *case.arguments))
        cells.append("| " + " | ".join((case.what, f"`{words}`", str(code), f"`{_escaped(line)}`")) + " |")
    return head + "\n".join(cells) + "\n"


def _escaped(text: str) -> str:
    return text.replace("|", "\\|").replace("`", "'")


def run_all() -> list[tuple[Case, int, str]]:
    rows = []
    with tempfile.TemporaryDirectory() as base:
        good(Path(base))
        for case in CASES:
            with tempfile.TemporaryDirectory() as own:
                for file in Path(base).iterdir():
                    (Path(own) / file.name).write_bytes(file.read_bytes())
                case.make(Path(own))
                code, out, err = outcome(case, Path(own))
                rows.append((case, code, line_of(case, out, err)))
    return rows


if __name__ == "__main__":
    PAGE.write_text(page(run_all()), encoding="utf-8")
    print(f"{PAGE}: {len(CASES)} bad inputs")
