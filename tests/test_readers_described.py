"""Logs described by a log.yaml: the same motion written in many forms comes back the same, wrong forms do not pass."""

from __future__ import annotations

import gzip
import io
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hybrid_dynamics.errors import ConfigError, HybridDynamicsError, InputError
from hybrid_dynamics.readers import describe, from_options, load_description, read_log
from hybrid_dynamics.readers.delimited import standard_input
from hybrid_dynamics.readers.described import decimated
from hybrid_dynamics.readers.resample import ResampleSettings
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

JOINTS = ("base", "shoulder", "wrist")
TIME = 0.01 * np.arange(400)


def motion(time: Array) -> dict[str, Array]:
    w = np.array([1.0, 2.3, 3.1])
    q = 0.6 * np.sin(time[:, None] * w + [0.0, 1.0, 2.0])
    return {"q": q, "dq": 0.6 * w * np.cos(time[:, None] * w + [0.0, 1.0, 2.0]), "tau": 20 * q**3 + [3.0, -1.0, 0.2]}


def table(columns: Mapping[str, Array], mark: str = ",", header: bool = True) -> str:
    lines = [mark.join(columns)] if header else []
    return "\n".join([*lines, *(mark.join(f"{x:.12g}" for x in row) for row in zip(*columns.values(), strict=True))])


def named(signals: Mapping[str, Array], names: Mapping[str, str], time: Array | None = None) -> dict[str, Array]:
    out = {} if time is None else {names["time"]: time}
    for signal, values in signals.items():
        for j, joint in enumerate(JOINTS):
            out[names[signal].replace("{i}", str(j + 1)).replace("{i0}", str(j)).replace("{joint}", joint)] = values[
                :, j
            ]
    return out


def same(run: Trajectory, dq: bool = True, atol: float = 1e-8) -> None:
    true = motion(TIME)
    assert ("dq" in run) is dq
    np.testing.assert_allclose(run.time, TIME, atol=1e-9)
    for signal in run.signals:
        np.testing.assert_allclose(run[signal], true[signal], atol=atol)


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


NAMES = {"time": "stamp", "q": "actual_q_{i0}", "dq": "{joint}/velocity", "tau": "torque{i}"}
COLUMNS = {"columns": dict(NAMES)}


def test_names_units_and_extra_columns(tmp_path: Path) -> None:
    true = motion(TIME)
    other = {"q": np.degrees(true["q"]), "dq": np.degrees(true["dq"]), "tau": 1e3 * true["tau"]}
    columns = {"mode": np.ones(len(TIME)), **named(other, NAMES, 1e3 * TIME)}
    path = write(tmp_path / "run.csv", table(columns, ";"))
    units = {"time": "ms", "q": "deg", "tau": "Nmm"}
    same(read_log(path, JOINTS, log=describe({**COLUMNS, "units": units})))
    same(
        read_log(
            path, JOINTS, log=from_options(columns=",".join(f"{k}={v}" for k, v in NAMES.items()), units="ms,deg,Nmm")
        )
    )
    # The control: the same file without the units is another motion.
    assert np.abs(read_log(path, JOINTS, log=describe({**COLUMNS, "units": {"time": "ms"}}))["q"]).max() > 30


def test_joints_in_another_order(tmp_path: Path) -> None:
    path = write(
        tmp_path / "run.csv",
        table({"time": TIME, **{f"{s}{j + 1}": v[:, 2 - j] for s, v in motion(TIME).items() for j in range(3)}}),
    )
    same(read_log(path, JOINTS, log=describe({"joints": list(JOINTS[::-1])})))
    with pytest.raises(ConfigError, match="expected the robot's joints base, shoulder, wrist"):
        read_log(path, JOINTS, log=describe({"joints": ["base", "elbow", "wrist"]}))


@pytest.mark.parametrize("mark", [",", "\t", "  "])
def test_no_header_and_column_numbers(tmp_path: Path, mark: str) -> None:
    true = motion(TIME)
    columns = {
        str(k): v for k, v in enumerate([*true["q"].T, *true["dq"].T, *np.zeros((3, len(TIME))), *true["tau"].T])
    }
    path = write(tmp_path / "run.txt", "# a remark\n" + table(columns, mark, header=False))
    keys = {"header": False, "skip_rows": 1, "rate": 100, "columns": {"q": "1-3", "dq": "4-6", "tau": "10-12"}}
    same(read_log(path, JOINTS, log=describe(keys)))
    first, last = 101, 300
    part = read_log(path, JOINTS, log=describe({**keys, "rows": [first, last]}))
    np.testing.assert_allclose(part["q"], true["q"][first - 1 : last], atol=1e-9)


def test_a_run_in_several_files_and_one_number_a_line(tmp_path: Path) -> None:
    true = motion(TIME)
    for signal, values in {"time": TIME[:, None], "position": true["q"], "effort": true["tau"]}.items():
        write(tmp_path / "rec" / f"first_{signal}.txt", "\n".join(f"{x:.12g}" for x in values.ravel()))
    keys = {
        "header": False,
        "files": {"time": "{run}_time.txt", "q": "{run}_position.txt", "tau": "{run}_effort.txt"},
        "columns": {"time": 1, "q": "stacked", "tau": "stacked"},
    }
    same(read_log(tmp_path / "rec" / "first", JOINTS, log=describe(keys)), dq=False)
    with pytest.raises(InputError, match=re.escape("second_time.txt: no such file (log.files.time")):
        read_log(tmp_path / "rec" / "second", JOINTS, log=describe(keys))
    write(tmp_path / "rec" / "first_effort.txt", "1\n2\n3")
    with pytest.raises(InputError, match="400 of time, 400 of q, 1 of tau samples"):
        read_log(tmp_path / "rec" / "first", JOINTS, log=describe(keys))


def test_packed_and_from_standard_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = table(named(motion(TIME), {"time": "time", "q": "q{i}", "dq": "dq{i}", "tau": "tau{i}"}, TIME)).encode()
    path = tmp_path / "run.csv.gz"
    path.write_bytes(gzip.compress(text))
    same(read_log(path, JOINTS))
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(text)))
    standard_input.cache_clear()
    same(read_log("-", JOINTS))
    standard_input.cache_clear()
    path.write_bytes(gzip.compress(text)[:-40])
    with pytest.raises(InputError, match="not a readable gzip file"):
        read_log(path, JOINTS)


GEAR = np.array([[100.0, 0, 0], [0, -50.0, 0], [0, 30.0, 80.0]])


def test_motor_side_through_a_gear_matrix(tmp_path: Path) -> None:
    """Power is the same on both sides of the gear; with the matrix transposed it is not."""
    true = motion(TIME)
    motor = {"q": true["q"] @ GEAR.T, "dq": true["dq"] @ GEAR.T, "tau": np.linalg.solve(GEAR.T, true["tau"].T).T}
    np.testing.assert_allclose((motor["dq"] * motor["tau"]).sum(axis=1), (true["dq"] * true["tau"]).sum(axis=1))
    path = write(tmp_path / "run.csv", table(named(motor, NAMES, TIME)))
    keys: dict[str, Any] = {**COLUMNS, "motor_side": ["q", "dq", "tau"], "gear_matrix": GEAR.tolist()}
    same(read_log(path, JOINTS, log=describe(keys)), atol=1e-7)
    wrong = read_log(path, JOINTS, log=describe({**keys, "gear_matrix": GEAR.T.tolist()}))
    assert np.abs(wrong["tau"] - true["tau"]).max() > 0.1


def test_current_sign_gain_offset(tmp_path: Path) -> None:
    true = motion(TIME)
    constant, ratio, gain = np.array([0.1, 0.2, 0.05]), np.array([100.0, 80.0, 50.0]), np.array([1.1, 0.9, 1.0])
    other = {
        "q": -(true["q"] - [0.0, 1.5, 0.0]),
        "dq": -true["dq"],
        "tau": 1e3 * (true["tau"] - 0.5) / (constant * ratio * gain),
    }
    path = write(tmp_path / "run.csv", table(named(other, NAMES, TIME)))
    keys = {
        **COLUMNS,
        "units": {"tau": "mA"},
        "torque_constant": constant.tolist(),
        "gear_ratio": ratio.tolist(),
        "motor_side": "tau",
        "sign": {"q": -1, "dq": [-1, -1, -1]},
        "gain": {"tau": gain.tolist()},
        "offset": {"q": [0.0, 1.5, 0.0], "tau": 0.5},
    }
    same(read_log(path, JOINTS, log=describe(keys)), atol=1e-7)


def test_a_joint_whose_torque_nobody_measured(tmp_path: Path) -> None:
    true, said = motion(TIME), list[str]()
    whole = named(true, {"time": "t", "q": "q{i}", "dq": "dq{i}", "tau": "effort_{joint}"}, TIME)
    columns = {"time": "t", "tau": "effort_{joint}"}
    keys = {"columns": columns, "no_torque": ["shoulder"], "offset": {"tau": 3.0}}
    without = {name: values for name, values in whole.items() if name != "effort_shoulder"}
    listed = {**columns, "tau": ["effort_base", "effort_wrist"]}
    every = {**columns, "tau": ["effort_base", "effort_shoulder", "effort_wrist"]}
    for content, own in (
        (whole, keys),
        (without, keys),
        (without, {**keys, "columns": listed}),
        (without, {**keys, "columns": every}),
    ):
        path = write(tmp_path / "run.csv", table(content))
        run = read_log(path, JOINTS, log=describe(own), notify=said.append)
        assert not run["tau"][:, 1].any()
        np.testing.assert_allclose(run["tau"][:, [0, 2]], true["tau"][:, [0, 2]] + 3.0)
        np.testing.assert_allclose(run["q"], true["q"])
    assert any("tau2 (shoulder) is zero throughout: nothing to learn about that joint" in line for line in said)
    numbered = write(tmp_path / "bare.csv", table(without, header=False))
    run = read_log(
        numbered,
        JOINTS,
        log=describe(
            {"header": False, "columns": {"time": 1, "q": "2-4", "dq": "5-7", "tau": "8-9"}, "no_torque": ["shoulder"]}
        ),
    )
    np.testing.assert_allclose(run["tau"][:, 2], true["tau"][:, 2])
    gear = {"motor_side": ["tau"], "gear_matrix": [[50, 0, 0], [30, 60, 0], [0, 0, 40]]}
    with pytest.raises(ConfigError, match=r"log\.no_torque holds shoulder, whose motor turns other joints, too"):
        read_log(path, JOINTS, log=describe({**keys, **gear}))
    with pytest.raises(ConfigError, match=r"log\.no_torque holds 'elbow'; expected joints of the"):
        read_log(path, JOINTS, log=describe({**keys, "no_torque": ["elbow"]}))


def test_commanded_torque(tmp_path: Path) -> None:
    true = motion(TIME)
    names = {"time": "time", "q": "q{i}", "dq": "dq{i}", "tau": "cmd{i}"}
    columns = {**named(true, names, TIME), **{f"tau{j}": np.full(len(TIME), 7.0) for j in (1, 2, 3)}}
    path = write(tmp_path / "run.csv", table(columns))
    same(read_log(path, JOINTS, log=from_options(columns="tau_commanded=cmd{i}", torque="commanded")))
    assert np.all(read_log(path, JOINTS, log=from_options(columns="tau_commanded=cmd{i}"))["tau"] == 7.0)


def test_delay_of_the_torque(tmp_path: Path) -> None:
    true, late = motion(TIME), motion(TIME - 0.037)
    names = {"time": "time", "q": "q{i}", "dq": "dq{i}", "tau": "tau{i}"}
    path = write(tmp_path / "run.csv", table(named({**true, "tau": late["tau"]}, names, TIME)))
    run = read_log(path, JOINTS, log=describe({"torque_delay": 0.037}))
    np.testing.assert_allclose(run["tau"], motion(run.time)["tau"], atol=1e-5)
    np.testing.assert_allclose(run["q"], motion(run.time)["q"], atol=1e-9)
    wrong = read_log(path, JOINTS, log=describe({"torque_delay": -0.037}))
    assert np.abs(wrong["tau"] - motion(wrong.time)["tau"]).max() > 1


def polled(seed: int) -> tuple[Array, Array]:
    """Sampling instants of a 1 kHz controller that is polled at irregular instants, and the stamps of the polls."""
    rng = np.random.default_rng(seed)
    asked = np.cumsum(rng.uniform(0.3e-3, 1.8e-3, 6000))
    return np.floor(asked / 1e-3) * 1e-3, asked + rng.uniform(-1e-4, 1e-4, len(asked))


def test_time_told_from_velocity(tmp_path: Path) -> None:
    """Samples that a poller repeats and skips: their true ticks follow from position and velocity."""
    tick, stamp = polled(1)
    true = motion(tick)
    names = {"time": "time", "q": "q{i}", "dq": "dq{i}", "tau": "tau{i}"}
    path = write(tmp_path / "run.csv", table(named(true, names, stamp)))
    keys = {"clock": "velocity", "tick": 1e-3, "drop": ["dq"]}
    said: list[str] = []
    run = read_log(path, JOINTS, log=describe(keys), notify=said.append)
    assert run.dt == pytest.approx(1e-3)
    assert "dq" not in run
    offset = tick[0] - run.time[0]
    assert np.abs(run["q"] - motion(run.time + offset)["q"]).max() < 1e-6
    assert any("samples are repeated" in line for line in said)
    # The control: with the stamps as recorded the position jitters a thousand times more.
    rough = read_log(path, JOINTS)
    assert np.abs(rough["q"] - motion(rough.time)["q"]).max() > 5e-4
    with pytest.raises(InputError, match="whole ticks of 3 ms"):
        read_log(path, JOINTS, log=describe({**keys, "tick": 3e-3}))


def test_even_clock(tmp_path: Path) -> None:
    jitter = TIME + np.random.default_rng(0).uniform(-3e-3, 3e-3, len(TIME))
    jitter[[0, -1]] = TIME[[0, -1]]
    names = {"time": "time", "q": "q{i}", "dq": "dq{i}", "tau": "tau{i}"}
    path = write(tmp_path / "run.csv", table(named(motion(TIME), names, jitter)))
    same(read_log(path, JOINTS, log=describe({"clock": "even"})))


def test_decimation_keeps_the_motion_and_takes_out_what_would_alias() -> None:
    time = 2e-4 * np.arange(20_000)
    slow, fast = np.sin(2 * np.pi * 3 * time), np.sin(2 * np.pi * 1060 * time)
    run = Trajectory("run", "train", time, {"q": np.column_stack([slow, slow + fast])})
    out = decimated(run, 5, ResampleSettings())
    assert out.dt == pytest.approx(1e-3)
    assert len(out.time) == 4000
    expected = np.sin(2 * np.pi * 3 * out.time)
    assert np.abs(out["q"][:, 0] - expected).max() < 2e-3
    assert np.abs(out["q"][50:-50, 1] - expected[50:-50]).max() < 1e-2
    assert np.abs(run["q"][::5, 1] - expected).max() > 0.9


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ({"colums": {}}, "log: colums: 'colums' is unknown (did you mean 'columns'?)"),
        ({"columns": {"qd": "x"}}, "log.columns.qd: 'qd' is unknown"),
        ({"units": {"q": "degrees"}}, "log.units.q: 'degrees' is unknown (did you mean 'deg'?)"),
        ({"units": {"tau": "A"}}, "log.units.tau is a current; expected also log.torque_constant"),
        ({"torque_constant": 0.1}, "expected log.units.tau A or mA"),
        (
            {"gear_ratio": [1, 2, 0], "motor_side": "tau"},
            "log.gear_ratio is [1.0, 2.0, 0.0]; expected values other than 0",
        ),
        ({"gear_ratio": 100}, "without log.motor_side"),
        ({"motor_side": ["q"]}, "expected also log.gear_ratio or log.gear_matrix"),
        ({"clock": "velocity"}, "expected also log.tick"),
        ({"clock": "gps"}, "log.clock: 'gps' is unknown"),
        ({"rows": [5, 5]}, "log.rows is [5, 5]; expected [first, last]"),
        ({"decimate": 0}, "log.decimate is 0"),
        ({"decimate": 2.5}, "decimate is 2.5"),
        ({"header": "maybe"}, "header is 'maybe'"),
        ({"sign": {"q": 2}}, "log.sign.q is [2.0]; expected 1 and -1"),
        ({"sign": {"theta": 1}}, "sign.theta: 'theta' is unknown"),
        ({"gain": {"tau": 0}}, "expected values other than 0"),
        ({"torque": "commanded"}, "expected log.columns.tau_commanded"),
    ],
)
def test_a_wrong_description_is_refused_in_one_line(keys: dict[str, Any], line: str) -> None:
    with pytest.raises(ConfigError) as error:
        describe(keys)
    assert line in str(error.value)
    assert "\n" not in str(error.value)


def test_a_description_that_does_not_fit_the_log(tmp_path: Path) -> None:
    names = {"time": "time", "q": "q{i}", "dq": "dq{i}", "tau": "tau{i}"}
    path = write(tmp_path / "run.csv", table(named(motion(TIME), names, TIME)))
    for keys, line in (
        ({"columns": {"q": "pos{i}"}}, "column 'pos1' of q is missing; it holds time, q1, q2"),
        ({"columns": {"q": ["q1", "q2"]}}, "2 columns; expected 3 columns, one a joint"),
        ({"columns": {"time": "t"}}, "column 't' of time is missing"),
        ({"rows": [1, 4000]}, "rows 1 to 4000 asked for; it holds 400 samples"),
        ({"gain": {"q": [1, 2]}}, "log.gain.q has 2 values; expected 3"),
        ({"gear_matrix": [[1, 2], [3, 4]], "motor_side": "q"}, "log.gear_matrix is 2 x 2; expected 3 x 3"),
        ({"gear_matrix": [[1, 1, 0], [1, 1, 0], [0, 0, 1]], "motor_side": "q"}, "cannot be inverted"),
        ({"torque_delay": 5}, "expected more than the delay 5 s"),
    ):
        with pytest.raises((InputError, ConfigError)) as error:
            read_log(path, JOINTS, log=describe(keys))
        assert line in str(error.value)
        assert "\n" not in str(error.value)
    broken = path.read_text().splitlines()
    broken[7] += ",1"
    with pytest.raises(InputError, match="row 8 has 11 columns; expected 10 as in the header"):
        read_log(write(tmp_path / "ragged.csv", "\n".join(broken)), JOINTS, log=describe({}))


def test_log_yaml_and_the_command_line(tmp_path: Path) -> None:
    path = write(tmp_path / "log.yaml", 'columns: {q: "pos_{i}"}\ntick: 1e-3\nunits: {q: deg}\n')
    assert load_description(path).tick == 1e-3
    both = from_options(log=path, columns="tau=effort_{joint}", units="rad")
    assert both is not None
    assert both.columns == {"q": "pos_{i}", "tau": "effort_{joint}"}
    assert both.units == {"q": "rad"}
    assert from_options() is None
    for options, line in (
        ({"columns": "q"}, "'q' is no pair"),
        ({"columns": "x=y"}, "log.columns.x: 'x' is unknown"),
        ({"units": "furlong"}, "'furlong' is unknown; expected some of s, ms"),
        ({"log": tmp_path / "none.yaml"}, "no such file; give the path of a log.yaml"),
    ):
        with pytest.raises(ConfigError) as error:
            from_options(**options)
        assert line in str(error.value)


@given(
    content=st.one_of(st.binary(max_size=200), st.text(max_size=200).map(lambda text: text.encode("utf-8", "replace")))
)
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_bytes_are_a_description_or_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "log.yaml"
    path.write_bytes(content)
    complaint = ""
    try:
        load_description(path)
    except HybridDynamicsError as error:
        complaint = str(error)
    assert "\n" not in complaint
