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


def test_a_rest_stays_as_long_as_it_lasts_and_is_no_repetition() -> None:
    time = STEP * np.arange(ROWS)
    q, tau = motion(time)
    rest = slice(1000, 2000)
    q[rest], tau[rest] = q[1000], np.round(tau[1000], 1)
    log = Trajectory("log", "train", time, {"q": q, "tau": tau})
    assert without_repeats(log) is log
    # Polled as well: the rest keeps a row for every sample of it, and no gap is left.
    asked = (np.arange(ROWS) // 4) * 4
    out = without_repeats(Trajectory("log", "train", time, {"q": q[asked], "tau": tau[asked]}))
    steps = np.diff(out.time)
    assert steps.max() < 1.5 * 4 * STEP
    assert len(out.time) == pytest.approx(ROWS / 4, abs=3)


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
