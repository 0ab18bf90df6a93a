"""Dry friction with true sticking, for many rollouts at once.

Over one sub-step h the velocity is v' = w - h M^-1 (f - f0), where w is the velocity under the friction torque f0. Dry
friction is the f inside [-backward, forward] with f = forward where v' > 0, f = -backward where v' < 0 and v' = 0
otherwise: a box-constrained problem with the positive definite matrix M^-1, solved by projected Gauss-Seidel. A joint
that keeps moving sits at its bound, so its torque is exact whatever the number of sweeps.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]


class DrySolver:
    """Projected Gauss-Seidel over the joints, vectorised over rollouts; holds M^-1 of the last configurations."""

    def __init__(self, model: pin.Model, index: NDArray[np.int64], sweeps: int = 3) -> None:
        self._model, self._data, self._index, self._sweeps = model, model.createData(), index, sweeps
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
        inverse = h * self._minverse
        for _ in range(self._sweeps):
            wrong = np.flatnonzero(_violated(w, f, backward, forward).any(axis=0))
            if not len(wrong):
                return
            for j in wrong:
                target = f[:, j] + w[:, j] / inverse[:, j, j]
                target = np.maximum(np.minimum(target, forward[:, j]), -backward[:, j])
                w -= inverse[:, :, j] * (target - f[:, j])[:, None]
                f[:, j] = target


def _violated(w: Array, f: Array, backward: Array, forward: Array, tolerance: float = 1e-9) -> NDArray[np.bool_]:
    """Where the velocity and the friction torque contradict each other."""
    return ((w > tolerance) & (f < forward)) | ((w < -tolerance) & (f > -backward))
