"""Uncertainty of coordinates from blocks of time, each left out in turn: every correlation inside a block is respected.

The sandwich of Liang and Zeger (1986) takes the residuals of the fit for the noise; where blocks are few against the
parameters the fit has eaten part of it, and the errors come out too small. Leaving the blocks out of the fit (the
jackknife, "CR3" in Bell and McCaffrey 2002) undoes that, and one block that alone knows a parameter says so. Neighbours
are left out together: short blocks remember each other over their border (Bartlett's weights, Newey and West 1987).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.types import Array

#: Against the diagonal: directions that hardly any sample knows stay solvable.
TINY = 1e-12


def covariance_of(
    normal: Array, parts: Array, scores: Array, owner: NDArray[np.int_], prior: Array | None = None
) -> Array:
    """Covariance (K, K) of the solution of ``normal`` (K, K) x = b.

    ``parts`` (B, K, K): what each block adds to ``normal``; ``scores`` (B, K): its right-hand side less ``parts`` x;
    ``owner`` (B,): its run, in order of time; ``prior`` (K, K): what in ``normal`` is of data in no block, whose errors
    are as large as its weights say.
    """
    blocks, size = scores.shape
    if not size:
        return np.zeros((0, 0))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scale[np.diag(normal) <= 0] = 0.0

    def changes(left_out: Array, score: Array) -> Array:
        rest = (normal - left_out) * scale[:, None] * scale + TINY * np.eye(size)
        return np.asarray(scale * np.linalg.solve(rest, (score * scale)[:, :, None])[:, :, 0])

    next_to = owner[1:] == owner[:-1]
    pairs = changes((parts[1:] + parts[:-1])[next_to], (scores[1:] + scores[:-1])[next_to])
    # A block inside a run is in two pairs; one at an end of it is in one, and one alone in none.
    missing = 2 - np.append(next_to, False).astype(int) - np.append(False, next_to).astype(int)
    singles = changes(parts[missing > 0], scores[missing > 0])
    total = pairs.T @ pairs + (singles * missing[missing > 0, None]).T @ singles
    left_out = np.asarray(0.5 * total * (blocks - 1) / blocks)
    if prior is None or not prior.any():
        return left_out
    whole = normal * scale[:, None] * scale + TINY * np.eye(size)
    half = np.linalg.solve(whole, prior * scale[:, None])
    return left_out + scale[:, None] * np.linalg.solve(whole, half.T * scale[:, None]).T * scale
