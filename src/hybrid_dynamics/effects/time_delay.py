"""The torque is recorded late (positive) or early against the position, on the whole robot.

tau_recorded(t) = tau(t - d), also for a fraction of a sample. The column is minus the time derivative of the model's
torque, the exact first order in d; the loop iterates with the shifted torque itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from hybrid_dynamics.effects.base import Family, Term, register
from hybrid_dynamics.effects.state import Equivalence, Motion, Parameter
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array


@register
class TimeDelay(Family):
    name = "time_delay"
    scope = "robot"
    equation = r"\tau_\text{recorded}(t) = \tau_\text{model}(t - d)"
    parameters = (Parameter("delay", "s"),)
    searched = False
    nonlinear = True
    uses_torque = True
    changes_reading = True
    drawn_against = "time"
    shown_by = "all joints accelerate hard and also move at constant speeds"
    equivalent_to = (
        Equivalence(
            ("viscous_friction",),
            "a late torque of inertia follows the jerk, and in a motion of one frequency that is the speed",
            "move each joint at several frequencies, and at constant speeds",
        ),
        Equivalence(
            ("armature",),
            "a late torque of viscous friction follows the acceleration",
            "accelerate hard at low speed",
        ),
    )

    def in_descriptions(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> dict[str, float]:
        return {"delay": 1.0}

    def columns(self, motion: Motion, term: Term) -> Array:
        slope = make_interp_spline(motion.time, motion.torque, k=3, axis=0).derivative()(motion.time)
        return -np.asarray(slope)[:, :, None]

    def prior_scale(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        return np.full(1, 0.05)

    def draw(self, robot: Robot, term: Term, rng: np.random.Generator) -> Array:
        return np.array([rng.choice([-1.0, 1.0])])
