"""Outlier segments by themselves: what surprises most joints at once, and jolts that the filters do not resolve."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid_dynamics.loop.outliers import OutlierSegment, outlier_segments
from hybrid_dynamics.types import Array

JOINTS, RATE, SECONDS = 6, 100.0, 20.0
TIME = np.arange(0.0, SECONDS, 1.0 / RATE)


def motion(jolts: tuple[float, ...], joints: int = JOINTS) -> Array:
    """Smooth accelerations, and at each of ``jolts`` [s] a spike of 50 ms on the first ``joints``."""
    rng = np.random.default_rng(0)
    ddq = np.sin(TIME[:, None] * rng.uniform(0.5, 2.0, JOINTS) + rng.uniform(0, 6, JOINTS))
    for at in jolts:
        ddq[np.abs(TIME - at) < 0.025, :joints] += 20.0
    return ddq


def residual(at: float, joints: int) -> Array:
    """Unit noise; at ``at`` [s] the first ``joints`` depart by 20, each a little after the other."""
    out = np.random.default_rng(1).normal(size=(len(TIME), JOINTS))
    for j in range(joints):
        out[np.abs(TIME - at - 0.02 * j) < 0.01, j] += 20.0
    return out


def found(ddq: Array, left: Array) -> list[OutlierSegment]:
    return outlier_segments(0, TIME, ddq, left, np.ones(left.shape, bool), pad=0.08)


def test_two_joints_that_depart_in_a_jolt_are_an_outlier_segment() -> None:
    (segment,) = found(motion((8.2,)), residual(8.2, 2))
    assert TIME[segment.start] < 8.2 < TIME[segment.stop]
    assert segment.joints == 2
    assert segment.size > 10.0


@pytest.mark.parametrize(
    ("jolts", "shaken", "departing"),
    [((), JOINTS, 2), ((8.2,), 2, 2), ((8.2,), JOINTS, 1), ((4.0,), JOINTS, 2)],
    ids=["smooth", "two joints jolt", "one joint departs", "the jolt is elsewhere"],
)
def test_friction_that_surprises_some_joints_is_none(jolts: tuple[float, ...], shaken: int, departing: int) -> None:
    assert found(motion(jolts, shaken), residual(8.2, departing)) == []


def test_jolts_that_come_often_are_the_motion_itself() -> None:
    every = tuple(np.arange(0.5, SECONDS, 0.2))
    assert found(motion(every), sum(residual(float(at), 2) for at in every)) == []
    # What surprises every joint at once is left out all the same.
    knock = residual(8.3, 0)
    knock[np.abs(TIME - 8.3) < 0.02] += 20.0
    assert len(found(motion(every), knock)) == 1


@pytest.mark.parametrize("rate", [100.0, 400.0])
@pytest.mark.parametrize("pad", [0.03, 0.2])
def test_as_much_is_left_out_to_either_side_as_the_filters_carry_a_moment(rate: float, pad: float) -> None:
    rows, knock = round(SECONDS * rate), round(8.2 * rate)
    left = np.random.default_rng(1).normal(size=(rows, JOINTS))
    left[knock] += 20.0
    (segment,) = outlier_segments(0, np.arange(rows) / rate, 0 * left, left, np.ones(left.shape, bool), pad)
    assert (segment.start, segment.stop) == (knock - round(pad * rate), knock + 1 + round(pad * rate))
