"""Viscous friction that is not proportional to speed: tau = F2 dq |dq| + F3 dq^3.

A lubricant that thins as it is sheared has F2 < 0; a fan or a churned oil bath F2 > 0. The coefficients may have either
sign as long as the joint's viscous terms together oppose the motion at all speeds seen, Fv + F2 v + F3 v^2 >= 0, and
all its friction does up to the speed the URDF allows the joint, at most four times the fastest of the training runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid_dynamics.effects.base import Family, Term, register
from hybrid_dynamics.effects.state import Equivalence, Parameter, State
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array


@register
class NonlinearViscousFriction(Family):
    name = "nonlinear_viscous_friction"
    scope = "joint"
    is_friction = True
    equation = (
        r"\tau = F_2\,\dot q\,|\dot q| + F_3\,\dot q^3,"
        r"\quad F_v + F_2 v + F_3 v^2 \ge 0 \text{ at all speeds } v \text{ seen}"
    )
    size = 2
    parameters = (
        Parameter("quadratic_coefficient", "N m s^2/rad^2"),
        Parameter("cubic_coefficient", "N m s^3/rad^3"),
    )
    viscous_powers = (2, 3)
    drawn_against = "dq"
    shown_by = "the joint moves at many different speeds, up to its fastest"
    equivalent_to = (
        Equivalence(
            ("stribeck_friction", "viscous_friction"),
            "over a narrow range of speeds both bend the friction curve",
            "move the joint slowly, between 0.02 and 0.2 rad/s, and at its fastest",
        ),
    )

    def law(self, xp: Any, at: State, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        dq = at.own_dq
        return parameters["quadratic_coefficient"] * dq * xp.abs(dq) + parameters["cubic_coefficient"] * dq * dq * dq

    def draw(self, robot: Robot, term: Term, rng: np.random.Generator) -> Array:
        return np.ones(2)  # friction that grows: dissipative whatever the joint's viscous term is
