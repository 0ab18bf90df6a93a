"""The base is not level: R_base = Ry(pitch) Rx(roll), so gravity in the base frame is R_base^T g."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Effect, Family, Motion, Parameter, Slot, register
from hybrid_dynamics.robots import Robot

Array = NDArray[np.float64]


def base_rotation(roll: float, pitch: float) -> Array:
    """Ry(pitch) Rx(roll)."""
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    return np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]]) @ np.array(
        [[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]]
    )


@register
class GravityTilt(Family):
    name = "gravity_tilt"
    scope = "robot"
    parameters = (Parameter("roll", "rad"), Parameter("pitch", "rad"))
    size = 2
    nonlinear = True
    changes_body = True
    shown_by = "the first joint carries the stretched arm slowly all the way round"

    def columns(self, motion: Motion, slot: Slot) -> Array:
        step = 1e-4
        still = np.zeros_like(motion.q)
        out = np.empty((*motion.q.shape, 2))
        for k, angles in enumerate(((step, 0.0), (0.0, step))):
            plus, minus = motion.robot.copy(), motion.robot.copy()
            plus.model.gravity.linear = base_rotation(*angles).T @ motion.robot.model.gravity.linear
            minus.model.gravity.linear = base_rotation(*angles) @ motion.robot.model.gravity.linear
            difference = plus.inverse_dynamics(motion.q, still, still) - minus.inverse_dynamics(motion.q, still, still)
            out[:, :, k] = difference / (2 * step)
        return out

    def prior_scale(self) -> Array:
        return np.full(2, 0.5)

    def change(self, robot: Robot, effect: Effect) -> None:
        rotation = base_rotation(effect.parameters["roll"], effect.parameters["pitch"])
        robot.model.gravity.linear = rotation.T @ robot.model.gravity.linear
