"""Viscous friction of one joint: tau = Fv dq, Fv >= 0."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid_dynamics.effects.base import Family, Term, register
from hybrid_dynamics.effects.state import Equivalence, Parameter, State
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array


@register
class ViscousFriction(Family):
    name = "viscous_friction"
    scope = "joint"
    is_friction = True
    everywhere = True
    equation = r"\tau = F_v\,\dot q,\quad F_v \ge 0"
    parameters = (Parameter("viscous_coefficient", "N m s/rad"),)
    viscous_powers = (1,)
    drawn_against = "dq"
    shown_by = "the joint moves at several different speeds in both directions"
    equivalent_to = (
        Equivalence(
            ("time_delay",),
            "torque read late against a motion with inertia looks like a torque that follows the speed",
            "let the joint move at constant speeds: a delay then changes nothing",
        ),
    )

    def law(self, xp: Any, at: State, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        return parameters["viscous_coefficient"] * at.own_dq

    def lower_bounds(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        return np.zeros(1)
