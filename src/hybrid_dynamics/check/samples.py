"""The motion and the torque of some runs, filtered alike and thinned out: what the plausibility checks look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_dynamics.differentiate.butterworth import lowpass
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: Low-pass [Hz] for all signals, lowered to ``CUTOFF_SHARE`` of a slow log's rate; samples kept per period of it.
CUTOFF, CUTOFF_SHARE, KEPT = 10.0, 0.1, 5.0
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
    """``run`` (``q tau`` on a uniform grid) filtered and thinned; None where it is too short to say anything."""
    dt = run.dt
    cutoff = min(CUTOFF, CUTOFF_SHARE / dt)
    trim = int(np.ceil(TRIM / cutoff / dt))
    if len(run.time) < 2 * trim + 20:
        return None
    q, tau = (lowpass(run[s], dt, cutoff) for s in ("q", "tau"))
    dq = np.gradient(q, dt, axis=0)
    ddq = np.gradient(dq, dt, axis=0)
    keep = max(int(1.0 / (dt * KEPT * cutoff)), 1)
    rows = slice(trim, len(q) - trim, keep)
    return Stretch(run.name, dt * keep, cutoff, q[rows], dq[rows], ddq[rows], tau[rows])


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
