"""Friction with presliding hysteresis (Dahl 1968): tau = K z, dz/dt = dq - abs(dq) z K/Fc.

Written with z scaled to Fc: tau = Fc z, dz/dq = (1 - z sign(dq)) / s with the presliding displacement s = Fc/K, which
is what is refined; given s the torque is linear in Fc. The published stiffness is K = Fc/s.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid_dynamics.effects.base import Family, Term, register
from hybrid_dynamics.effects.state import Equivalence, Parameter, Refined, Settings, State
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

DISPLACEMENT = "presliding_displacement"
#: Displacements [rad] the search starts from; what is shorter is how Coulomb friction turns over (effects/sign.py).
_GRID = (4e-3, 2e-2, 1e-1)


@register
class HysteresisFriction(Family):
    name = "hysteresis_friction"
    scope = "joint"
    is_friction = True
    equation = r"\tau = K z,\quad \dot z = \dot q - |\dot q|\,z\,K / F_c"
    parameters = (Parameter("presliding_stiffness", "N m/rad"), Parameter("coulomb_torque", "N m"))
    size = 1
    searched = False
    says_where = ("presliding_stiffness",)
    nonlinear_settings = (Refined(DISPLACEMENT, 1e-3, 0.5),)
    contains = ("coulomb_friction",)
    drawn_against = "q"
    shown_by = "the joint reverses within a few hundredths of a radian, again and again"
    equivalent_to = (
        Equivalence(
            ("coulomb_friction",),
            "once the joint has moved further than the presliding displacement both are the same",
            "let the joint reverse within a few hundredths of a radian",
        ),
        Equivalence(
            ("joint_spring",),
            "within the presliding displacement friction is a spring",
            "move the joint further than a tenth of a radian",
        ),
    )

    def grid(self, options: Mapping[str, Any]) -> list[Settings]:
        return [((DISPLACEMENT, s),) for s in _GRID]

    def in_descriptions(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> dict[str, float]:
        return {"dry_friction": parameters["coulomb_torque"], "gradual_reversal": 1.0}

    def law(self, xp: Any, at: State, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        return parameters["coulomb_torque"] * (xp.sign(at.own_dq) if at.z is None else at.z)

    def presliding(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> float | None:
        if parameters["coulomb_torque"] <= 0 or parameters["presliding_stiffness"] <= 0:
            return None
        return parameters["coulomb_torque"] / parameters["presliding_stiffness"]

    def lower_bounds(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        return np.zeros(1)

    def setting_values(self, parameters: Mapping[str, float]) -> dict[str, float]:
        stiffness = max(parameters["presliding_stiffness"], 1e-12)
        return {DISPLACEMENT: max(parameters["coulomb_torque"] / stiffness, 1e-9)}

    def parameters_of(self, x: Array, robot: Robot, term: Term) -> dict[str, float]:
        return {"presliding_stiffness": float(x[0]) / term.options[DISPLACEMENT], "coulomb_torque": float(x[0])}

    def coordinates_of(self, parameters: Mapping[str, float], robot: Robot, term: Term) -> Array:
        return np.array([parameters["coulomb_torque"]])
