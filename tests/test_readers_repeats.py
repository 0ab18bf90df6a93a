"""Rows that a logger wrote twice, beside what repeats for another reason: coarse converters, rests, still joints."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid_dynamics.readers.repeats import without_repeats
from hybrid_dynamics.readers.resample import resample
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

STEP, ROWS = 0.004, 3000


def motion(time: Array) -> tuple[Array, Array]:
    """Two joints at ``time`` and a torque with noise, as measured ones have it."""
    q = np.stack([0.5 * np.sin(1.3 * time), 0.3 * np.sin(2.1 * time + 1.0)], axis=1)
    tau = 2.0 * np.cos(q) + 0.01 * np.random.default_rng(0).normal(size=q.shape)
    return q, tau


def polled(period: float) -> tuple[Trajectory, Array]:
    """Asked every 4 ms for samples that come every ``period`` [s]; and when these were taken."""
    time = STEP * np.arange(ROWS)
    taken: Array = period * np.arange(int(time[-1] / period) + 1, dtype=float)
    q, tau = motion(taken)
    last = np.minimum(np.floor(time / period + 1e-9).astype(int), len(taken) - 1)
    return Trajectory("log", "train", time, {"q": q[last], "tau": tau[last]}), taken


@settings(max_examples=20, deadline=None)
@given(period=st.floats(1.15 * STEP, 12 * STEP))
def test_what_is_left_are_the_samples(period: float) -> None:
    log, taken = polled(period)
    lines: list[str] = []
    out = without_repeats(log, lines.append)
    q, tau = motion(taken)
    np.testing.assert_array_equal(out["q"], q[: len(out.time)])
    np.testing.assert_array_equal(out["tau"], tau[: len(out.time)])
    assert len(out.time) >= len(taken) - 1
    assert len(lines) == 1
    told = re.search(r"a sample comes every ([\d.]+) ms, logged every 4 ms", lines[0])
    assert told
    assert float(told[1]) == pytest.approx(1e3 * period, rel=0.02)
    assert without_repeats(out) is out


def test_when_they_came_is_told_from_the_positions() -> None:
    log, taken = polled(3.3 * STEP)
    (part,) = resample(log)
    q, _ = motion(taken)
    np.testing.assert_array_equal(part["q"], q[: len(part.time)])
    assert part.dt == pytest.approx(3.3 * STEP, rel=1e-3)


@pytest.mark.parametrize("joints", [1, 2])
def test_coarse_converters_repeat_one_joint_at_a_time(joints: int) -> None:
    time = STEP * np.arange(ROWS)
    q, tau = motion(time)
    coarse = {"q": np.round(q[:, :joints] / 0.02) * 0.02, "tau": np.round(tau[:, :joints] / 0.1) * 0.1}
    log = Trajectory("log", "train", time, coarse)
    assert np.mean(np.all(np.diff(np.hstack(list(coarse.values())), axis=0) == 0, axis=1)) > 0.3
    assert without_repeats(log) is log


@pytest.mark.parametrize("rest", [3, 20, 80, 1000])
@pytest.mark.parametrize("hold", [1, 4])
def test_rests_stay_as_long_as_they_last(rest: int, hold: int) -> None:
    """An arm that rests with a torque that does not change repeats its rows, polled or not."""
    samples = ROWS // hold
    way = np.cumsum(np.arange(samples) % (60 + rest) < 60)
    q, tau = motion(STEP * hold * way)
    still = np.concatenate([[False], np.diff(way) == 0])
    tau = tau[np.maximum.accumulate(np.where(still, 0, np.arange(samples)))]
    asked = np.arange(samples * hold) // hold
    held = {"q": q[asked], "tau": tau[asked]}
    log = Trajectory("log", "train", STEP * np.arange(samples * hold), held)
    once = without_repeats(log)
    twice = without_repeats(once)
    assert len(once.time) == pytest.approx(samples, rel=0.02)
    assert len(twice.time) == pytest.approx(samples, rel=0.02)
    assert np.diff(twice.time).max() < 3.5 * hold * STEP


@pytest.mark.parametrize("step", [0.005, 0.02, 2 * np.pi / 4096])
def test_one_coarse_joint_is_not_polled(step: float) -> None:
    time = STEP * np.arange(ROWS)
    coarse = np.round(0.5 * np.sin(1.3 * time) / step)[:, None] * step
    alone = Trajectory("log", "train", time, {"q": np.column_stack([coarse, np.full(ROWS, 0.3)])})
    assert without_repeats(alone) is alone
    follows = Trajectory("log", "train", time, {"q": coarse, "tau": 2.0 * np.cos(coarse)})
    assert without_repeats(follows) is follows


def test_a_joint_that_stands_does_not_hide_repeated_rows() -> None:
    log, _ = polled(3 * STEP)
    still = np.column_stack([log["q"], np.full(ROWS, 0.3)])
    torque = np.column_stack([log["tau"], np.full(ROWS, 1.0)])
    out = without_repeats(Trajectory("log", "train", log.time, {"q": still, "tau": torque}))
    assert len(out.time) == pytest.approx(ROWS / 3, abs=2)


def test_what_is_written_once_stays() -> None:
    time = STEP * np.arange(ROWS)
    q, tau = motion(time)
    log = Trajectory("log", "train", time, {"q": q, "tau": tau})
    assert without_repeats(log) is log
