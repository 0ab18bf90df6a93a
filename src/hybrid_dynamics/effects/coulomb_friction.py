"""Coulomb friction of one joint: tau = Fc sign(dq), Fc >= 0.

The setting ``sign_width`` w [rad/s] replaces sign(dq) by tanh(dq / w): measured joints slip gradually. Without it the
sign is sharp.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Effect, Family, Motion, Parameter, Slot, register
from hybrid_dynamics.robots import Robot

Array = NDArray[np.float64]


def smooth_sign(dq: Array, width: float) -> Array:
    """sign(dq), or tanh(dq / width) where ``width`` [rad/s] is positive."""
    return np.tanh(dq / width) if width > 0 else np.sign(dq)


def sign_settings(widths: tuple[float, ...]) -> list[tuple[tuple[str, Any], ...]]:
    """One settings tuple per width; the sharp sign carries no setting."""
    return [(("sign_width", float(w)),) if w > 0 else () for w in widths]


@register
class CoulombFriction(Family):
    name = "coulomb_friction"
    scope = "joint"
    parameters = (Parameter("coulomb_torque", "N m"),)
    shown_by = "the joint reverses often and moves at several different speeds"

    def slots(self, robot: Robot, moving: NDArray[np.bool_], options: Mapping[str, Any]) -> list[Slot]:
        return [
            Slot(self.name, j, settings)
            for j in range(robot.n_joints)
            if moving[j]
            for settings in sign_settings(options["sign_widths"])
        ]

    def columns(self, motion: Motion, slot: Slot) -> Array:
        width = float(dict(slot.settings).get("sign_width", 0.0))
        return smooth_sign(motion.dq[:, [slot.index]], width)

    def lower_bounds(self) -> Array:
        return np.zeros(1)

    def torque(self, effect: Effect, q: Array, dq: Array, load: Array | None = None) -> Array:
        return effect.parameters["coulomb_torque"] * smooth_sign(dq, float(effect.settings.get("sign_width", 0.0)))
