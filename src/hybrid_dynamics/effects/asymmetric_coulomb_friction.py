"""Coulomb friction that differs with the direction: tau = Fc+ for dq > 0, -Fc- for dq < 0, both >= 0.

On a moving joint the same as Coulomb friction (Fc+ + Fc-)/2 and an offset (Fc+ - Fc-)/2. At rest it is no torque, or
with setting ``at_rest`` ``middle`` that offset: dry friction holds a resting joint at any torque from -Fc- to Fc+, and
where the runs do not show which, the middle is nearest to all of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid_dynamics.effects.base import Family, Term, register
from hybrid_dynamics.effects.sign import (
    AT_REST,
    MIDDLE,
    SIGN_DISPLACEMENT,
    WIDTH,
    displacement_of,
    sign_of,
    width_settings,
)
from hybrid_dynamics.effects.state import Equivalence, Parameter, Settings, State
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: Friction that is less one way than this share of what it is the other way is plain friction beside an offset.
ONE_WAY = 0.1


@register
class AsymmetricCoulombFriction(Family):
    name = "asymmetric_coulomb_friction"
    scope = "joint"
    is_friction = True
    of_like_size = True
    known_settings = (WIDTH, SIGN_DISPLACEMENT, AT_REST)
    equation = r"\tau = F_c^{+}\ (\dot q > 0),\quad \tau = -F_c^{-}\ (\dot q < 0),\quad F_c^{\pm} \ge 0"
    parameters = (Parameter("coulomb_torque_positive", "N m"), Parameter("coulomb_torque_negative", "N m"))
    size = 2
    searched = False
    turns_sign = True
    contains = ("coulomb_friction",)
    drawn_against = "dq"
    shown_by = "the joint reverses often, moves in both directions at several speeds and rests under no load"
    equivalent_to = (
        Equivalence(
            ("coulomb_friction", "torque_offset"),
            "on a moving joint Coulomb friction and an offset make the same torque",
            "let the joint rest: an offset acts then too",
        ),
    )

    def grid(self, options: Mapping[str, Any]) -> list[Settings]:
        return width_settings(options["sign_widths"])

    def in_descriptions(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> dict[str, float]:
        up, down = parameters["coulomb_torque_positive"], parameters["coulomb_torque_negative"]
        # Also at rest: dry friction about an offset takes any value from -down to up.
        return {"dry_friction": 0.5 * (up + down), "offset": 0.5 * (up - down)}

    def law(self, xp: Any, at: State, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        sign = sign_of(xp, at.own_dq, settings, at.z)
        up, down = parameters["coulomb_torque_positive"], parameters["coulomb_torque_negative"]
        moving = 1.0 if settings.get(AT_REST) == MIDDLE else xp.abs(sign)
        return 0.5 * (up + down) * sign + 0.5 * (up - down) * moving

    def presliding(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> float | None:
        return displacement_of(settings)

    def lower_bounds(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        return np.zeros(2)

    def is_none(self, x: Array, term: Term, dry_friction: float) -> bool:
        """All dry friction of the joint together next to nothing one way (:data:`ONE_WAY`): no drive is rough one way
        only, but friction beside an offset looks so."""
        apart = 0.5 * abs(float(x[0] - x[1]))
        return bool(dry_friction * (1.0 - ONE_WAY) <= apart * (1.0 + ONE_WAY))

    def draw(self, robot: Robot, term: Term, rng: np.random.Generator) -> Array:
        ratio = float(rng.uniform(0.2, 0.7))
        return np.array([1.0, ratio] if rng.random() < 0.5 else [ratio, 1.0])
