"""Users' tables, resampling, UR10e and WAM files: known truth recovered, every bad input refused by name."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.readers import (
    ResampleSettings,
    Ur10eSettings,
    read_log,
    read_pieces,
    read_ur10e,
    read_wam,
    read_wam_reference,
    resample,
    write_log,
)
from hybrid_dynamics.readers.ur10e import repair_stamps
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

JOINTS = ("shoulder", "elbow")


def motion(time: Array, n: int = 2) -> tuple[Array, Array, Array]:
    """Position, velocity and torque of a slow multi-sine (at most 2 Hz): (T, n) each."""
    w = 2 * np.pi * np.linspace(0.4, 2.0, n)
    phase = np.arange(n)
    q = 0.5 * np.sin(time[:, None] * w + phase)
    dq = 0.5 * w * np.cos(time[:, None] * w + phase)
    return q, dq, 10 * np.sin(time[:, None] * w - phase) + 1


def csv_text(time: Array, n: int = 2, velocity: bool = True, end: str = "\n") -> str:
    q, dq, tau = motion(time, n)
    blocks = [time[:, None], q, dq, tau] if velocity else [time[:, None], q, tau]
    names = ["time", *(f"q{j}" for j in range(1, n + 1))]
    names += [f"dq{j}" for j in range(1, n + 1)] if velocity else []
    names += [f"tau{j}" for j in range(1, n + 1)]
    rows = [",".join(f"{x:.9f}" for x in row) for row in np.concatenate(blocks, axis=1)]
    return end.join([",".join(names), *rows]) + end


def write(tmp_path: Path, text: str, name: str = "run.csv") -> Path:
    path = tmp_path / name
    path.write_bytes(text.encode())
    return path


UNIFORM = 0.01 * np.arange(300)


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_uniform_csv_is_read_unchanged(tmp_path: Path, velocity: bool, end: str) -> None:
    run = read_log(write(tmp_path, csv_text(UNIFORM, velocity=velocity, end=end)), JOINTS, split="test")
    q, dq, tau = motion(UNIFORM)
    assert (run.name, run.split) == ("run", "test")
    assert ("dq" in run) is velocity
    np.testing.assert_allclose(run["q"], q, atol=1e-9)
    np.testing.assert_allclose(run["tau"], tau, atol=1e-8)
    if velocity:
        np.testing.assert_allclose(run["dq"], dq, atol=1e-9)


def test_column_order_and_further_columns_do_not_matter(tmp_path: Path) -> None:
    lines = [line.split(",") for line in csv_text(UNIFORM).splitlines()]
    shuffled = "\n".join(",".join([*line[::-1], "note" if i == 0 else "x"]) for i, line in enumerate(lines))
    run = read_log(write(tmp_path, "\ufeff" + shuffled + "\n\n"), JOINTS)
    np.testing.assert_allclose(run["q"], motion(UNIFORM)[0], atol=1e-9)


@pytest.mark.parametrize("name", ["t", "Time", "timestamp", "time_s"])
def test_the_time_may_be_called_as_others_call_it(tmp_path: Path, name: str) -> None:
    text = csv_text(UNIFORM).replace("time", name, 1)
    np.testing.assert_allclose(read_log(write(tmp_path, text), JOINTS).time, UNIFORM)
    # Of two nobody can tell which: the cure names one.
    both = "\n".join(f"{line},{'stamp' if i == 0 else i}" for i, line in enumerate(text.splitlines()))
    with pytest.raises(InputError, match=rf"column 'time' is missing.*--columns time={name}\)"):
        read_log(write(tmp_path, both), JOINTS)


def test_a_log_is_written_as_what_its_name_says(tmp_path: Path) -> None:
    q, dq, tau = motion(UNIFORM)
    run = Trajectory("run", "train", UNIFORM, {"q": q, "dq": dq, "tau": tau})
    with pytest.raises(InputError, match=r"run.csv: a log is written as Parquet; give a name that ends in .parquet"):
        write_log(tmp_path / "run.csv", run, JOINTS)
    assert list(tmp_path.iterdir()) == []
    for name in ("run.parquet", "run.pq", "run.PARQUET"):
        write_log(tmp_path / name, run, JOINTS)
        np.testing.assert_array_equal(read_log(tmp_path / name, JOINTS)["q"], q)
    (tmp_path / "run.parquet").rename(tmp_path / "run.csv")
    with pytest.raises(InputError, match=r"run.csv: a Parquet file; give it a name that ends in .parquet"):
        read_log(tmp_path / "run.csv", JOINTS)


def test_a_column_may_be_called_as_parquet_begins(tmp_path: Path) -> None:
    text = "PAR1,time,q1,tau1\n" + "".join(f"0,{k / 100},{0.01 * k},{k}\n" for k in range(60))
    assert read_log(write(tmp_path, text), JOINTS[:1])["tau"][2, 0] == 2.0


def test_parquet_round_trip_and_joint_names(tmp_path: Path) -> None:
    q, dq, tau = motion(UNIFORM)
    run = Trajectory("run", "train", UNIFORM, {"q": q, "dq": dq, "tau": tau})
    write_log(tmp_path / "run.parquet", run, JOINTS)
    back = read_log(tmp_path / "run.parquet", JOINTS)
    for signal in ("q", "dq", "tau"):
        np.testing.assert_array_equal(back[signal], run[signal])
    schema = pq.ParquetFile(tmp_path / "run.parquet").schema_arrow
    assert schema.names == ["time", "q1", "q2", "dq1", "dq2", "tau1", "tau2"]
    assert schema.field("tau1").metadata[b"unit"] == b"N m"
    with pytest.raises(InputError, match="recorded for joint 'shoulder'"):
        read_log(tmp_path / "run.parquet", JOINTS[::-1])


def drop_line(number: int) -> Callable[[str], str]:
    return lambda text: "\n".join(line for i, line in enumerate(text.splitlines(), 1) if i != number) + "\n"


def change(row: int, column: int, value: str) -> Callable[[str], str]:
    """Set one field; rows and columns from 1, the header is row 1."""

    def edit(text: str) -> str:
        lines = text.splitlines()
        fields = lines[row - 1].split(",")
        fields[column - 1] = value
        lines[row - 1] = ",".join(fields)
        return "\n".join(lines) + "\n"

    return edit


def zero_torque(text: str) -> str:
    lines = text.splitlines()
    return "\n".join([lines[0], *(",".join([*line.split(",")[:5], "0", "0"]) for line in lines[1:])]) + "\n"


def swap_rows(text: str) -> str:
    lines = text.splitlines()
    lines[100], lines[101] = lines[101], lines[100]
    return "\n".join(lines) + "\n"


def scale_time(text: str) -> str:
    head, *rows = text.splitlines()
    return "\n".join([head, *(f"{float(r.split(',')[0]) * 1000},{r.split(',', 1)[1]}" for r in rows)]) + "\n"


def round_time(step: float) -> Callable[[str], str]:
    """Stamps in whole steps of ``step`` [s]."""

    def edit(text: str) -> str:
        head, *rows = text.splitlines()
        stamps = (round(float(r.split(",")[0]) / step) * step for r in rows)
        return "\n".join([head, *(f"{t:g},{r.split(',', 1)[1]}" for t, r in zip(stamps, rows, strict=True))]) + "\n"

    return edit


BAD: dict[str, tuple[Callable[[str], str], list[str]]] = {
    "nan": (change(12, 3, "nan"), ["column 'q2'", "row 12", "'nan'", "finite number"]),
    "empty field": (change(12, 3, ""), ["column 'q2'", "row 12", "nothing"]),
    "infinity": (change(7, 7, "inf"), ["column 'tau2'", "row 7"]),
    "text": (change(250, 6, "broken"), ["column 'tau1'", "row 250", "'broken'", "expected a finite number"]),
    "text in time": (change(5, 1, "12:00:01"), ["column 'time'", "row 5", "'12:00:01'"]),
    "repeated stamp": (change(52, 1, "0.49"), ["column 'time'", "row 52", "repeats", "remove duplicates"]),
    "coarse stamps": (round_time(0.02), ["repeats", "coarser than the samples", "clock: even"]),
    "stamps in 32 bits": (round_time(128.0), ["repeats", "coarser than the samples", "32 bits"]),
    "unsorted": (swap_rows, ["column 'time'", "row 102", "goes back", "strictly increasing"]),
    "truncated": (lambda text: text[: -len(text) // 3], ["row ", "truncated", "expected 7"]),
    "row too short": (change(40, 7, "1.0\n0.5,1"), ["row 41 has 2 columns", "expected 7"]),
    "missing torque": (change(1, 7, "effort2"), ["column 'tau2' is missing", "robot has 2 joints"]),
    "missing column": (change(1, 6, "effort1"), ["column 'tau1' is missing", "tau1 to tau2"]),
    "missing velocity": (change(1, 4, "v1"), ["column 'dq1' is missing", "dq1 to dq2"]),
    "missing time": (change(1, 1, "zeit"), ["column 'time' is missing"]),
    "double column": (change(1, 3, "q1"), ["column 'q1' stands twice"]),
    "no header": (drop_line(1), ["column 'time' is missing"]),
    "decimal commas": (
        lambda text: text.replace(",", ";").replace(".", ","),
        ["column 'time', row", "a point in the place of the comma"],
    ),
    "one column": (lambda text: text.replace(",", " "), ["row 1", "no comma"]),
    "zero torque": (zero_torque, ["torque columns are all zero", "log effort"]),
    "too slow": (lambda text: "\n".join(text.splitlines()[::20]), ["(5 Hz)", "at least 50", "log at a higher rate"]),
    "too few rows": (lambda text: "\n".join(text.splitlines()[:20]), ["19 rows", "at least 50"]),
    "empty": (lambda text: "", ["empty", "time,q1..qn"]),
    "milliseconds": (scale_time, ["column 'time'", "seconds", "milliseconds"]),
    "binary": (lambda text: "\x00\x01\x02,\x03" * 100, ["column 'time' is missing"]),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_table_is_refused_by_name(tmp_path: Path, case: str) -> None:
    edit, parts = BAD[case]
    path = write(tmp_path, edit(csv_text(UNIFORM)))
    before = path.read_bytes()
    with pytest.raises(InputError) as error:
        read_log(path, JOINTS)
    text = str(error.value)
    assert "\n" not in text
    for part in [str(path), *parts]:
        assert part in text
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("mark", [";", "\t"])
def test_semicolons_and_tabs_part_columns_as_commas_do(tmp_path: Path, mark: str) -> None:
    wanted = read_log(write(tmp_path, csv_text(UNIFORM)), JOINTS)
    read = read_log(write(tmp_path, csv_text(UNIFORM).replace(",", mark)), JOINTS)
    for signal in wanted.signals:
        np.testing.assert_array_equal(read[signal], wanted[signal])
    # What is asked of a header is asked of this one, too.
    more = csv_text(UNIFORM).replace("q2", "q2,q3", 1).replace(",", mark)
    with pytest.raises(InputError, match=r"3 columns of q|columns"):
        read_log(write(tmp_path, more), JOINTS)


@given(
    position=st.floats(0.02, 1),
    garbage=st.binary(min_size=1, max_size=30),
    length=st.integers(0, 60),
    cut=st.booleans(),
)
@hypothesis_settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damaged_bytes_are_refused_or_harmless(
    tmp_path: Path, position: float, garbage: bytes, length: int, cut: bool
) -> None:
    """Whatever bytes stand in a log: a finite, evenly sampled run or one line, never another exception."""
    content = csv_text(UNIFORM[:80]).encode()
    at = int(position * len(content))
    path = tmp_path / "run.csv"
    path.write_bytes(content[:at] + garbage + (b"" if cut else content[at + length :]))
    message = ""
    try:
        parts = read_pieces(path, JOINTS)
    except InputError as error:
        parts, message = [], str(error)
    assert parts or message
    assert "\n" not in message
    assert all(np.isfinite(part[s]).all() for part in parts for s in ("q", "dq", "tau"))


def test_wrong_number_of_joints(tmp_path: Path) -> None:
    path = write(tmp_path, csv_text(UNIFORM, n=3))
    with pytest.raises(InputError, match=r"3 columns of q \(q1 to q3\); the robot has 2 joints \(shoulder, elbow\)"):
        read_log(path, JOINTS)
    with pytest.raises(InputError, match=r"column 'q4' is missing; the robot has 4 joints"):
        read_log(path, ("a", "b", "c", "d"))


def test_bad_parquet(tmp_path: Path) -> None:
    good = tmp_path / "good.parquet"
    q, dq, tau = motion(UNIFORM)
    write_log(good, Trajectory("run", "train", UNIFORM, {"q": q, "dq": dq, "tau": tau}), JOINTS)
    truncated = tmp_path / "cut.parquet"
    truncated.write_bytes(good.read_bytes()[:-200])
    with pytest.raises(InputError, match="truncated"):
        read_log(truncated, JOINTS)
    tau[10, 1] = np.nan
    table = pq.read_table(good).set_column(6, "tau2", pa.array(tau[:, 1]))
    pq.write_table(table, tmp_path / "nan.parquet")
    with pytest.raises(InputError, match="column 'tau2', row 11 holds nan"):
        read_log(tmp_path / "nan.parquet", JOINTS)
    pq.write_table(table.set_column(6, "tau2", pa.array([["a"]] * len(q))), tmp_path / "list.parquet")
    with pytest.raises(InputError, match="column 'tau2' holds list"):
        read_log(tmp_path / "list.parquet", JOINTS)


def test_unknown_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_log(tmp_path / "none.csv", JOINTS)
    with pytest.raises(InputError, match=r"unknown suffix '\.xlsx'"):
        read_log(write(tmp_path, "x", "run.xlsx"), JOINTS)


def test_odd_but_usable_logs_are_remarked_on(tmp_path: Path) -> None:
    said: list[str] = []
    q, _, tau = motion(UNIFORM)
    q[:, 0] = np.angle(np.exp(1j * (q[:, 0] + 4 * UNIFORM)))
    q[:, 1] *= 180 / np.pi
    tau[:, 1] = 0
    write_log(tmp_path / "run.parquet", Trajectory("run", "train", UNIFORM, {"q": q, "tau": tau}), JOINTS)
    run = read_log(tmp_path / "run.parquet", JOINTS, notify=said.append)
    assert np.abs(np.diff(run["q"][:, 0])).max() < 0.1
    assert any("q1 (shoulder) jumps by a full turn" in line for line in said)
    assert not any("q2" in line and "full turn" in line for line in said)
    assert any("tau2 (elbow) is zero" in line for line in said)
    # 0.5 rad are 29 degrees: no alarm yet.
    assert not any("degrees" in line for line in said)


@pytest.mark.parametrize("kind", ["jitter", "two steps", "ten percent lost"])
def test_uneven_stamps_recover_the_motion(tmp_path: Path, kind: str) -> None:
    rng = np.random.default_rng(0)
    steps = {
        "jitter": 0.01 + rng.uniform(-0.002, 0.002, 600),
        "two steps": rng.choice([0.010, 0.012], 600, p=[0.67, 0.33]),
        "ten percent lost": np.full(600, 0.01),
    }[kind]
    time = np.cumsum(steps)
    if kind == "ten percent lost":
        time = time[np.sort(rng.choice(600, 540, replace=False))]
    said: list[str] = []
    run = read_log(write(tmp_path, csv_text(time)), JOINTS, notify=said.append)
    # Cubic interpolation is off by at most 5/384 h^4 times the fourth derivative; here h <= 40 ms, 2 Hz, 0.5 rad.
    bound = 5 / 384 * np.diff(time).max() ** 4 * 0.5 * (4 * np.pi) ** 4 + 1e-6
    q, dq, tau = motion(run.time)
    inside = slice(5, -5)
    assert np.abs(run["q"] - q)[inside].max() < 2 * bound
    assert np.abs(run["dq"] - dq)[inside].max() < 2 * bound * 4 * np.pi
    assert np.abs(run["tau"] - tau)[inside].max() < 2 * bound * 20
    # Control: taking the samples as if they were evenly spaced is far off.
    even = motion(time[0] + np.median(steps) * np.arange(len(time)))[0]
    assert np.abs(even - motion(time)[0]).max() > 100 * bound
    np.testing.assert_allclose(np.diff(run.time), run.dt, rtol=1e-9)
    assert any("resampled to" in line and "Hz" in line for line in said)


def test_run_with_a_long_gap_is_split_not_bridged(tmp_path: Path) -> None:
    time = np.concatenate([UNIFORM, UNIFORM + 4.0, UNIFORM[:20] + 9.0])
    path, said = write(tmp_path, csv_text(time)), list[str]()
    parts = read_pieces(path, JOINTS, notify=said.append)
    assert [part.name for part in parts] == ["run.part1", "run.part2"]
    assert [len(part.time) for part in parts] == [300, 300]
    np.testing.assert_allclose(parts[1]["q"], motion(parts[1].time)[0], atol=1e-8)
    assert any("no samples for 1.01 s after t = 2.99 s (row 300)" in line and "split" in line for line in said)
    assert any("left out" in line for line in said)
    with pytest.raises(InputError, match=r"samples are missing between t = 2\.99 s and 4 s"):
        read_log(path, JOINTS)
    [bridged] = read_pieces(path, JOINTS, settings=ResampleSettings(max_gap=1.5))
    assert bridged.name == "run"
    assert bridged.time[-1] == pytest.approx(6.99)


def test_only_fragments_left(tmp_path: Path) -> None:
    time = np.concatenate([0.01 * np.arange(20) + k for k in range(10)])
    with pytest.raises(InputError, match="no stretch of 50 rows"):
        read_pieces(write(tmp_path, csv_text(time)), JOINTS)


@given(seed=st.integers(0, 2**32 - 1), rate=st.floats(20, 1000), jitter=st.floats(0, 0.4))
@hypothesis_settings(max_examples=30, deadline=None)
def test_resampling_keeps_cubics_and_stays_inside(seed: int, rate: float, jitter: float) -> None:
    """The interpolation reproduces any cubic polynomial exactly, whatever the stamps."""
    rng = np.random.default_rng(seed)
    time = (np.arange(80) + jitter * rng.uniform(-1, 1, 80)) / rate
    scaled = time * rate / 80
    values = np.polynomial.polynomial.polyval(scaled, rng.normal(size=(4, 2))).T
    [run] = resample(Trajectory("x", "train", time, {"q": values}))
    assert run.time[0] == time[0]
    assert run.time[-1] <= time[-1] + 1e-3 / rate + 0.021 / rate
    if len(run.time) != len(time) or not np.array_equal(run["q"], values):
        coefficients = np.polynomial.polynomial.polyfit(scaled, values, 3)
        expected = np.polynomial.polynomial.polyval(run.time * rate / 80, coefficients).T
        np.testing.assert_allclose(run["q"], expected, atol=1e-6 * (1 + np.abs(values).max()))


@pytest.mark.parametrize(
    "bad", [{"dt": -1.0}, {"max_gap": -1.0}, {"max_gap_samples": 0}, {"min_rows": 1}, {"uniform_tolerance": 1.0}]
)
def test_resample_settings_are_checked(bad: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(bad))):
        ResampleSettings(**bad)


# UR10e -----------------------------------------------------------------------------------------------------------


def ur10e_table(seed: int = 0, rows: int = 2000) -> Array:
    """A run of the recordings' format: standstill, way to the start, standstill, motion, standstill; 2 ms ticks."""
    rng = np.random.default_rng(seed)
    time = 1000 + np.cumsum(rng.choice([0.010, 0.012], rows, p=[0.67, 0.33]))
    t = time - time[0]
    amount = np.where((t > 3) & (t < 18), np.sin(np.pi * np.clip((t - 3) / 15, 0, 1)) ** 2, 0.0)
    w = 2 * np.pi * np.linspace(0.3, 1.0, 6)
    q = amount[:, None] * np.sin(t[:, None] * w)
    q[:, 0] += 0.3 * np.clip(t - 1.0, 0, 0.5)
    dq = np.gradient(q, time, axis=0)
    current = 3 * np.cos(t[:, None] * w) + np.arange(1, 7)
    return np.concatenate([time[:, None], q, dq, current, current, 10 * current], axis=1)


def ur10e_file(tmp_path: Path, table: Array, edit: Callable[[list[str]], list[str]] = lambda lines: lines) -> Path:
    path = tmp_path / "ur.csv"
    lines = [",".join(f"{x:.6f}" for x in row) for row in table]
    path.write_text("\n".join(edit(lines)) + "\n")
    return path


def test_ur10e_torque_window_and_grid(tmp_path: Path) -> None:
    table, said = ur10e_table(), list[str]()
    run = read_ur10e(ur10e_file(tmp_path, table), "ur", "train", notify=said.append)
    t = table[:, 0] - table[0, 0]
    # The motion is found, with standstill around it, without the way to the start (1.0 to 1.5 s).
    duration = run.time[-1] - run.time[0]
    assert 14.3 < duration < 15.4
    assert np.abs(run["dq"][0]).max() < 0.005
    assert np.abs(run["dq"][-1]).max() < 0.005
    assert np.abs(run["dq"]).max() > 1.0
    found = re.search(r"rows (\d+) to (\d+)", said[0])
    assert found is not None
    w = 2 * np.pi * np.linspace(0.3, 1.0, 6)
    current = 3 * np.cos((run.time[:, None] + t[int(found[1]) - 1]) * w) + np.arange(1, 7)
    np.testing.assert_allclose(run["tau"], current * np.array([14.87, 13.26, 11.13, 10.62, 11.03, 11.47]), atol=2e-3)
    assert run.dt == pytest.approx(0.010)


def test_ur10e_window_counts_rows_from_one(tmp_path: Path) -> None:
    table = ur10e_table()
    run = read_ur10e(ur10e_file(tmp_path, table), "ur", "test", window=(401, 1500))
    np.testing.assert_allclose(run["q"][0], table[400, 1:7], atol=1e-6)
    assert run.time[-1] == pytest.approx(table[1499, 0] - table[400, 0], abs=0.01)
    with pytest.raises(InputError, match="window 401-9999"):
        read_ur10e(ur10e_file(tmp_path, table), "ur", "test", window=(401, 9999))


def corrupt(lines: list[str]) -> list[str]:
    """The damage of the recordings: shifted fields, absurd numbers, wrong stamps, a last line cut off."""
    out = list(lines)
    out[1] = "-0.1231," + ",".join(["253.0000"] * 30)
    out[2] = "0.7932,-1" + "1" * 280 + ".0," + ",".join(["0.0"] * 29)
    out[3] = ",".join(["0.0000"] * 31)
    out[4] = "47.5563," + ",".join(["0.0"] * 30)
    out[5] = out[5].replace(",", ",abc", 1)
    out[-1] = out[-1][: len(out[-1]) // 2]
    return out


def test_ur10e_corrupted_rows_are_dropped_by_number(tmp_path: Path) -> None:
    table, said = ur10e_table(), list[str]()
    run = read_ur10e(ur10e_file(tmp_path, table, corrupt), "ur", "train", notify=said.append)
    assert "6 corrupted rows of 2000 dropped: rows 2-6, 2000" in said[0]
    clean = read_ur10e(ur10e_file(tmp_path, table), "ur", "train")
    np.testing.assert_array_equal(run["q"], clean["q"])


def test_ur10e_file_with_too_many_corrupted_rows_is_refused(tmp_path: Path) -> None:
    def spoil(lines: list[str]) -> list[str]:
        return [line.replace(",", ";") if 500 <= i < 521 else line for i, line in enumerate(lines)]

    with pytest.raises(InputError, match=r"21 of 2000 rows are corrupted \(rows 501-521\); expected at most 1\.0%"):
        read_ur10e(ur10e_file(tmp_path, ur10e_table(), spoil), "ur", "train")


def test_ur10e_bad_files(tmp_path: Path) -> None:
    table = ur10e_table()
    still = table.copy()
    still[:, 7:13] = 0
    with pytest.raises(InputError, match="no joint exceeds"):
        read_ur10e(ur10e_file(tmp_path, still), "ur", "train")
    with pytest.raises(InputError, match="ends in motion"):
        read_ur10e(ur10e_file(tmp_path, table[:1000]), "ur", "train")
    with pytest.raises(InputError, match="0 rows of 31"):
        read_ur10e(ur10e_file(tmp_path, table[:, :20]), "ur", "train")
    with pytest.raises(InputError, match="no such file"):
        read_ur10e(tmp_path / "none.csv", "ur", "train")
    with pytest.raises(ConfigError, match=r"ur10e\.gains"):
        Ur10eSettings(gains=(1.0, 2.0))


def test_stray_stamps_return_to_the_tick_that_fits_the_motion() -> None:
    """Stamps moved by 1 ms are put back exactly, where the robot moves; true stamps are left alone."""
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.choice([0.010, 0.012], 1000))
    w = 2 * np.pi * np.linspace(0.2, 0.8, 6)
    q = np.sin(time[:, None] * w + np.arange(6)) + 3e-5 * rng.normal(size=(1000, 6))
    dq = w * np.cos(time[:, None] * w + np.arange(6))
    stray = np.arange(5, 995, 33)
    stamps = time.copy()
    stamps[stray] += rng.choice([-0.001, 0.001], len(stray))
    repaired, moved = repair_stamps(stamps, q, dq, 0.002)
    assert moved == len(stray)
    np.testing.assert_allclose(repaired, time, atol=1e-9)
    untouched, none = repair_stamps(time, q, dq, 0.002)
    assert none == 0
    np.testing.assert_array_equal(untouched, time)


RECORDINGS = Path(os.environ.get("HYBRID_DYNAMICS_MIRROR", "")) / "shamilmamedov/dynamic_calibration/dataset_ur10e"
needs_recordings = pytest.mark.skipif(
    not RECORDINGS.is_dir(), reason="no UR10e recordings: set HYBRID_DYNAMICS_MIRROR to a mirror folder"
)


@needs_recordings
@pytest.mark.parametrize(
    ("file", "known"),
    [
        ("identification_data/ur-20_02_10-30sec_12harm.csv", (635, 3510)),
        ("identification_data/ur-20_02_12-40sec_12harm.csv", (500, 4460)),
        ("identification_data/ur-20_02_12-50sec_12harm.csv", (355, 5090)),
        ("identification_data/ur-20_02_19_14harm50sec.csv", (195, 4966)),
        ("identification_data/ur-20_02_19_14harm50secLoad.csv", (308, 5071)),
    ],
)
def test_automatic_windows_agree_with_the_authors(file: str, known: tuple[int, int]) -> None:
    said: list[str] = []
    read_ur10e(RECORDINGS / file, "ur", "train", notify=said.append)
    found = re.search(r"rows (\d+) to (\d+)", " ".join(line for line in said if "window" in line))
    assert found is not None
    # A third of a second at either end: the authors' windows differ in how much standstill they keep.
    assert abs(int(found[1]) - known[0]) <= 30
    assert abs(int(found[2]) - known[1]) <= 30


@needs_recordings
@pytest.mark.parametrize(
    ("file", "window"),
    [
        ("identification_data/ur-20_02_12-40sec_12harm.csv", (500, 4460)),
        ("identification_data/ur-20_02_19_14harm50sec.csv", (195, 4966)),
    ],
)
def test_the_log_yaml_of_the_documentation_reads_a_recording_as_its_own_reader_does(
    tmp_path: Path, file: str, window: tuple[int, int]
) -> None:
    page = (Path(__file__).parents[1] / "docs" / "logs.md").read_text("utf-8")
    block = page.partition("without a header, by\n\n")[2].partition("\n\n")[0]
    (tmp_path / "log.yaml").write_text(dedent(block) + f"\nrows: [{window[0]}, {window[1]}]\n", "utf-8")
    joints = [f"joint_{j}" for j in range(1, 7)]
    described = read_log(RECORDINGS / file, joints, log=tmp_path / "log.yaml")
    own = read_ur10e(RECORDINGS / file, "ur", "train", window=window)
    assert len(described.time) == len(own.time)
    for signal in ("q", "dq", "tau"):
        # A position at rest does not tell which tick a stamp belongs to, and each has its own rule for that.
        assert np.mean(np.abs(described[signal] - own[signal]) > 1e-9) < 0.02
    # Never by more than two ticks of 2 ms.
    assert np.all(np.abs(described["q"] - own["q"]) <= 4e-3 * np.abs(own["dq"]).max(axis=0))
    # The control: joints told as of another order are another recording.
    assert np.mean(np.abs(described["q"] - own["q"][:, ::-1]) > 1e-9) > 0.9


@needs_recordings
def test_damaged_recording_is_read_without_its_damaged_rows() -> None:
    said: list[str] = []
    path = RECORDINGS / "identification_data/ur-20_02_19_15harm50secLoad.csv"
    run = read_ur10e(path, "ur", "train", notify=said.append)
    assert "10 corrupted rows of 6107 dropped: rows 2-10, 6107" in said[0]
    # Position, velocity and stamps belong together: encoder steps of 6e-5 rad remain.
    misfit = np.diff(run["q"], axis=0) - (run["dq"][1:] + run["dq"][:-1]) / 2 * run.dt
    assert np.sqrt(np.mean(misfit**2, axis=0)).max() < 1e-4


# WAM -------------------------------------------------------------------------------------------------------------


def wam_lines(rows: int = 500) -> list[str]:
    time = 1e-3 * np.arange(rows) + 12.0
    q, _, tau = motion(time, 7)
    return [" ".join(f"{x:+.5f}" for x in row) for row in np.column_stack([time, q, tau])]


@pytest.mark.parametrize("separator", [" ", ",", "\t"])
def test_wam_log(tmp_path: Path, separator: str) -> None:
    text = "# a comment\n" + "\n".join(line.replace(" ", separator) for line in wam_lines()) + "\n"
    run = read_wam(write(tmp_path, text, "log.dat"), "traj1", "train")
    q, _, tau = motion(run.time + 12.0, 7)
    np.testing.assert_allclose(run["q"], q, atol=1e-5)
    np.testing.assert_allclose(run["tau"], tau, atol=1e-5)
    assert run.time[0] == 0
    assert run.dt == pytest.approx(1e-3)


@pytest.mark.parametrize(
    ("edit", "parts"),
    [
        (lambda t: t[: -len(t) // 3], ["row ", "truncated", "expected 15"]),
        (lambda t: t.replace("\n+12.10000 ", "\n+12.10000 nan "), ["row 101 has 16 columns"]),
        (lambda t: t.replace("+12.10000", "spam"), ["row 101, column 1 is 'spam'"]),
        (lambda t: t.replace("+12.1", "+12.0"), ["of 500 rows have a time stamp", "expected at most 1%"]),
        (lambda t: "\n".join(t.splitlines()[:10]), ["10 rows; expected at least 50"]),
        (lambda t: "", ["empty; expected 15 columns"]),
        (lambda t: "\n".join(" ".join([*x.split()[:8], *"0000000"]) for x in t.splitlines()), ["all zero"]),
    ],
)
def test_bad_wam_log(tmp_path: Path, edit: Callable[[str], str], parts: list[str]) -> None:
    path = write(tmp_path, edit("\n".join(wam_lines()) + "\n"), "log.dat")
    with pytest.raises(InputError) as error:
        read_wam(path, "traj1", "train")
    for part in [str(path), *parts]:
        assert part in str(error.value)
    assert "\n" not in str(error.value)


def test_wam_repeated_stamps_are_dropped_by_number(tmp_path: Path) -> None:
    lines, said = wam_lines(), list[str]()
    text = "\n".join([*lines[:101], lines[100], *lines[101:]])
    run = read_wam(write(tmp_path, text, "log.dat"), "traj1", "train", notify=said.append)
    assert "1 rows with a repeated time stamp dropped: rows 101" in said[0] or "rows 102" in said[0]
    np.testing.assert_allclose(run["q"], motion(run.time + 12.0, 7)[0], atol=1e-5)


def test_wam_reference(tmp_path: Path) -> None:
    rows = "\n".join(" ".join(["-0.61097"] * 7) for _ in range(60)) + "\n"
    assert read_wam_reference(write(tmp_path, rows, "traj1.dat")).shape == (60, 7)
