"""Friction that grows with what the joint carries: tau = mu |tau_load| sign(dq), mu >= 0.

``tau_load`` is the rigid-body torque of the joint as the model has it, payload and all; never the measured torque,
which would explain itself. How the sign turns over is a setting, as for Coulomb friction.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Effect, Family, Motion, Parameter, Slot, register
from hybrid_dynamics.effects.sign import run_sign, state_sign, width_settings
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot

Array = NDArray[np.float64]


@register
class LoadDependentFriction(Family):
    name = "load_dependent_friction"
    scope = "joint"
    parameters = (Parameter("load_coefficient", "1"),)
    uses_load = True
    turns_sign = True
    shown_by = "the joint reverses often under very different loads"

    def slots(self, robot: Robot, moving: NDArray[np.bool_], options: Mapping[str, Any]) -> list[Slot]:
        return [
            Slot(self.name, j, settings)
            for j in range(robot.n_joints)
            if moving[j]
            for settings in width_settings(options["sign_widths"])
        ]

    def columns(self, motion: Motion, slot: Slot) -> Array:
        j = slot.index
        sign = run_sign(motion.q[:, j], motion.dq[:, j], dict(slot.settings))
        return (np.abs(motion.load[:, j]) * sign)[:, None]

    def lower_bounds(self) -> Array:
        return np.zeros(1)

    def torque(self, effect: Effect, q: Array, dq: Array, load: Array | None = None) -> Array:
        return self._size(effect, load) * state_sign(dq, effect.settings)

    def torque_along(self, effect: Effect, q: Array, dq: Array, load: Array | None = None) -> Array:
        return self._size(effect, load) * run_sign(q, dq, effect.settings)

    def _size(self, effect: Effect, load: Array | None) -> Array:
        if load is None:
            raise InputError("load_dependent_friction needs the rigid-body torque; give it as load")
        return effect.parameters["load_coefficient"] * np.abs(load)
