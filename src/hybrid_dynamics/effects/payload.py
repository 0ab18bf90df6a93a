"""A rigid body on the last moving link. Same columns as that link's inertial parameters, so it takes their name."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Effect, Family, Motion, Slot, register
from hybrid_dynamics.effects.inertia import BODY_PARAMETERS, BODY_SCALE, to_body, to_dynamic
from hybrid_dynamics.robots import Robot

Array = NDArray[np.float64]


@register
class Payload(Family):
    name = "payload"
    scope = "robot"
    parameters = BODY_PARAMETERS
    size = 10
    changes_body = True
    shown_by = "the wrist turns through many orientations at rest and then accelerates in each of them"

    def columns(self, motion: Motion, slot: Slot) -> Array:
        return motion.regressor[:, :, -10:]

    def prior_scale(self) -> Array:
        return BODY_SCALE

    def inertial_offset(self, robot: Robot, slot: Slot) -> Array:
        return np.zeros(10)

    def parameters_of(self, x: Array, robot: Robot, slot: Slot) -> dict[str, float]:
        return to_body(x)

    def coordinates_of(self, parameters: Mapping[str, float], robot: Robot, slot: Slot) -> Array:
        return to_dynamic(parameters)

    def change(self, robot: Robot, effect: Effect) -> None:
        joint = robot.joint_ids[-1]
        total = robot.model.inertias[joint].toDynamicParameters() + to_dynamic(effect.parameters)
        robot.model.inertias[joint] = pin.Inertia.FromDynamicParameters(total)
