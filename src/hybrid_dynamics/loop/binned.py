"""What is left of a joint's torque as a curve over one variable: means of narrow bins.

Laws close to a named one (another Stribeck exponent, a wider sign, a stiffening spring) leave little, over one variable
of the joint itself. Trees that look at the states of all joints do not see so little; a mean over a bin does.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.types import Array

Indices = NDArray[np.int_]

#: Bins over one variable, and samples of nothing that every bin begins with.
BINS, SHRINK = 24, 10.0


def curves_of(run: Run, joint: int) -> list[tuple[Array, Indices]]:
    """Variables (K,) of ``joint`` that what is left may be a curve over, each with the branch (K,) of every row.

    Speed, getting faster or slower: friction, with memory or without; position: springs and ripples.
    """
    q, dq, ddq = run.q[:, joint], run.dq[:, joint], run.ddq[:, joint]
    return [(dq, (dq * ddq > 0).astype(int)), (q, np.zeros(len(q), int))]


def binned_prediction(
    value: Array, branch: Indices, target: Array, keep: NDArray[np.bool_], fold: Indices, bins: int = BINS
) -> Array:
    """Prediction (N,) of ``target`` by its mean over bins of ``value`` (N,) per ``branch`` (N,), from other folds.

    ``keep`` (N,): rows that count; a ``fold`` (N,) of -1 is used by nobody.
    """
    edges = np.unique(np.quantile(value[keep], np.linspace(0, 1, bins + 1)[1:-1]))
    place = np.searchsorted(edges, value) + (len(edges) + 1) * branch
    size = (len(edges) + 1) * (int(branch.max()) + 1)
    out = np.zeros(len(target))
    for f in np.unique(fold[fold >= 0]):
        mine = fold == f
        known = keep & ~mine & (fold >= 0)
        total = np.bincount(place[known], target[known], size)
        out[mine] = (total / (np.bincount(place[known], minlength=size) + SHRINK))[place[mine]]
    return out


def over_all(curves: Sequence[list[tuple[Array, Indices]]], which: int) -> tuple[Array, Indices]:
    """Variable number ``which`` and its branches, of all runs one after the other."""
    return np.concatenate([c[which][0] for c in curves]), np.concatenate([c[which][1] for c in curves])
