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
