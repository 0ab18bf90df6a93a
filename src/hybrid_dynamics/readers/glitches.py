"""Single samples that cannot be motion or torque of this robot: found, counted, and left out by interpolation.

A glitch (a bit flipped on the bus, a sample of another message) stands alone: the samples to either side know nothing
of it. It departs from the running median of its neighbours (Hampel, JASA 69, 1974, with Pearson's window, IEEE Trans.
Control Syst. Technol. 10, 2002) by far more than the noise of its neighbourhood and by a good part of the whole signal,
and the signal is back where it was a few milliseconds later. A friction reversal does not come back, a contact lasts
longer, chatter at rest makes its own neighbourhood noisy: they stay as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import label, maximum_filter1d, median_filter, percentile_filter, uniform_filter1d

from hybrid_dynamics.trajectory import Trajectory, instant
from hybrid_dynamics.types import Array

Mask = NDArray[np.bool_]

#: Samples of the running median: three glitches in a row still leave the majority to their neighbours.
WINDOW = 7
#: A glitch lasts at most this many samples in a row, and more than one only within ``LONGEST`` [s].
MOST_IN_A_ROW, LONGEST = 3, 0.03
#: It departs by this many robust standard deviations of what the running median leaves, in the whole run and nearby.
DEVIATIONS = 10.0
#: ... and by this share of the signal's robust spread: torque; position and velocity, which cannot jump.
SHARE = {"tau": 0.7, "dq": 0.3, "q": 0.02}
EDGE_SHARE = 4.0
#: Of that share the departure from what is interpolated between its neighbours must be this much: at the turning point
#: of a motion that the log hardly resolves the running median is far away, but the neighbours know of it all the same.
UNKNOWN = 0.25
#: Samples to either side that tell how noisy the neighbourhood is.
NEARBY = 25
#: This many within ``NEARBY`` samples are a crowd.
CROWD = 4.5
#: A sample beyond this many times the largest other one is none, whatever its neighbours say.
ABSURD = 30.0
#: More than this share is a fault that somebody should look for.
MANY = 0.002
#: Where more than this share of a joint's samples departs, it is the way of the signal, not a fault of single samples.
MOST = 0.03
#: Rounds of finding and mending: glitches close together hide the smaller ones among them.
PASSES = 6
_MAD = 1.4826
_SIGNALS = ("q", "dq", "tau")


@dataclass(frozen=True)
class Glitches:
    """Glitches of one signal of one joint (0-based): ``rows`` left out, ``times`` [s] and ``sizes`` (departures)."""

    signal: str
    joint: int
    rows: NDArray[np.intp]
    times: Array
    sizes: Array


def departures(x: Array) -> tuple[Array, Array]:
    """Running median of ``x`` (T, n) and the robust scale of what departs from it nearby, both (T, n)."""
    base = median_filter(x, size=(WINDOW, 1), mode="mirror")
    # The third quartile, not the median: where half of the neighbours do not move at all, the others still count.
    local = percentile_filter(np.abs(x - base), 75, size=(2 * NEARBY + 1, 1), mode="mirror") / 1.15
    return base, np.asarray(local)


def find_glitches(x: Array, dt: float, signal: str) -> Mask:
    """(T, n) true where a sample of ``x`` (T, n) stands alone; ``dt`` [s] between samples."""
    finite = np.isfinite(x)
    # Beyond 1e100 squares overflow; such a value is a glitch of any size.
    x = np.clip(np.where(finite, x, 0.0), -1e100, 1e100)
    if len(x) < 3 * WINDOW:
        return ~finite
    low, high = np.percentile(x, [5, 95], axis=0)
    spread = _spread(x)
    ordinary = np.maximum(np.maximum(np.abs(low), np.abs(high)) + spread, 1e-3)
    steps = np.abs(np.diff(x, axis=0))
    resolution = np.array([np.min(s[s > 0], initial=np.inf) for s in steps.T])
    resolution = np.where(np.isfinite(resolution), resolution, 0.0)
    base, local = departures(x)
    usual = _MAD * np.median(np.abs(x - base), axis=0)
    scale = np.maximum(np.maximum(usual, local), resolution)
    least = np.tile(SHARE[signal] * spread, (len(x), 1))
    # The first and the last samples have neighbours on one side only: a step looks like a glitch there.
    least[[0, 1, -2, -1]] = EDGE_SHARE * spread
    out, mended = np.zeros_like(finite), x.copy()
    for _ in range(PASSES):
        size = np.abs(mended - base)
        largest = maximum_filter1d(size, WINDOW, axis=0)
        # A glitch shifts the median of its neighbours: the largest of them go first, the others are looked at again.
        flagged = (size > DEVIATIONS * scale) & (size > least) & (size > 0.4 * largest)
        # One that hardly exceeds the departures around it is the way of the signal there.
        flagged &= size > 2.0 * maximum_filter1d(np.where(flagged, 0.0, size), WINDOW, axis=0)
        flagged |= (np.abs(mended) > ABSURD * ordinary) & (size > 0.5 * np.abs(mended))
        flagged &= ~out
        if not flagged.any():
            break
        out |= flagged
        mended = np.where(flagged, base, mended)
        base = median_filter(mended, size=(WINDOW, 1), mode="mirror")
    size = np.abs(x - base)
    out &= _short(out, size, dt, 2.5 * spread)
    # Many close together are the way of the signal there (chatter at rest), unless they are beyond all measure.
    many = uniform_filter1d(out.astype(float), NEARBY, axis=0) * NEARBY > CROWD
    out &= ~maximum_filter1d(many.astype(np.uint8), NEARBY, axis=0).astype(bool) | (size > ABSURD * ordinary)
    out[:, out.mean(axis=0) > MOST] = False
    return out | ~finite


def _spread(x: Array) -> Array:
    """Robust standard deviation (n,) of ``x`` (T, n)."""
    low, high = np.percentile(x, [5, 95], axis=0)
    return np.asarray((high - low) / 3.3)


def _short(flagged: Mask, size: Array, dt: float, large: Array) -> Mask:
    """Flagged samples that do not stand together for longer than a glitch lasts."""
    out = np.zeros_like(flagged)
    for j in np.flatnonzero(flagged.any(axis=0)):
        runs, count = label(flagged[:, j])
        for k in range(1, count + 1):
            rows = np.flatnonzero(runs == k)
            brief = len(rows) <= MOST_IN_A_ROW and len(rows) * dt <= LONGEST
            # In a slow log two samples already last long: they must be more than a contact would make of them.
            out[rows, j] = len(rows) == 1 or brief or (len(rows) == 2 and bool(size[rows, j].min() > large[j]))
    return out


def repair(trajectory: Trajectory) -> tuple[Trajectory, list[Glitches]]:
    """``trajectory`` without its glitches, and what was left out. Unchanged (the same object) where there are none.

    Positions and velocities are interpolated by a cubic spline through the other samples, torque linearly: what is
    between two samples of a filtered signal is known to the accuracy of the noise.
    """
    found: list[Glitches] = []
    mended: dict[str, Array] = {}
    time = trajectory.time
    if len(time) < 3:
        return trajectory, found
    for signal in _SIGNALS:
        if signal not in trajectory:
            continue
        x = trajectory[signal]
        bad = find_glitches(x, trajectory.dt, signal)
        if not bad.any():
            continue
        out = x.copy()
        least = UNKNOWN * SHARE[signal] * _spread(np.where(np.isfinite(x), x, 0.0))
        for j in map(int, np.flatnonzero(bad.any(axis=0))):
            rows = np.flatnonzero(bad[:, j])
            if len(time) - len(rows) < WINDOW:
                continue
            with np.errstate(over="ignore", invalid="ignore"):
                rows = rows[~(np.abs(x[rows, j] - _between(time, x[:, j], rows, signal)) < least[j])]
                if not len(rows):
                    continue
                out[rows, j] = _between(time, x[:, j], rows, signal)
                sizes = np.abs(x[rows, j] - out[rows, j])
            found.append(Glitches(signal, j, rows, time[rows], sizes))
        mended[signal] = out
    return (trajectory.with_signals(**mended), found) if found else (trajectory, found)


def _between(time: Array, x: Array, rows: NDArray[np.intp], signal: str) -> Array:
    """``x`` (T,) at ``rows`` as the other samples have it."""
    good = np.ones(len(x), bool)
    good[rows] = False
    if signal == "tau":
        return np.asarray(np.interp(time[rows], time[good], x[good]))
    return np.asarray(CubicSpline(time[good], x[good])(np.clip(time[rows], *time[good][[0, -1]])))


def told(found: Sequence[Glitches], joint_names: Sequence[str], samples: int) -> list[str]:
    """One line a signal: how many samples of which joints, when, how large."""
    units = {"q": "rad", "dq": "rad/s", "tau": "N m"}
    out = []
    for signal in _SIGNALS:
        own = [g for g in found if g.signal == signal]
        if not own:
            continue
        count = sum(len(g.rows) for g in own)
        times = np.unique(np.concatenate([g.times for g in own]))
        when = ", ".join(instant(t) for t in times[:4]) + (", ..." if len(times) > 4 else "")
        sizes = np.concatenate([g.sizes for g in own])
        largest = f"{sizes.max():.3g} {units[signal]}" if np.isfinite(sizes).all() else "not finite"
        each = ", ".join(f"{joint_names[g.joint]} {len(g.rows)}" for g in own)
        what = f"1 sample of {signal}" if count == 1 else f"{count} samples of {signal}"
        alone = "stands" if count == 1 else "stand"
        out.append(
            f"{what} ({each}; of {samples} each) {alone} alone, at {when} s, the largest departs by "
            f"{largest}: no motion or torque of a robot; left out (interpolated)"
        )
    return out
