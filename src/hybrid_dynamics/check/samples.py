"""The motion and the torque of some runs, filtered alike and thinned out: what the plausibility checks look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_dynamics.differentiate.butterworth import lowpass
from hybrid_dynamics.differentiate.scatter import position_noise
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: Low-pass [Hz] for all signals, lowered to ``CUTOFF_SHARE`` of a slow log's rate; samples kept per period of it.
CUTOFF, CUTOFF_SHARE, KEPT = 10.0, 0.1, 5.0
#: Of the accelerations' variance (mean of the joints that move) noise of coarse positions may be this share: the
#: low-pass of all runs is lowered by steps until it is no more, at most down to the lowest [Hz], and as long as so many
#: rows are kept, three times what the checks ask for. ``SLOW`` [Hz]: what moves below is motion, however coarse.
NOISE, STEP, LOWEST, LEAST_KEPT, SLOW = 0.05, 2.0**-0.5, 1.25, 120, 2.5
#: A joint moves that ranges over more than this [rad, m].
MOVES = 0.05
#: Left out at both ends, in periods of the cut-off: the filter's transients.
TRIM = 2.0
#: Rows in all that are looked at; longer logs are thinned out by leaving out whole runs, then by cutting runs.
MOST_ROWS = 12_000
#: Width [rad/s] over which the sign of the speed turns over: neither noise nor stiction decide.
SIGN_WIDTH = 0.03


@dataclass(frozen=True)
class Stretch:
    """One run: ``dt`` [s] between kept rows, ``q dq ddq tau`` (K, n), position's derivatives, all with one filter."""

    name: str
    dt: float
    cutoff: float
    q: Array
    dq: Array
    ddq: Array
    tau: Array

    @property
    def time(self) -> Array:
        """(K,) [s] since the run began."""
        return np.asarray(TRIM / self.cutoff + self.dt * np.arange(len(self.q)), float)


def stretches(runs: Sequence[Trajectory]) -> list[Stretch]:
    """Those of ``runs`` (``q tau`` on uniform grids) that are long enough, filtered and thinned, :data:`MOST_ROWS` rows
    at most.

    Where positions are so coarse, or so noisy, that accelerations would be noise of theirs, the low-pass is lowered, of
    all runs alike: noise that nobody moved with looks like inertia that the torque lacks, and so like a clock that runs
    too fast.
    """
    cutoff = _bearable(runs)
    out: list[Stretch] = []
    left = MOST_ROWS
    for run in runs:
        if left <= 0:
            break
        rows = left * _every(min(cutoff, _usual(run)), run.dt) + 1
        made = stretch(run.rows(slice(0, rows)) if len(run.time) > rows else run, cutoff)
        if made is not None:
            out.append(made)
            left -= len(made.q)
    return out


def stretch(run: Trajectory, most: float = CUTOFF) -> Stretch | None:
    """``run`` filtered at ``most`` [Hz], or what its rate allows, and thinned; None where it is too short for that."""
    dt, cutoff = run.dt, min(most, _usual(run))
    if not _long_enough(run, cutoff):
        return None
    q, dq, ddq = _derivatives(run, cutoff)
    tau = lowpass(run["tau"], dt, cutoff)
    keep = _every(cutoff, dt)
    rows = slice(_trim(cutoff, dt), len(q) - _trim(cutoff, dt), keep)
    return Stretch(run.name, dt * keep, cutoff, q[rows], dq[rows], ddq[rows], tau[rows])


def _bearable(runs: Sequence[Trajectory]) -> float:
    """The cut-off [Hz] up to which accelerations of ``runs`` are motion (:data:`NOISE`), or the lowest that they can
    bear: none becomes too short for it, and together they keep enough rows."""
    heard = _heard(runs)
    cutoff = max(map(_usual, heard), default=CUTOFF)
    noise = [position_noise(run["q"], run.dt, held=True) for run in heard]
    slow = [_derivatives(run, min(SLOW, _usual(run)))[2].var(axis=0) for run in heard]

    def share(cutoff: float) -> float:
        """Of the accelerations of all runs, in the mean of the joints that move."""
        said: list[Array] = []
        for run, level, least in zip(heard, noise, slow, strict=True):
            own = min(cutoff, _usual(run))
            made = level * (2 * np.pi) ** 4 * own**5 / 5
            motion = np.maximum(_derivatives(run, own)[2].var(axis=0) - made, least)
            moves = np.ptp(run["q"], axis=0) > MOVES
            said.append((made / np.maximum(made + motion, 1e-300))[moves])
        return float(np.mean(np.concatenate(said))) if said and np.concatenate(said).size else 0.0

    def bears(cutoff: float) -> bool:
        kept = [len(run.time) - 2 * _trim(min(cutoff, _usual(run)), run.dt) for run in heard]
        rows = sum(k // _every(min(cutoff, _usual(run)), run.dt) for k, run in zip(kept, heard, strict=True))
        return rows >= LEAST_KEPT and min(kept) >= 20

    while cutoff * STEP >= LOWEST and bears(cutoff * STEP) and share(cutoff) > NOISE:
        cutoff *= STEP
    return cutoff


def _heard(runs: Sequence[Trajectory]) -> list[Trajectory]:
    """What of ``runs`` would be looked at were their positions fine."""
    out: list[Trajectory] = []
    left = MOST_ROWS
    for run in runs:
        every = _every(_usual(run), run.dt)
        part = run.rows(slice(0, left * every + 1)) if len(run.time) > left * every + 1 else run
        if left > 0 and _long_enough(part, _usual(part)):
            out.append(part)
            left -= len(part.time) // every
    return out


def _usual(run: Trajectory) -> float:
    """The cut-off [Hz] of a ``run`` of fine positions."""
    return min(CUTOFF, CUTOFF_SHARE / run.dt)


def _every(cutoff: float, dt: float) -> int:
    """One of how many samples is kept behind a low-pass at ``cutoff`` [Hz]."""
    return max(int(1.0 / (dt * KEPT * cutoff)), 1)


def _trim(cutoff: float, dt: float) -> int:
    return int(np.ceil(TRIM / cutoff / dt))


def _long_enough(run: Trajectory, cutoff: float) -> bool:
    return len(run.time) >= 2 * _trim(cutoff, run.dt) + 20


def _derivatives(run: Trajectory, cutoff: float) -> tuple[Array, Array, Array]:
    """Positions below ``cutoff`` [Hz] and their derivatives, (N, n) each."""
    q = lowpass(run["q"], run.dt, cutoff)
    dq = np.gradient(q, run.dt, axis=0)
    return q, dq, np.gradient(dq, run.dt, axis=0)


def direction(dq: Array) -> Array:
    """Smooth sign of the speed."""
    return np.asarray(np.tanh(dq / SIGN_WIDTH))
