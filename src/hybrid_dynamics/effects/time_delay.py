"""The torque is recorded late (positive) or early against the position, on the whole robot.

tau_recorded(t) = tau(t - d), also for a fraction of a sample; or, with the setting ``response: lag``, as late as a
drive's first-order low-pass of time constant d makes it, which takes the fast parts of the torque away as well. The
column is minus the time derivative of the model's torque as it is recorded, the exact first order in d; the loop
iterates with the late torque itself. Both columns are the same at d = 0: which of the two it is, only the laws tell.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from hybrid_dynamics.effects.acting import LAG, RESPONSE, lagged
from hybrid_dynamics.effects.base import Family, Term, register
from hybrid_dynamics.effects.state import Equivalence, Motion, Parameter
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array


@register
class TimeDelay(Family):
    name = "time_delay"
    scope = "robot"
    between_runs = ("the torque was recorded later or earlier", ("delay",))
    known_settings = (RESPONSE,)
    equation = (
        r"\tau_\text{recorded}(t) = \tau_\text{model}(t - d)\quad\text{or}\quad "
        r"d\,\dot\tau_\text{recorded} + \tau_\text{recorded} = \tau_\text{model}"
    )
    parameters = (Parameter("delay", "s"),)
    searched = False
    nonlinear = True
    uses_torque = True
    changes_reading = True
    drawn_against = "time"
    shown_by = "all joints accelerate hard and also move at constant speeds"
    equivalent_to = (
        Equivalence(
            ("time_delay",),
            "a drive's first-order lag makes a slow torque as late as a delay of its time constant",
            "move faster: a lag also takes away from torque that changes within its time constant",
        ),
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

    def forms(self, term: Term) -> list[Term]:
        return [Term(self.name, None), Term(self.name, None, ((RESPONSE, LAG),))]

    def columns(self, motion: Motion, term: Term) -> Array:
        torque = motion.torque
        if term.options.get(RESPONSE) == LAG:
            torque = lagged(torque, motion.time, motion.given_lag)
        slope = make_interp_spline(motion.time, torque, k=3, axis=0).derivative()(motion.time)
        return -np.asarray(slope)[:, :, None]

    def lower_bounds(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        # A filter cannot be early.
        return np.array([0.0 if term is not None and term.options.get(RESPONSE) == LAG else -np.inf])

    def prior_scale(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        return np.full(1, 0.05)

    def draw(self, robot: Robot, term: Term, rng: np.random.Generator) -> Array:
        return np.array([rng.choice([-1.0, 1.0])])
