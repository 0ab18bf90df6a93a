"""Viscous friction that is not proportional to speed: tau = F2 dq |dq| + F3 dq^3.

A lubricant that thins as it is sheared has F2 < 0; a fan or a churned oil bath F2 > 0. The coefficients may have either
sign as long as the joint's viscous terms together oppose the motion at all speeds seen:
Fv + F2 v + F3 v^2 >= 0 for 0 <= v <= the fastest speed in the training runs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Effect, Family, Motion, Parameter, Slot, register

Array = NDArray[np.float64]


@register
class NonlinearViscousFriction(Family):
    name = "nonlinear_viscous_friction"
    scope = "joint"
    size = 2
    parameters = (
        Parameter("quadratic_coefficient", "N m s^2/rad^2"),
        Parameter("cubic_coefficient", "N m s^3/rad^3"),
    )
    viscous_powers = (2, 3)
    shown_by = "the joint moves at many different speeds, up to its fastest"

    def columns(self, motion: Motion, slot: Slot) -> Array:
        dq = motion.dq[:, slot.index]
        return np.column_stack([dq * np.abs(dq), dq**3])

    def torque(self, effect: Effect, q: Array, dq: Array, load: Array | None = None) -> Array:
        values = effect.parameters
        return values["quadratic_coefficient"] * dq * np.abs(dq) + values["cubic_coefficient"] * dq**3
