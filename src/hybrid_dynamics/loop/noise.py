"""Noise floor of every joint, from the held-out residual of a rich fixed model.

The rich model knows no names: all columns of all candidate slots plus smooth functions of speed, position and load,
fitted per joint with a ridge chosen on held-out folds. Its training error is a little below the noise and its held-out
error a little above (by the same share to first order), so the floor is their geometric mean.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Slot
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.process import Run

Array = NDArray[np.float64]

_RIDGES = (1e-9, 1e-7, 1e-5, 1e-3, 1e-1)


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


def noise_floor(evidence: Evidence, slots: Sequence[Slot] = (), x: Array | None = None) -> Array:
    """Noise floor (n,) [N m] of the smoothed torque over the rows where the joint moves; 0 where it never does.

    With ``slots`` and their coordinates ``x`` the rich model is fitted to what they leave of the torque.
    """
    rigid = [evidence.predict_fine(evidence.base, run) for run in evidence.runs]
    left = evidence.base_target if x is None else evidence.residuals(slots, x)
    out = np.zeros(evidence.n)
    for j in range(evidence.n):
        if evidence.samples[j] < 20:
            continue
        extra = [run.smooth(rich_columns(run, tau, j)) for run, tau in zip(evidence.runs, rigid, strict=True)]
        blocks = []
        for b, (low, high) in enumerate(evidence.block_rows):
            r = evidence.block_run[b]
            keep = evidence.runs[r].mask[low:high, j]
            known = evidence.joint_rows(r, j)[low:high]
            target = left[r][low:high, j]
            blocks.append(np.column_stack([known, extra[r][low:high], target])[keep])
        out[j] = _floor(blocks, evidence.block_fold, evidence.folds)
    return out


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
            scale = 1.0 / np.sqrt(np.maximum(np.diag(gram)[:-1], 1e-300))
            a = gram[:-1, :-1] * scale[:, None] * scale[None, :]
            x = scale * np.linalg.solve(a + ridge * np.eye(len(a)), gram[:-1, -1] * scale)
            v = np.append(-x, 1.0)
            trained += max(float(v @ gram @ v), 0.0)
            tested += max(float(v @ grams[mine].sum(axis=0) @ v), 0.0)
            trained_rows += int(counts[~mine].sum())
            tested_rows += int(counts[mine].sum())
        if tested_rows:
            held, own = np.sqrt(tested / tested_rows), np.sqrt(trained / trained_rows)
            if held < best:
                best, value = held, float(np.sqrt(held * own))
    return value if np.isfinite(best) else 0.0
