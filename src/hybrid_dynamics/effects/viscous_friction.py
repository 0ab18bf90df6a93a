"""Viscous friction of one joint: tau = Fv dq, Fv >= 0."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Effect, Family, Motion, Parameter, Slot, register

Array = NDArray[np.float64]


@register
class ViscousFriction(Family):
    name = "viscous_friction"
    scope = "joint"
    parameters = (Parameter("viscous_coefficient", "N m s/rad"),)
    viscous_powers = (1,)
    shown_by = "the joint moves at several different speeds in both directions"

    def columns(self, motion: Motion, slot: Slot) -> Array:
        return motion.dq[:, [slot.index]]

    def lower_bounds(self) -> Array:
        return np.zeros(1)

    def torque(self, effect: Effect, q: Array, dq: Array, load: Array | None = None) -> Array:
        return effect.parameters["viscous_coefficient"] * dq
