"""Stribeck friction: tau = (Fc + (Fs - Fc) exp(-(dq/vs)^2)) sign(dq), Fs >= Fc >= 0.

Coordinates (Fc, Fs - Fc); the Stribeck velocity vs is refined. A vs inside the stick band cannot be told from Coulomb
friction: rows slower than the band have no say. Where all dry friction of a joint falls to less than a tenth it is
something else, of slow motion alone: where the joint moves faster it would be without friction.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid_dynamics.effects.base import Family, Term, register
from hybrid_dynamics.effects.sign import SIGN_DISPLACEMENT, WIDTH, displacement_of, sign_of
from hybrid_dynamics.effects.state import Equivalence, Parameter, Refined, Settings, State
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

VELOCITY = "stribeck_velocity"
#: Velocities [rad/s] the search starts from.
_GRID = (0.03, 0.1, 0.3)
#: A rise of friction below this velocity [rad/s] only slow motion shows: the slowest that is asked for (``shown_by``).
_HIDES = 0.02
#: Friction at rest of more than so many times that in motion no drive has: in tables of dry and of lubricated contacts
#: it is at most a few times as large.
MOST_FALL = 10.0


@register
class StribeckFriction(Family):
    name = "stribeck_friction"
    scope = "joint"
    is_friction = True
    known_settings = (WIDTH, SIGN_DISPLACEMENT)
    equation = (
        r"\tau = \left(F_c + (F_s - F_c)\,e^{-(\dot q / v_s)^2}\right)\operatorname{sign}(\dot q),"
        r"\quad F_s \ge F_c \ge 0"
    )
    parameters = (Parameter("coulomb_torque", "N m"), Parameter("static_torque", "N m"), Parameter(VELOCITY, "rad/s"))
    size = 2
    searched = False
    nonlinear_settings = (Refined(VELOCITY, 0.01, 1.0),)
    turns_sign = True
    contains = ("coulomb_friction",)
    rest_hides_at = ((VELOCITY, _HIDES),)
    drawn_against = "dq"
    shown_by = "the joint moves slowly, between 0.02 and 0.2 rad/s, as well as fast"
    equivalent_to = (
        Equivalence(
            ("coulomb_friction",),
            "above a few times the Stribeck velocity both are the same",
            "move the joint slowly, between 0.02 and 0.2 rad/s",
        ),
        Equivalence(
            ("coulomb_friction", "nonlinear_viscous_friction"),
            "over a narrow range of speeds both bend the friction curve",
            "move the joint slowly, between 0.02 and 0.2 rad/s, and at its fastest",
        ),
    )

    def grid(self, options: Mapping[str, Any]) -> list[Settings]:
        return [((VELOCITY, v),) for v in _GRID]

    def in_descriptions(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> dict[str, float]:
        least = parameters["coulomb_torque"]
        return {"dry_friction": least, "stribeck_rise": parameters["static_torque"] - least}

    def law(self, xp: Any, at: State, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        dq = at.own_dq
        ratio = dq / parameters[VELOCITY]
        extra = parameters["static_torque"] - parameters["coulomb_torque"]
        return (parameters["coulomb_torque"] + extra * xp.exp(-ratio * ratio)) * sign_of(xp, dq, settings, at.z)

    def presliding(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> float | None:
        return displacement_of(settings)

    def lower_bounds(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        return np.zeros(2)

    def is_none(self, x: Array, term: Term, dry_friction: float) -> bool:
        """All dry friction of the joint together next to nothing in faster motion: seen in slow motion alone, anything
        that falls makes it, and where the joint moves faster it would have none."""
        return bool(MOST_FALL * dry_friction < dry_friction + x[1])

    def parameters_of(self, x: Array, robot: Robot, term: Term) -> dict[str, float]:
        return {
            "coulomb_torque": float(x[0]),
            "static_torque": float(x[0] + x[1]),
            VELOCITY: float(term.options[VELOCITY]),
        }

    def coordinates_of(self, parameters: Mapping[str, float], robot: Robot, term: Term) -> Array:
        return np.array([parameters["coulomb_torque"], parameters["static_torque"] - parameters["coulomb_torque"]])
