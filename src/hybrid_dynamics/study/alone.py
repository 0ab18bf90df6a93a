"""How large an effect is by what it alone explains: the torque that the other effects beside it cannot make."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.effects import Effect, Motion, Term
from hybrid_dynamics.loop.diagnosis import predict_run
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array


def flat_columns(term: Term, motions: Sequence[Motion], floor: Array) -> Array:
    """Regressor (sum of T x n, p) of ``term`` over all motions, every joint's torque in units of its ``floor`` (n,)."""
    return np.concatenate([(_wide(term, m) / floor[:, None]).reshape(-1, term.size) for m in motions])


def alone(torque: Array, others: Sequence[Array], joints: int) -> float:
    """Largest root mean square over ``joints`` of ``torque`` (T x n,), in its unit, less what ``others`` can make."""
    if others:
        basis = np.column_stack(others)
        size = np.linalg.norm(basis, axis=0)
        basis = basis / np.where(size > 0, size, 1.0)
        torque = torque - basis @ np.linalg.lstsq(basis, torque, rcond=1e-9)[0]
    return float(np.sqrt(np.mean(torque.reshape(-1, joints) ** 2, axis=0)).max())


def alone_sizes(robot: Robot, effects: Sequence[Effect], runs: Sequence[Run], floor: Array) -> list[float]:
    """Size of each of ``effects`` in floors, on what the loop sees of ``runs`` (smoothed, joints in motion)."""
    model = Model(robot, tuple(effects))
    mask = np.concatenate([run.mask for run in runs])
    terms = [effect.term(robot) for effect in effects]
    columns = [
        np.where(mask[:, :, None], np.concatenate([run.smooth(_wide(t, run.motion)) for run in runs]), 0.0)
        for t in terms
    ]
    scale = np.where(floor > 0, floor, np.inf)[:, None]
    flat = [(c / scale).reshape(-1, c.shape[2]) for c in columns]
    out = []
    for k in range(len(effects)):
        less = Model(robot, tuple(e for i, e in enumerate(effects) if i != k))
        torque = np.concatenate([predict_run(model, run) - predict_run(less, run) for run in runs])
        out.append(alone((np.where(mask, torque, 0.0) / scale[:, 0]).ravel(), flat[:k] + flat[k + 1 :], robot.n_joints))
    return out


def _wide(term: Term, motion: Motion) -> Array:
    """Columns (T, n, p) of ``term``, zero on the joints that it does not act on."""
    columns = term.family().columns(motion, term)
    if columns.ndim == 3:
        return columns
    out = np.zeros((len(columns), motion.robot.n_joints, columns.shape[1]))
    out[:, term.index] = columns
    return out
