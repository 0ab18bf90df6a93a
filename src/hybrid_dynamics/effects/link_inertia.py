"""The inertial parameters of one link differ from the model's; the published ones are the new values of that link.

The last link is left out: there the same columns are called ``payload``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Effect, Family, Motion, Slot, register
from hybrid_dynamics.effects.inertia import BODY_PARAMETERS, BODY_SCALE, to_body, to_dynamic
from hybrid_dynamics.robots import Robot

Array = NDArray[np.float64]


@register
class LinkInertia(Family):
    name = "link_inertia"
    scope = "link"
    parameters = BODY_PARAMETERS
    size = 10
    changes_body = True
    shown_by = "the joint of that link and those before it accelerate together in many postures"

    def slots(self, robot: Robot, moving: NDArray[np.bool_], options: Mapping[str, Any]) -> list[Slot]:
        return [Slot(self.name, j) for j in range(robot.n_joints - 1) if moving[: j + 1].any()]

    def columns(self, motion: Motion, slot: Slot) -> Array:
        first = 10 * slot.index
        return motion.regressor[:, :, first : first + 10]

    def prior_scale(self) -> Array:
        return BODY_SCALE

    def inertial_offset(self, robot: Robot, slot: Slot) -> Array:
        return np.asarray(robot.model.inertias[robot.joint_ids[slot.index]].toDynamicParameters())

    def parameters_of(self, x: Array, robot: Robot, slot: Slot) -> dict[str, float]:
        return to_body(self.inertial_offset(robot, slot) + x)

    def coordinates_of(self, parameters: Mapping[str, float], robot: Robot, slot: Slot) -> Array:
        return to_dynamic(parameters) - self.inertial_offset(robot, slot)

    def change(self, robot: Robot, effect: Effect) -> None:
        joint = robot.joint_ids[effect.joint_index(robot) or 0]
        robot.model.inertias[joint] = pin.Inertia.FromDynamicParameters(to_dynamic(effect.parameters))
