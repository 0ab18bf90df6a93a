"""Outlier segments in a log: moments in which most joints depart at once from anything the motion explains.

A bump against the arm, a stop harder than the filters resolve or a fault of the log lasts a fraction of a second and
is no property of the robot, but least squares hands its energy to whatever effect comes nearest. What the rich model
of :mod:`hybrid_dynamics.loop.noise` leaves is compared with its robust scale (median absolute deviation):
friction alone surprises single joints, an outlier segment surprises most of them together. Where most joints jolt
(their acceleration departs from its own usual range in the same way) the filters do not resolve the motion, and more
than one joint that departs is enough. Long or frequent departures are not left out: they ask for an explanation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, label, maximum_filter1d

from hybrid_dynamics.types import Array

#: A sample departs where the residual exceeds this many robust standard deviations of its joint.
DEPARTURE = 6.0
#: Standard deviation of a normal variable over its median absolute deviation.
_MAD = 1.4826
#: Longest outlier segment [s], and the largest share of a run that outlier segments may take.
LONGEST, LARGEST_SHARE = 1.0, 0.05
#: Fewer joints in motion cannot tell an outlier segment from an effect of their own.
FEWEST_JOINTS = 3
#: Fewest joints that depart in a jolt: friction surprises single ones.
IN_A_JOLT = 2


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
    run: int, time: Array, ddq: Array, residual: Array, mask: NDArray[np.bool_], pad: float
) -> list[OutlierSegment]:
    """Outlier segments in one run: ``time`` (K,) [s], ``ddq`` (K, n) [rad/s^2], ``residual`` (K, n) [N m], ``mask``
    (K, n) rows that count.

    ``pad`` [s] is how far the filters carry a moment to either side; it is left out with the outlier segment.
    """
    seen = mask.sum(axis=0) >= 20
    if seen.sum() < FEWEST_JOINTS or len(time) < 3:
        return []
    size = _departure(residual, mask & seen)
    counted = (mask & seen).sum(axis=1)
    departs = size > DEPARTURE
    most = (counted >= FEWEST_JOINTS) & (departs.sum(axis=1) > counted / 2)
    reach = max(round(pad / float(time[1] - time[0])), 1)
    jolts = _departure(ddq - np.median(ddq, axis=0), np.ones(ddq.shape, bool)) > DEPARTURE
    jolted = (_near(jolts, reach) > ddq.shape[1] / 2) & (_near(departs, reach) >= IN_A_JOLT) & departs.any(axis=1)
    # Jolts that come often are the motion itself: then only what surprises most joints counts.
    for moments in (most | jolted, most):
        spans = _spans(moments, reach)
        if _rare(spans, time, reach):
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
    return []


def _departure(values: Array, mask: NDArray[np.bool_]) -> Array:
    """(K, n) sizes of ``values`` in robust standard deviations of the column over ``mask``; 0 outside of it."""
    size = np.zeros(values.shape)
    for j in np.flatnonzero(mask.any(axis=0)):
        scale = _MAD * float(np.median(np.abs(values[mask[:, j], j])))
        size[:, j] = np.where(mask[:, j], np.abs(values[:, j]) / max(scale, 1e-12), 0.0)
    return size


def _near(moments: NDArray[np.bool_], reach: int) -> NDArray[np.int_]:
    """(K,) number of joints with one of ``moments`` (K, n) within ``reach`` rows: filters ring at each its own time."""
    return np.asarray(maximum_filter1d(moments, 2 * reach + 1, axis=0, mode="constant").sum(axis=1))


def _spans(moments: NDArray[np.bool_], reach: int) -> list[NDArray[np.int_]]:
    """Rows of each segment; moments that the filters carry into each other are one."""
    padded = np.pad(moments, reach)
    joined, count = label(binary_closing(padded, np.ones(2 * reach + 1, bool))[reach:-reach] | moments)
    return [np.flatnonzero(joined == k + 1) for k in range(count)]


def _rare(spans: list[NDArray[np.int_]], time: Array, reach: int) -> bool:
    """True where ``spans`` are short and few: :data:`LARGEST_SHARE` of the rows, and with what the filters carry to
    either side, ``reach`` rows, twice as much. Of five seconds a knock of a tenth is more by its flanks alone."""
    dt = float(time[1] - time[0])
    own, whole = sum(max(len(s) - 2 * reach, 1) for s in spans), sum(len(s) for s in spans)
    few = own <= LARGEST_SHARE * len(time) and whole <= 2 * LARGEST_SHARE * len(time)
    return few and all(len(s) * dt <= LONGEST for s in spans)


def describe(found: Sequence[OutlierSegment], names: Sequence[str]) -> list[str]:
    """One line for each outlier segment, for the notes of the diagnosis."""
    return [
        f"run {names[d.run]}: around {0.5 * (d.first_time + d.last_time):.2f} s the torque of {d.joints} joints "
        f"departs at once, by up to {d.size:.0f} times the usual residual, from anything the motion explains (a bump, "
        "a sudden stop, a fault of the log); this outlier segment is left out of the fit, not of the reported errors"
        for d in found
    ]
