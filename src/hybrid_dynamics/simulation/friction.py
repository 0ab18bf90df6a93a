"""Dry friction with true sticking, for many rollouts at once.

Over one sub-step h the velocity is v' = w - h M^-1 (f - f0), where w is the velocity under the friction torque f0. Dry
friction is the f inside [-backward, forward] with f = forward where v' > 0, f = -backward where v' < 0 and v' = 0
otherwise: a box-constrained problem with the positive definite matrix M^-1. It is solved by projected Newton steps: the
joints that stick, or contradict their friction, are brought to rest together (one small linear system per run), their
torques clipped to the box, and so on until nothing contradicts. A joint that keeps moving sits at its bound, so its
torque is exact in any case.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from hybrid_dynamics.types import Array

_ROUNDS, _STEPS = 8, 5
_TOLERANCE = 1e-12


class DrySolver:
    """Box-constrained friction, vectorised over rollouts; holds M^-1 of the last configurations."""

    def __init__(self, model: pin.Model, index: NDArray[np.int64]) -> None:
        self._model, self._data, self._index = model, model.createData(), index
        self._minverse: Array | None = None

    def forget(self) -> None:
        """Have M^-1 computed anew at the next solution (call once per control step)."""
        self._minverse = None

    def solve(self, configuration: Array, w: Array, f: Array, backward: Array, forward: Array, h: float) -> None:
        """Correct ``w`` and ``f`` (R, n) in place; ``configuration`` (nq, R) is where M^-1 is taken."""
        if self._minverse is None:
            grid = np.ix_(self._index, self._index)
            self._minverse = np.stack(
                [pin.computeMinverse(self._model, self._data, column)[grid] for column in configuration.T]
            )
        matrix = h * self._minverse
        for round_ in range(_ROUNDS):
            for _ in range(_STEPS):
                if not _violated(w, f, backward, forward).any():
                    return
                _newton(matrix, w, f, backward, forward)
            # Rarely, Newton steps cycle; sweeps always converge, if slowly: the more, the longer it takes.
            for _ in range(2**round_):
                _settle(matrix, w, f, backward, forward)


def _newton(matrix: Array, w: Array, f: Array, backward: Array, forward: Array) -> None:
    """Bring all joints that stick or contradict to rest together, and clip their torques to the box (in place)."""
    free = _violated(w, f, backward, forward) | ((f > -backward) & (f < forward))
    both = free[:, :, None] & free[:, None, :]
    system = np.where(both, matrix, np.eye(w.shape[1]))
    step = np.linalg.solve(system, np.where(free, w, 0.0)[:, :, None])[:, :, 0]
    new = np.maximum(np.minimum(f + step, forward), -backward)
    w -= np.einsum("rij,rj->ri", matrix, new - f)
    f[:] = new


def _settle(matrix: Array, w: Array, f: Array, backward: Array, forward: Array) -> None:
    """One sweep of projected Gauss-Seidel, joint by joint (in place)."""
    for j in range(w.shape[1]):
        target = np.maximum(np.minimum(f[:, j] + w[:, j] / matrix[:, j, j], forward[:, j]), -backward[:, j])
        w -= matrix[:, :, j] * (target - f[:, j])[:, None]
        f[:, j] = target


def _violated(w: Array, f: Array, backward: Array, forward: Array) -> NDArray[np.bool_]:
    """Where the velocity and the friction torque contradict each other."""
    return ((w > _TOLERANCE) & (f < forward)) | ((w < -_TOLERANCE) & (f > -backward))
