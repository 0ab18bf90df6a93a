"""What effects may change in a rigid body, as numbers: inertias, rotors, gravity; and the axes of its joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array


@dataclass(frozen=True)
class BodyNumbers:
    """``inertias`` (n, 10) dynamic parameters in joint order (Pinocchio's ten), ``armature`` (n,) [kg m^2], ``gravity``
    (3,) [m/s^2]. Entries are numbers, or symbols in their place."""

    inertias: Any
    armature: Any
    gravity: Any

    @classmethod
    def of(cls, robot: Robot) -> BodyNumbers:
        """The numbers of ``robot``."""
        model = robot.model
        inertias = np.array([model.inertias[i].toDynamicParameters() for i in robot.joint_ids])
        armature = np.array([model.armature[model.idx_vs[i]] for i in robot.joint_ids])
        return cls(inertias, armature, np.asarray(model.gravity.linear).copy())

    def flat(self) -> Array:
        """All numbers in one array: inertias row by row, armature, gravity."""
        return np.concatenate([self.inertias.ravel(), self.armature, self.gravity])


def joint_axis(model: pin.Model, joint: int) -> Array:
    """(6,) the motion that a unit of joint speed makes in the joint's frame: linear, angular."""
    data = model.joints[joint].createData()
    model.joints[joint].calc(data, pin.neutral(model))
    return np.asarray(data.S, float).ravel()
