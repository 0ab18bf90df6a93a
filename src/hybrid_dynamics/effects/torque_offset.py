"""Constant torque of one joint: tau = b (a sensor's zero, a cable, unequal friction)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid_dynamics.effects.base import HELD, Family, Term, register
from hybrid_dynamics.effects.state import Equivalence, Parameter, State
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array


@register
class TorqueOffset(Family):
    name = "torque_offset"
    scope = "joint"
    everywhere = True
    like_weight = True
    known_settings = (HELD,)
    equation = r"\tau = b"
    parameters = (Parameter("offset", "N m"),)
    drawn_against = "time"
    shown_by = "the joint rests and moves in many positions and in both directions"
    equivalent_to = (
        Equivalence(
            ("position_offset",),
            "near one posture a wrong zero changes the gravity torque by a constant",
            "move the joint over a wide range of positions",
        ),
        Equivalence(
            ("joint_spring",),
            "far from its rest position a soft spring is a constant torque over a short travel",
            "move the joint over a wide range of positions",
        ),
    )

    def in_descriptions(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> dict[str, float]:
        return {"offset": parameters["offset"]}

    def law(self, xp: Any, at: State, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        return parameters["offset"]

    def prior_scale(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        held = None if term is None else term.options.get(HELD)
        return super().prior_scale(robot, term) if held is None else np.array([float(held)])
