"""Constant torque of one joint: tau = b (a sensor's zero, a cable, unequal friction)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hybrid_dynamics.effects.base import Family, register
from hybrid_dynamics.effects.state import Equivalence, Parameter, State


@register
class TorqueOffset(Family):
    name = "torque_offset"
    scope = "joint"
    everywhere = True
    like_weight = True
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
