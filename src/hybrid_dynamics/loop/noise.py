"""Noise floor of every joint, from the held-out residual of a rich fixed model.

The rich model knows no names: all columns of all candidate terms plus smooth functions of speed, position and load,
fitted per joint with a ridge chosen on held-out folds. Its training error is a little below the noise and its held-out
error a little above (by the same share to first order), so the floor is their geometric mean.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.problem import predict_fine
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.types import Array

#: From hardly any to hardly a model: where little is left, a free fit goes astray on motions it has not seen.
_RIDGES = (1e-9, 1e-7, 1e-5, 1e-3, 1e-1, 1e1, 1e3)
#: For a look at single moments of the runs that are fitted.
_GENTLE = 1e-5
#: Fewer rows than this for every column and the rich model would follow single samples.
_ROWS_PER_COLUMN = 10


def rich_columns(run: Run, rigid: Array, joint: int) -> Array:
    """Smooth functions (M, p) of the states of ``run`` for ``joint``; ``rigid`` is the model's torque (M, n)."""
    q, dq = run.motion.q[:, joint], run.motion.dq[:, joint]
    sign = np.tanh(dq / 0.05)
    load = np.abs(rigid[:, joint])
    parts = [dq * np.abs(dq), dq**3, np.tanh(dq / 0.2), load * sign, rigid[:, joint], q, q**2]
    for k in range(1, 5):
        parts += [np.sin(k * q), np.cos(k * q)]
    for other in range(run.motion.q.shape[1]):
        if other != joint:
            parts += [run.motion.dq[:, other], np.tanh(run.motion.dq[:, other] / 0.05)]
    return np.column_stack(parts)


def noise_floor(evidence: Evidence, terms: Sequence[Term] = (), x: Array | None = None) -> Array:
    """Noise floor (n,) [N m] of the smoothed torque over the rows where the joint moves; 0 where it never does.

    With ``terms`` and their coordinates ``x`` the rich model is fitted to what they leave of the torque.
    """
    left = evidence.problem.base_target if x is None else evidence.residuals(terms, x)
    out = np.zeros(evidence.n)
    for j, rows in rich_rows(evidence, left):
        blocks = [
            rows[r][low:high][evidence.mask[r][low:high, j]]
            for r, (low, high) in zip(evidence.blocks.run, evidence.blocks.rows, strict=True)
        ]
        out[j] = _floor(blocks, evidence.folds.of_block, evidence.folds.number)
    return out


def rich_residuals(evidence: Evidence) -> list[Array]:
    """What the rich model leaves of the torque (K, n) [N m], fitted run by run: runs may differ in what is missing.

    Where a run has too few rows for that, the fit on all runs serves it; where all have, it has as many directions of
    its columns as they have rows for, those first along which the columns vary most.
    """
    out = [np.zeros(t.shape) for t in evidence.problem.base_target]
    for j, rows in rich_rows(evidence, evidence.problem.base_target):
        counted = [part[mask[:, j]] for part, mask in zip(rows, evidence.mask, strict=True)]
        grams = [part.T @ part for part in counted]
        needed = _ROWS_PER_COLUMN * rows[0].shape[1]
        whole = sum(grams[1:], grams[0])
        for r, part in enumerate(rows):
            if len(counted[r]) >= needed:
                x = _ridge(grams[r], _GENTLE)
            else:
                x = _ridge(whole, _GENTLE, sum(map(len, counted)) // _ROWS_PER_COLUMN)
            out[r][:, j] = part[:, -1] - part[:, :-1] @ x
    return out


def rich_rows(evidence: Evidence, left: Sequence[Array]) -> Iterator[tuple[int, list[Array]]]:
    """Joint after joint the columns of the rich model, and the target ``left`` (K, n) as the last, in every run."""
    rigid = [predict_fine(evidence.base, run) for run in evidence.runs]
    for j in range(evidence.n):
        if evidence.samples[j] < 20:
            continue
        own = evidence.columns_of(j)
        rich = [run.smooth(rich_columns(run, rigid[r], j)) for r, run in enumerate(evidence.runs)]
        # A column twice would be held back by the ridge only half as much.
        new = [k for k in range(rich[0].shape[1]) if not _among(rich[0][:, k], own[0])]
        yield j, [np.column_stack([o, c[:, new], t[:, j]]) for o, c, t in zip(own, rich, left, strict=True)]


def _among(column: Array, columns: Array) -> bool:
    return bool(np.any(np.all(np.isclose(columns, column[:, None], rtol=1e-9, atol=1e-12), axis=0)))


def _ridge(gram: Array, ridge: float, most: int | None = None) -> Array:
    """Coefficients of the columns for the last one, from their Gram matrix, columns scaled to unit length; of ``most``
    directions at most, those of the largest eigenvalues (principal components: Jolliffe 1982)."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram)[:-1], 1e-300))
    a, b = gram[:-1, :-1] * scale[:, None] * scale[None, :], gram[:-1, -1] * scale
    if most is None or most >= len(a):
        return np.asarray(scale * np.linalg.solve(a + ridge * np.eye(len(a)), b))
    values, directions = eigh(a, subset_by_index=(len(a) - most, len(a) - 1))
    return np.asarray(scale * (directions @ (directions.T @ b / (values + ridge))))


def _floor(blocks: list[Array], fold: NDArray[np.int_], folds: int) -> float:
    grams = np.array([rows.T @ rows for rows in blocks])
    counts = np.array([len(rows) for rows in blocks])
    best = np.inf
    for ridge in _RIDGES:
        trained = tested = 0.0
        trained_rows = tested_rows = 0
        for f in range(folds):
            mine = fold == f
            if not counts[mine].sum() or not counts[~mine].sum():
                continue
            gram = grams[~mine].sum(axis=0)
            v = np.append(-_ridge(gram, ridge), 1.0)
            trained += max(float(v @ gram @ v), 0.0)
            tested += max(float(v @ grams[mine].sum(axis=0) @ v), 0.0)
            trained_rows += int(counts[~mine].sum())
            tested_rows += int(counts[mine].sum())
        if tested_rows:
            held, own = np.sqrt(tested / tested_rows), np.sqrt(trained / trained_rows)
            if held < best:
                best, value = held, float(np.sqrt(held * own))
    return value if np.isfinite(best) else 0.0
