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
#: Left out at both ends, in periods of the cut-off: the filter's transients; samples that there must be between them.
TRIM, LEAST_INSIDE = 2.0, 20
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
    cutoff = _bearable(_looked_at(runs))
    made = (stretch(run, cutoff) for run in _looked_at(runs, cutoff))
    return [part for part in made if part is not None]


def stretch(run: Trajectory, most: float = CUTOFF) -> Stretch | None:
    """``run`` filtered at ``most`` [Hz], or what its rate allows, and thinned; None where it is too short for that."""
    dt, cutoff = run.dt, usual_cutoff(run, most)
    if not long_enough(run, cutoff):
        return None
    q, dq, ddq = _derivatives(run, cutoff)
    tau, rows = lowpass(run["tau"], dt, cutoff), kept(run, cutoff)
    return Stretch(run.name, dt * rows.step, cutoff, q[rows], dq[rows], ddq[rows], tau[rows])


def usual_cutoff(run: Trajectory, most: float = CUTOFF) -> float:
    """The cut-off [Hz] of a ``run`` of fine positions, at ``most``."""
    return min(most, CUTOFF_SHARE / run.dt)


def kept(run: Trajectory, cutoff: float) -> slice:
    """Which samples of ``run`` are kept behind a low-pass at ``cutoff`` [Hz]: none near its ends, few of the others."""
    trim = int(np.ceil(TRIM / cutoff / run.dt))
    return slice(trim, len(run.time) - trim, max(int(1.0 / (run.dt * KEPT * cutoff)), 1))


def long_enough(run: Trajectory, cutoff: float) -> bool:
    """Whether a ``run`` says anything behind a low-pass at ``cutoff`` [Hz]."""
    return _inside(run, cutoff) >= LEAST_INSIDE


def _inside(run: Trajectory, cutoff: float) -> int:
    """Samples that are not near the ends of ``run``."""
    rows = kept(run, cutoff)
    return int(rows.stop - rows.start)


def _looked_at(runs: Sequence[Trajectory], most: float = CUTOFF) -> list[Trajectory]:
    """What of ``runs`` is looked at behind a low-pass at ``most`` [Hz]: what is long enough, and not too much."""
    out: list[Trajectory] = []
    left = MOST_ROWS
    for run in runs:
        if left <= 0:
            break
        cutoff = usual_cutoff(run, most)
        every = kept(run, cutoff).step
        part = run.rows(slice(0, left * every + 1)) if len(run.time) > left * every + 1 else run
        if long_enough(part, cutoff):
            out.append(part)
            left -= -(-_inside(part, cutoff) // every)
    return out


def _bearable(runs: Sequence[Trajectory]) -> float:
    """The cut-off [Hz] up to which accelerations of ``runs`` are motion (:data:`NOISE`), or the lowest that they can
    bear: none becomes too short for it, and together they keep enough rows."""
    cutoff = max(map(usual_cutoff, runs), default=CUTOFF)
    noise = [position_noise(run["q"], run.dt, held=True) for run in runs]
    slow = [_derivatives(run, usual_cutoff(run, SLOW))[2].var(axis=0) for run in runs]

    def share(cutoff: float) -> float:
        """Of the accelerations of all runs, in the mean of the joints that move."""
        said = [np.zeros(0)]
        for run, level, least in zip(runs, noise, slow, strict=True):
            own = usual_cutoff(run, cutoff)
            made = level * (2 * np.pi) ** 4 * own**5 / 5
            motion = np.maximum(_derivatives(run, own)[2].var(axis=0) - made, least)
            said.append((made / np.maximum(made + motion, 1e-300))[np.ptp(run["q"], axis=0) > MOVES])
        of_all = np.concatenate(said)
        return float(of_all.mean()) if of_all.size else 0.0

    def bears(cutoff: float) -> bool:
        own = [usual_cutoff(run, cutoff) for run in runs]
        rows = sum(_inside(run, c) // kept(run, c).step for run, c in zip(runs, own, strict=True))
        return rows >= LEAST_KEPT and all(map(long_enough, runs, own))

    while cutoff * STEP >= LOWEST and bears(cutoff * STEP) and share(cutoff) > NOISE:
        cutoff *= STEP
    return cutoff


def _derivatives(run: Trajectory, cutoff: float) -> tuple[Array, Array, Array]:
    """Positions below ``cutoff`` [Hz] and their derivatives, (N, n) each."""
    q = lowpass(run["q"], run.dt, cutoff)
    dq = np.gradient(q, run.dt, axis=0)
    return q, dq, np.gradient(dq, run.dt, axis=0)


def direction(dq: Array) -> Array:
    """Smooth sign of the speed."""
    return np.asarray(np.tanh(dq / SIGN_WIDTH))
