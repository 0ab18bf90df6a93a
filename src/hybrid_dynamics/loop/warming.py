"""What is left of a joint's torque as friction that changes while a run lasts.

Trees that were shown the time would learn few runs by heart, and see less of everything else. What warms up does so
slowly, in every run: a handful of numbers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.types import Array

#: Powers of the time, in runs of one, by which friction changes: a relaxation is nearly a parabola.
POWERS = (0, 1, 2)
#: Weight, in rows, with which every number is held at nothing.
_SHRINK = 10.0


def friction_in_time(run: Run, joint: int, longest: float) -> Array:
    """Columns (K, 6): the sign of the speed, and the speed, of ``joint``, each times powers of the time since the run
    began, over ``longest`` [s]; columns without a unit."""
    dq = run.dq[:, joint]
    own = np.column_stack([np.sign(dq), dq / max(float(np.abs(dq).max(initial=0.0)), 1e-300)])
    since = (run.time - run.began) / longest
    return np.hstack([own * since[:, None] ** power for power in POWERS])


def linear_prediction(
    x: Array, target: Array, keep: NDArray[np.bool_], fold: NDArray[np.int_], shrink: float = _SHRINK
) -> Array:
    """Prediction (N,) of ``target`` (N,) by least squares on columns ``x`` (N, p), from other folds.

    ``keep`` (N,): rows that count; a ``fold`` (N,) of -1 is used by nobody.
    """
    out = np.zeros(len(target))
    for f in np.unique(fold[fold >= 0]):
        mine = fold == f
        known = x[keep & ~mine & (fold >= 0)]
        normal = known.T @ known + shrink * np.eye(x.shape[1])
        out[mine] = x[mine] @ np.linalg.solve(normal, known.T @ target[keep & ~mine & (fold >= 0)])
    return out
