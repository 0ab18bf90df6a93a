"""Outlier segments in a log: moments in which most joints depart at once from anything the motion explains.

A bump against the arm, a stop harder than the filters resolve or a fault of the log lasts a fraction of a second and
is no property of the robot, but least squares hands its energy to whatever effect comes nearest. What the rich model
of :mod:`hybrid_dynamics.loop.noise` leaves is compared with its robust scale (median absolute deviation):
friction alone surprises single joints, an outlier segment surprises most of them together. Long or frequent departures
are not left out: they ask for an explanation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, label

from hybrid_dynamics.types import Array

#: A sample departs where the residual exceeds this many robust standard deviations of its joint.
DEPARTURE = 6.0
#: Standard deviation of a normal variable over its median absolute deviation.
_MAD = 1.4826
#: Longest outlier segment [s], and the largest share of a run that outlier segments may take.
LONGEST, LARGEST_SHARE = 1.0, 0.05
#: Fewer joints in motion cannot tell an outlier segment from an effect of their own.
FEWEST_JOINTS = 3


@dataclass(frozen=True)
class OutlierSegment:
    """A segment of run number ``run``: rows ``start`` to ``stop`` (excluded), how many joints saw it, and how strong.

    ``size`` is the largest departure in robust standard deviations; times [s] as in the log.
    """

    run: int
    start: int
    stop: int
    first_time: float
    last_time: float
    joints: int
    size: float


def outlier_segments(
    run: int, time: Array, residual: Array, mask: NDArray[np.bool_], pad: float
) -> list[OutlierSegment]:
    """Outlier segments in one run. ``time`` (K,) [s], ``residual`` (K, n) [N m], ``mask`` (K, n) rows that count.

    ``pad`` [s] is how far the filters carry a moment to either side; it is left out with the outlier segment.
    """
    seen = mask.sum(axis=0) >= 20
    if seen.sum() < FEWEST_JOINTS or len(time) < 3:
        return []
    size = np.zeros(residual.shape)
    for j in np.flatnonzero(seen):
        scale = _MAD * float(np.median(np.abs(residual[mask[:, j], j])))
        size[:, j] = np.where(mask[:, j], np.abs(residual[:, j]) / max(scale, 1e-12), 0.0)
    counted = (mask & seen).sum(axis=1)
    most = (counted >= FEWEST_JOINTS) & ((size > DEPARTURE).sum(axis=1) > counted / 2)
    dt = float(time[1] - time[0])
    reach = max(round(pad / dt), 1)
    joined, count = label(binary_closing(np.pad(most, reach), np.ones(2 * reach + 1, bool))[reach:-reach] | most)
    spans = [np.flatnonzero(joined == k + 1) for k in range(count)]
    if sum(len(s) for s in spans) > LARGEST_SHARE * len(time) or any(len(s) * dt > LONGEST for s in spans):
        return []
    return [
        OutlierSegment(
            run,
            max(int(s[0]) - reach, 0),
            min(int(s[-1]) + 1 + reach, len(time)),
            float(time[s[0]]),
            float(time[s[-1]]),
            int((size[s] > DEPARTURE).any(axis=0).sum()),
            float(size[s].max()),
        )
        for s in spans
    ]


def describe(found: Sequence[OutlierSegment], names: Sequence[str]) -> list[str]:
    """One line for each outlier segment, for the notes of the diagnosis."""
    return [
        f"run {names[d.run]}: around {0.5 * (d.first_time + d.last_time):.2f} s the torque of {d.joints} joints "
        f"departs at once, by up to {d.size:.0f} times the usual residual, from anything the motion explains (a bump, "
        "a sudden stop, a fault of the log); this outlier segment is left out of the fit, not of the reported errors"
        for d in found
    ]
