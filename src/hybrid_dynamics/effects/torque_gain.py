"""The torque is recorded too large or too small: recorded = k times what the rest of the model says.

tau = (k - 1) (torque of the final model without the gain), so that the order of naming does not matter. On one joint,
or one gain for all joints together (no joint is named; it counts once).
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Family, Term, register
from hybrid_dynamics.effects.state import Equivalence, Motion, Parameter
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array


@register
class TorqueGain(Family):
    name = "torque_gain"
    scope = "joint"
    between_runs = ("the torque was read by another factor", ("gain",))
    equation = r"\tau = (k - 1)\,\tau_\text{model without the gain},\quad k > 0"
    shared = True
    parameters = (Parameter("gain", "1"),)
    searched = False
    nonlinear = True
    uses_torque = True
    changes_reading = True
    believable = MappingProxyType(
        {"gain": (0.51, 2.0, "its torque may be in another unit than the model expects, or than the other joints'")}
    )
    drawn_against = "load"
    shown_by = "the joint carries very different loads at rest, in both directions, and the joints before it too"
    equivalent_to = (
        Equivalence(
            ("link_inertia",),
            "heavier links make every torque of their joint larger, as a gain does",
            "compare the joints before it: a heavier link loads them too, a gain does not",
        ),
        Equivalence(
            ("payload",),
            "a payload makes the gravity torques of all joints larger",
            "accelerate the wrist: a payload resists by its own inertia, not in proportion to the torque",
        ),
        Equivalence(
            ("inertial_parameters",),
            "links that are all heavier by one factor, with friction larger by it, make the same torque on all joints",
            "weigh a link, or record a payload of known mass: a gain makes it too heavy as well",
            always=True,
        ),
    )

    def terms(self, robot: Robot, moving: NDArray[np.bool_], options: Mapping[str, Any]) -> list[Term]:
        several = [Term(self.name, None)] if int(moving.sum()) > 1 else []
        return [*several, *(Term(self.name, j) for j in range(robot.n_joints) if moving[j])]

    def twin(self, term: Term, robot: Robot) -> Term | None:
        # Friction that is larger by the same factor does the rest.
        return Term("inertial_parameters", None) if term.joint is None else None

    def in_descriptions(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> dict[str, float]:
        return {"gain": 1.0}

    def columns(self, motion: Motion, term: Term) -> Array:
        if term.joint is None:
            return motion.torque[:, :, None]
        return motion.torque[:, [term.joint]]

    def lower_bounds(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        # Below one half it is no gain of a sensor but a wrong unit or gear, which a check of the log tells.
        return np.array([-0.5])

    def prior_scale(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        return np.ones(1)

    def parameters_of(self, x: Array, robot: Robot, term: Term) -> dict[str, float]:
        return {"gain": 1.0 + float(x[0])}

    def coordinates_of(self, parameters: Mapping[str, float], robot: Robot, term: Term) -> Array:
        return np.array([parameters["gain"] - 1.0])

    def summed(self, x: Array) -> Array:
        # What is read k times too large by one is read so again by the next.
        return np.asarray(np.prod(1.0 + x, axis=0) - 1.0)

    def draw(self, robot: Robot, term: Term, rng: np.random.Generator) -> Array:
        return np.ones(1)
