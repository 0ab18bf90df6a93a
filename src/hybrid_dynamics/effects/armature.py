"""Rotor inertia of one drive, seen at the joint: tau = Ia ddq, Ia >= 0 (gyroscopic terms neglected)."""

from __future__ import annotations

import numpy as np

from hybrid_dynamics.effects.base import Effect, Family, Term, register
from hybrid_dynamics.effects.state import Equivalence, Motion, Parameter
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array


@register
class Armature(Family):
    name = "armature"
    scope = "joint"
    everywhere = True
    equation = r"\tau = I_a\,\ddot q,\quad I_a \ge 0"
    parameters = (Parameter("armature", "kg m^2"),)
    changes_body = True
    drawn_against = "ddq"
    shown_by = "the joint accelerates hard while the joints before it move as well"
    equivalent_to = (
        Equivalence(
            ("link_inertia",),
            "inertia about the joint's own axis, where nothing else moves the link",
            "on the first joint of a fixed base no motion tells; elsewhere move the joints before it as well",
        ),
    )

    def inseparable(self, term: Term, other: Term) -> str:
        if other.effect == "link_inertia" and other.joint == term.joint == 0:
            return "No motion of a robot on a fixed base can tell: only the rotation about the joint's own axis counts."
        return ""

    def columns(self, motion: Motion, term: Term) -> Array:
        return motion.ddq[:, [term.index]]

    def lower_bounds(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        return np.zeros(1)

    def change(self, robot: Robot, effect: Effect) -> None:
        joint = robot.joint_ids[effect.joint_index(robot) or 0]
        rotor = robot.model.armature.copy()
        rotor[robot.model.idx_vs[joint]] += effect.parameters["armature"]
        robot.model.armature = rotor
