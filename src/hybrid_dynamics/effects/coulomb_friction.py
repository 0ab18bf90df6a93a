"""Coulomb friction of one joint: tau = Fc sign(dq), Fc >= 0.

How the sign turns over at a reversal is a setting, see :mod:`hybrid_dynamics.effects.sign`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Effect, Family, Motion, Parameter, Slot, register
from hybrid_dynamics.effects.sign import run_sign, state_sign, width_settings
from hybrid_dynamics.robots import Robot

Array = NDArray[np.float64]


@register
class CoulombFriction(Family):
    name = "coulomb_friction"
    scope = "joint"
    parameters = (Parameter("coulomb_torque", "N m"),)
    turns_sign = True
    shown_by = "the joint reverses often and moves at several different speeds"

    def slots(self, robot: Robot, moving: NDArray[np.bool_], options: Mapping[str, Any]) -> list[Slot]:
        return [
            Slot(self.name, j, settings)
            for j in range(robot.n_joints)
            if moving[j]
            for settings in width_settings(options["sign_widths"])
        ]

    def columns(self, motion: Motion, slot: Slot) -> Array:
        j = slot.index
        return run_sign(motion.q[:, j], motion.dq[:, j], dict(slot.settings))[:, None]

    def lower_bounds(self) -> Array:
        return np.zeros(1)

    def torque(self, effect: Effect, q: Array, dq: Array, load: Array | None = None) -> Array:
        return effect.parameters["coulomb_torque"] * state_sign(dq, effect.settings)

    def torque_along(self, effect: Effect, q: Array, dq: Array, load: Array | None = None) -> Array:
        return effect.parameters["coulomb_torque"] * run_sign(q, dq, effect.settings)
