"""Constant torque of one joint: tau = b (a sensor's zero, a cable, unequal friction)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Effect, Family, Motion, Parameter, Slot, register

Array = NDArray[np.float64]


@register
class TorqueOffset(Family):
    name = "torque_offset"
    scope = "joint"
    parameters = (Parameter("offset", "N m"),)
    shown_by = "the joint rests and moves in many positions and in both directions"

    def columns(self, motion: Motion, slot: Slot) -> Array:
        return np.ones((len(motion.time), 1))

    def torque(self, effect: Effect, q: Array, dq: Array, load: Array | None = None) -> Array:
        return np.full_like(dq, effect.parameters["offset"])
