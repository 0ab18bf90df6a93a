"""Friction that grows with what the joint carries: tau = mu |tau_load| sign(dq), mu >= 0.

``tau_load`` is the rigid-body torque of the joint as the model has it, payload and all; never the measured torque,
which would explain itself. How the sign turns over is a setting, as for Coulomb friction.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid_dynamics.effects.base import Family, Term, register
from hybrid_dynamics.effects.sign import SIGN_DISPLACEMENT, WIDTH, displacement_of, sign_of, width_settings
from hybrid_dynamics.effects.state import Equivalence, Parameter, Settings, State
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: A joint whose friction is this share of what it carries holds that without a motor: lead screws do, and the gears of
#: arms, which lose 5 to 40 %, do not. What asks for so much is something else.
HOLDS = 1.0


@register
class LoadDependentFriction(Family):
    name = "load_dependent_friction"
    scope = "joint"
    is_friction = True
    known_settings = (WIDTH, SIGN_DISPLACEMENT)
    equation = r"\tau = \mu\,|\tau_\text{load}|\operatorname{sign}(\dot q),\quad \mu \ge 0"
    parameters = (Parameter("load_coefficient", "1"),)
    uses_load = True
    turns_sign = True
    drawn_against = "load"
    shown_by = "the joint reverses often under very different loads"
    equivalent_to = (
        Equivalence(
            ("coulomb_friction",),
            "under a load that hardly changes the friction is constant",
            "reverse the joint in postures of very different load",
        ),
    )

    def grid(self, options: Mapping[str, Any]) -> list[Settings]:
        return width_settings(options["sign_widths"])

    def law(self, xp: Any, at: State, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        return parameters["load_coefficient"] * xp.abs(at.own_load) * sign_of(xp, at.own_dq, settings, at.z)

    def presliding(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> float | None:
        return displacement_of(settings)

    def lower_bounds(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        return np.zeros(1)

    def is_none(self, x: Array, term: Term, dry_friction: float) -> bool:
        """As much as the joint carries (:data:`HOLDS`)."""
        return bool(x[0] >= HOLDS)
