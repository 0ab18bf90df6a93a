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
#: Of the accelerations' variance, the share that noise of coarse positions may be: the low-pass is lowered until it is.
NOISE, LOWEST, STEP = 0.05, 2.0, 2.0**-0.5
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


def stretch(run: Trajectory) -> Stretch | None:
    """``run`` (``q tau`` on a uniform grid) filtered and thinned; None where it is too short to say anything.

    Where positions come in steps so coarse that accelerations would be noise of theirs, a lower low-pass for all:
    noise that nobody moved with looks like inertia that the torque lacks, and so like a clock that runs too fast.
    """
    dt = run.dt
    cutoff = min(CUTOFF, CUTOFF_SHARE / dt)
    if not _long_enough(run, cutoff):
        return None
    q, dq, ddq = _derivatives(run, cutoff)
    noise = position_noise(run["q"], dt).sum()
    while _noise(noise, cutoff) > NOISE * ddq.var(axis=0).sum() and cutoff * STEP >= LOWEST:
        if not _long_enough(run, cutoff * STEP):
            break
        cutoff *= STEP
        q, dq, ddq = _derivatives(run, cutoff)
    tau = lowpass(run["tau"], dt, cutoff)
    keep = max(int(1.0 / (dt * KEPT * cutoff)), 1)
    rows = slice(_trim(cutoff, dt), len(q) - _trim(cutoff, dt), keep)
    return Stretch(run.name, dt * keep, cutoff, q[rows], dq[rows], ddq[rows], tau[rows])


def _trim(cutoff: float, dt: float) -> int:
    return int(np.ceil(TRIM / cutoff / dt))


def _long_enough(run: Trajectory, cutoff: float) -> bool:
    return len(run.time) >= 2 * _trim(cutoff, run.dt) + 20


def _derivatives(run: Trajectory, cutoff: float) -> tuple[Array, Array, Array]:
    """Positions below ``cutoff`` [Hz] and their derivatives, (N, n) each."""
    q = lowpass(run["q"], run.dt, cutoff)
    dq = np.gradient(q, run.dt, axis=0)
    return q, dq, np.gradient(dq, run.dt, axis=0)


def _noise(density: float, cutoff: float) -> float:
    """Variance [rad^2/s^4] of accelerations below ``cutoff`` [Hz] by positions' white noise [rad^2/Hz]."""
    return float(density * (2 * np.pi) ** 4 * cutoff**5 / 5)


def stretches(runs: Sequence[Trajectory]) -> list[Stretch]:
    """Those of ``runs`` that are long enough, :data:`MOST_ROWS` rows at most."""
    out: list[Stretch] = []
    left = MOST_ROWS
    for run in runs:
        if left <= 0:
            break
        rows = int(left * max(1.0 / (run.dt * KEPT * min(CUTOFF, CUTOFF_SHARE / run.dt)), 1)) + 1
        made = stretch(run.rows(slice(0, rows)) if len(run.time) > rows else run)
        if made is not None:
            out.append(made)
            left -= len(made.q)
    return out


def direction(dq: Array) -> Array:
    """Smooth sign of the speed."""
    return np.asarray(np.tanh(dq / SIGN_WIDTH))
