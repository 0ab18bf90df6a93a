"""Coulomb friction of one joint: tau = Fc sign(dq), Fc >= 0.

How the sign turns over at a reversal is a setting, see :mod:`hybrid_dynamics.effects.sign`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid_dynamics.effects.base import Family, Term, register
from hybrid_dynamics.effects.sign import SIGN_DISPLACEMENT, SLOW, WIDTH, displacement_of, sign_of, width_settings
from hybrid_dynamics.effects.state import Equivalence, Parameter, Refined, Settings, State
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array


@register
class CoulombFriction(Family):
    name = "coulomb_friction"
    scope = "joint"
    is_friction = True
    known_settings = (WIDTH, SIGN_DISPLACEMENT)
    everywhere = True
    equation = r"\tau = F_c\,\operatorname{sign}(\dot q),\quad F_c \ge 0"
    parameters = (Parameter("coulomb_torque", "N m"),)
    turns_sign = True
    drawn_against = "dq"
    shown_by = "the joint reverses often and moves at several different speeds"
    equivalent_to = (
        Equivalence(
            ("hysteresis_friction",),
            "once the joint has moved further than the presliding displacement both are the same",
            "let the joint reverse within a few hundredths of a radian",
        ),
        Equivalence(
            ("stribeck_friction",),
            "above a few times the Stribeck velocity both are the same",
            "move the joint slowly, between 0.02 and 0.2 rad/s",
        ),
    )

    def grid(self, options: Mapping[str, Any]) -> list[Settings]:
        return width_settings(options["sign_widths"])

    def refined_at(self, term: Term) -> tuple[Refined, ...]:
        # A sharp sign has no say in the torque that the joint moves with; one that turns over slowly has: height and
        # width of the step are then known together.
        slow = float(term.options.get(WIDTH, 0.0)) > SLOW
        return (Refined(WIDTH, SLOW, np.inf),) if slow else ()

    def in_descriptions(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> dict[str, float]:
        return {"dry_friction": parameters["coulomb_torque"]}

    def law(self, xp: Any, at: State, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        return parameters["coulomb_torque"] * sign_of(xp, at.own_dq, settings, at.z)

    def presliding(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> float | None:
        return displacement_of(settings)

    def lower_bounds(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        return np.zeros(1)
