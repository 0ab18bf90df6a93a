"""A log that goes on elsewhere is two runs; single wrong samples, fast motion and coarse encoders are no jumps."""

import numpy as np
import pytest
from tests.small_arm import arm

from hybrid_dynamics.check import check_before_fit
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.readers import read_pieces, write_log
from hybrid_dynamics.readers.jumps import find_jumps
from hybrid_dynamics.readers.resample import resample
from hybrid_dynamics.simulation.excitation import excitation
from hybrid_dynamics.trajectory import Trajectory


@pytest.fixture(scope="module")
def run() -> Trajectory:
    return excitation(arm(), duration=10.0, rate=200.0)


def without(run: Trajectory, first: int, last: int) -> Trajectory:
    """The rows ``first`` to ``last`` - 1 left out, and the stamps of the rest as if nothing were missing."""
    kept = np.r_[0:first, last : len(run.time)]
    return Trajectory(run.name, run.split, run.time[: len(kept)], {k: v[kept] for k, v in run.signals.items()})


def frozen(run: Trajectory, first: int, last: int) -> Trajectory:
    """The row ``first`` instead of all up to ``last``."""
    rows = np.r_[0:first, [first] * (last + 1 - first), last + 1 : len(run.time)]
    return run.with_signals(**{k: v[rows] for k, v in run.signals.items()})


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_two_recordings_in_one_are_told_where_the_second_begins(run, noise):
    rng = np.random.default_rng(1)
    joined = without(run, 800, 1000)
    joined = joined.with_signals(q=joined["q"] + noise * rng.normal(size=joined["q"].shape))
    (jump,) = find_jumps(joined)
    assert (jump.row, jump.held) == (799, 799)
    assert jump.size == pytest.approx(np.abs(run["q"][1000] - run["q"][799])[jump.joint], abs=0.05)
    assert find_jumps(run) == []


def test_a_sample_that_was_repeated_for_a_while_is_there_once(run):
    (jump,) = find_jumps(frozen(run, 800, 999))
    assert (jump.row, jump.held) == (999, 800)
    heard: list[str] = []
    first, second = resample(frozen(run, 800, 999), notify=heard.append)
    assert (len(first.time), len(second.time)) == (801, 1000)
    assert np.all(np.ptp(np.concatenate([first["q"], second["q"]]), axis=0) > 0)
    assert "199 rows that repeat one" in heard[0]
    assert "run split there" in heard[0]


@pytest.mark.parametrize("rows", [(900,), (900, 901), (900, 901, 902)])
def test_samples_that_are_wrong_alone_are_no_jump(run, rows):
    q = run["q"].copy()
    q[list(rows), 1] += 2.0
    assert find_jumps(run.with_signals(q=q)) == []


@pytest.mark.parametrize("every", [1, 4, 10])
@pytest.mark.parametrize("count", [0.0, 2e-3])
def test_fast_motion_in_slow_logs_and_coarse_encoders_are_none(run, every, count):
    slow = run.rows(slice(0, None, every))
    q = np.round(slow["q"] / count) * count if count else slow["q"]
    assert find_jumps(slow.with_signals(q=q)) == []


@pytest.mark.parametrize("rate", [25.0, 50.0, 100.0, 500.0])
@pytest.mark.parametrize(("move", "lasts"), [(0.05, 0.2), (0.3, 0.3), (1.0, 0.5)])
@pytest.mark.parametrize("noise", [1e-9, 1e-5])
def test_one_quick_move_of_a_joint_that_stands_for_long_is_none(rate, move, lasts, noise):
    time = np.arange(int(60 * rate)) / rate
    rng, lively = np.random.default_rng(4), 0.8 * np.sin(2 * time)
    for begins in 30.0 + np.linspace(0, 1 / rate, 7):
        share = np.clip((time - begins) / lasts, 0, 1)
        q = np.column_stack([lively, move * share**3 * (10 - 15 * share + 6 * share**2)])
        log = Trajectory("one move", "train", time, {"q": q + noise * rng.normal(size=q.shape), "tau": q})
        assert find_jumps(log) == []


def test_a_joint_that_settles_by_next_to_nothing_does_not_jump():
    time = np.arange(6000) / 100.0
    q = np.column_stack([np.sin(time), np.where(time > 30, 1e-6, 0.0)]).astype(np.float32).astype(float)
    assert find_jumps(Trajectory("settles", "train", time, {"q": q, "tau": q})) == []


def test_the_parts_of_a_log_are_looked_at_as_whoever_gets_them_will(run):
    """A jump that the rest of a lively log hides is found in the part that a gap leaves of it."""
    quiet = run.with_signals(q=0.02 * run["q"])
    joined = without(quiet, 800, 1000)
    time = np.concatenate([run.time, run.time[-1] + 10.0 + joined.time])
    both = {k: np.concatenate([run.signals[k], joined.signals[k]]) for k in run.signals}
    parts = resample(Trajectory("both", "train", time, both))
    assert [len(p.time) for p in parts] == [2000, 800, 1000]
    assert all(find_jumps(p) == [] for p in parts)


def test_rows_that_are_repeated_after_a_gap_of_the_stamps_too_are_left_out_there(run):
    held = frozen(run, 800, 1199)
    time = held.time + np.where(np.arange(len(held.time)) >= 1000, 1.0, 0.0)
    heard: list[str] = []
    parts = resample(Trajectory("held", "train", time, held.signals), notify=heard.append)
    # Before the gap the robot may as well have stood; after it, it goes on elsewhere: one sample of 200 is left.
    assert [len(p.time) for p in parts] == [1000, 800]
    assert "199 rows that repeat one" in " ".join(heard)
    assert "rows 1001 to 1001 left out" in " ".join(heard)


def test_a_robot_that_starts_and_stops_at_once_does_not_jump(run):
    time = np.arange(2000) / 200.0
    q = np.clip(np.abs((np.add.outer(time, [0.0, 0.5]) % 4.0) - 2.0), 0.4, 1.6)
    assert find_jumps(Trajectory("trapezia", "train", time, {"q": q, "tau": q})) == []


def test_a_file_of_two_recordings_is_read_as_two_runs_and_a_run_that_is_two_is_refused(run, tmp_path):
    robot, joined = arm(), without(run, 800, 1000)
    write_log(tmp_path / "both.parquet", joined, robot.joint_names)
    heard: list[str] = []
    parts = read_pieces(tmp_path / "both.parquet", robot, "both", notify=heard.append)
    assert [(p.name, len(p.time)) for p in parts] == [("both.part1", 800), ("both.part2", 1000)]
    assert any("two recordings in one" in line for line in heard)
    np.testing.assert_array_equal(parts[1]["q"], run["q"][1000:])
    with pytest.raises(InputError, match="expected one recording a run: split it there"):
        check_before_fit(robot, [joined])
    check_before_fit(robot, parts)


def test_a_gap_in_the_stamps_is_told_once(run):
    time = run.time.copy()
    kept = np.r_[0:800, 1000 : len(time)]
    gap = Trajectory("gap", "train", time[kept], {k: v[kept] for k, v in run.signals.items()})
    heard: list[str] = []
    assert [len(p.time) for p in resample(gap, notify=heard.append)] == [800, 1000]
    assert sum("run split there" in line for line in heard) == 1
