"""Torque that is cut off: samples that pile up at the largest or smallest value of a joint that moves.

It may be what the drive delivers at most, and true; or the end of what is measured, and no torque of the robot. Nothing
in the log says which, so these samples are no evidence: friction, a contact or a gain would be named for them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, find_objects, gaussian_filter1d, label

from hybrid_dynamics.check.findings import Finding
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: Range [rad or m] that a joint must cover to count as moving.
MOVING = 0.02
#: Share of the samples at one extreme value that is no coincidence, and how many in a row, in rows that a sample lasts.
CLIPPED_SHARE, CLIPPED_ROW = 0.005, 5
#: Next levels of a coarse converter that hold as much as its last one where nothing is clipped: a wave is within the
#: last k levels for a time that grows as the square root of k, so that the last of four holds half of it.
LEVELS = 3.5
#: Share of the samples beyond which they are no exception: the friction of a light joint is a constant, too.
MOST = 1 / 3
#: Share of the torque's range within which samples are near its end; and within which those that a resampled log has
#: there are one value: a spline rings after a corner.
NEAR, ONE_VALUE = 0.03, 1e-3
#: Torque of the robot's own bodies that changes by less than this share of its spread along stretches of such samples
#: (rms, from half to half and from the middle to the ends) is constant as they are. So near [s] their ends it is
#: smeared by a bell of this standard deviation [s]; stretches of fewer samples say nothing.
EVEN, EDGES, SMOOTHED, FEWEST = 0.03, 0.05, 0.015, 8
#: What is said of the joints of which such samples are exceptions, and of the others.
LEFT_OUT = (
    "clipped; that may be the end of what is measured, and not of what the drive delivers, so close-loop leaves these "
    "stretches out; record with less torque to learn from all of a run"
)
TOO_MANY = (
    "clipped, or the friction of a light joint and nothing else: too much to be left out; where it is the end of what "
    "is measured, record with less torque"
)


def check_clipped(run: Trajectory, robot: Robot) -> list[Finding]:
    """A warning where the torque of a joint of ``robot`` that moves piles up at its largest or smallest value."""
    if "tau" not in run:
        return []
    few: list[str] = []
    many: list[str] = []
    for j, levels in _cut_off(run, robot).items():
        shares = "; ".join(f"{share:.1%} of the samples at {level:.4g} N m" for level, share in levels)
        (few if _exceptions(levels) else many).append(f"tau{j + 1} ({shares})")
    told = ((few, LEFT_OUT), (many, TOO_MANY))
    return [Finding("saturation", "warning", f"{', '.join(own)}: {text}", run=run.name) for own, text in told if own]


def clipped_samples(run: Trajectory, robot: Robot) -> NDArray[np.bool_]:
    """(T, n) where the torque of a joint of ``robot`` that moves is at a value at which it is cut off, unless most
    samples are."""
    out = np.zeros(run["tau"].shape, bool)
    for j, levels in _cut_off(run, robot).items():
        for level, _ in levels if _exceptions(levels) else ():
            out[:, j] |= _at(run["tau"][:, j], level)
    return out


def own_torque(robot: Robot, q: Array, dt: float) -> Array:
    """(T, n) [N m] of ``robot``'s bodies along smooth positions ``q`` (T, n) [rad], ``dt`` [s] apart."""
    dq = np.gradient(q, dt, axis=0)
    return robot.inverse_dynamics(q, dq, np.gradient(dq, dt, axis=0))


def _at(tau: Array, level: float) -> NDArray[np.bool_]:
    return np.asarray(np.abs(tau - level) <= ONE_VALUE * np.ptp(tau))


def _cut_off(run: Trajectory, robot: Robot) -> dict[int, list[tuple[float, float]]]:
    """:func:`_levels` of the joints that move, of those that have any: those at which the motion does not ask for the
    same torque all the while.

    Where an axis accelerates evenly, as along the trapezoidal speeds of most controllers, the torque is constant, too.
    """
    moving = map(int, np.flatnonzero(np.ptp(run["q"], axis=0) >= MOVING))
    piled = {j: levels for j in moving if (levels := _levels(run, j))}
    if not piled:
        return {}
    # A bell rings at no corner, as sharper filters do.
    q = gaussian_filter1d(run["q"], max(SMOOTHED / run.dt, 1.0), axis=0, mode="nearest")
    own, reach = own_torque(robot, q, run.dt), max(round(EDGES / run.dt), 1)
    kept = {
        j: [found for found in levels if _changes(own[:, j], _at(run["tau"][:, j], found[0]), reach)]
        for j, levels in piled.items()
    }
    return {j: levels for j, levels in kept.items() if levels}


def _changes(own: Array, at: NDArray[np.bool_], reach: int) -> bool:
    """Whether ``own`` (T,) changes along the stretches of ``at`` (T,), ``reach`` samples (of short ones a quarter) away
    from their ends; where all are very short, nothing says that it does not."""
    # Noise within the value's width breaks a stretch that the eye sees as one.
    whole = binary_closing(at, iterations=CLIPPED_ROW)
    parts = [own[part] for (part,) in find_objects(label(whole)[0]) if part.stop - part.start >= FEWEST]
    parts = [part[ends : len(part) - ends] for part in parts for ends in [min(reach, len(part) // 4)]]
    if not parts:
        return True
    halves = [[half.mean() for half in np.array_split(part, 2)] for part in parts]
    quarters = [np.array_split(part, 4) for part in parts]
    middle = [np.concatenate(q[1:3]).mean() - np.concatenate([q[0], q[3]]).mean() for q in quarters]
    changes = np.diff(halves, axis=1)[:, 0] ** 2 + np.square(middle)
    return bool(np.sqrt(np.average(changes, weights=[len(part) for part in parts])) > EVEN * own.std())


def _exceptions(levels: Sequence[tuple[float, float]]) -> bool:
    return bool(sum(share for _, share in levels) <= MOST)


def _levels(run: Trajectory, j: int) -> list[tuple[float, float]]:
    """Values at which the torque of joint ``j`` is cut off, and the shares of its samples there; largest share first.

    A coarse converter's last level holds more than its next, as a wave stays longest where it turns, but not more than
    the next few together.
    """
    # At rest a torque may well be the same for long, and its largest.
    tau = run["tau"][np.gradient(run["q"][:, j]) != 0.0, j]
    span = float(np.ptp(tau)) if len(tau) else 0.0
    out = []
    for sign in (1.0, -1.0) if span > 0 else ():
        extreme = float(sign * np.max(sign * tau))
        off = np.abs(tau - extreme)
        at = off <= 1e-9 * max(abs(extreme), 1e-9)
        row = CLIPPED_ROW * _held(tau, at)
        if _piled(at, at, row) and _piled(at, off <= _few_levels(tau), row):
            out.append((extreme, float(at.mean())))
            continue
        near = off <= NEAR * span
        middle = float(np.median(tau[near]))
        at = np.abs(tau - middle) <= ONE_VALUE * span
        if _piled(at, near, CLIPPED_ROW) and _few_levels(tau) < ONE_VALUE * span:
            out.append((middle, float(at.mean())))
    return sorted(out, key=lambda found: -found[1])


def _piled(at: NDArray[np.bool_], near: NDArray[np.bool_], row: float) -> bool:
    """Whether samples ``at`` (T,) a value are more than chance, some ``row`` of them in a row, and most of those
    ``near`` the end of the range."""
    return bool(at.mean() > CLIPPED_SHARE and 2 * at.sum() > near.sum() and _longest(at) >= row)


def _held(tau: Array, at: NDArray[np.bool_]) -> float:
    """How many rows a sample of ``tau`` (T,) lasts elsewhere than ``at`` its end: a torque that comes more slowly than
    the rows repeats each."""
    elsewhere = ~at[1:]
    changes = np.sum((np.diff(tau) != 0.0) & elsewhere)
    return float(elsewhere.sum() / max(changes, 1)) if elsewhere.any() else 1.0


def _few_levels(tau: Array) -> float:
    """How far the last :data:`LEVELS` of a coarse converter are apart [N m]; next to nothing of a fine one."""
    apart = np.diff(np.unique(tau))
    apart = apart[apart > 1e-6 * np.ptp(tau)]
    return LEVELS * float(np.median(apart)) if apart.size else 0.0


def _longest(flags: NDArray[np.bool_]) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return int(np.max(edges[1::2] - edges[::2], initial=0))
