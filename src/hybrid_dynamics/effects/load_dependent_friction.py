"""Friction that grows with what the joint carries: tau = mu |tau_load| sign(dq), mu >= 0.

``tau_load`` is the rigid-body torque of the joint as the model has it, payload and all; never the measured torque,
which would explain itself. The setting ``sign_width`` is that of Coulomb friction.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Effect, Family, Motion, Parameter, Slot, register
from hybrid_dynamics.effects.coulomb_friction import sign_settings, smooth_sign
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot

Array = NDArray[np.float64]


@register
class LoadDependentFriction(Family):
    name = "load_dependent_friction"
    scope = "joint"
    parameters = (Parameter("load_coefficient", "1"),)
    uses_load = True
    shown_by = "the joint reverses often under very different loads"

    def slots(self, robot: Robot, moving: NDArray[np.bool_], options: Mapping[str, Any]) -> list[Slot]:
        return [
            Slot(self.name, j, settings)
            for j in range(robot.n_joints)
            if moving[j]
            for settings in sign_settings(options["sign_widths"])
        ]

    def columns(self, motion: Motion, slot: Slot) -> Array:
        width = float(dict(slot.settings).get("sign_width", 0.0))
        return np.abs(motion.load[:, [slot.index]]) * smooth_sign(motion.dq[:, [slot.index]], width)

    def lower_bounds(self) -> Array:
        return np.zeros(1)

    def torque(self, effect: Effect, q: Array, dq: Array, load: Array | None = None) -> Array:
        if load is None:
            raise InputError("load_dependent_friction needs the rigid-body torque; give it as load")
        width = float(effect.settings.get("sign_width", 0.0))
        return effect.parameters["load_coefficient"] * np.abs(load) * smooth_sign(dq, width)
