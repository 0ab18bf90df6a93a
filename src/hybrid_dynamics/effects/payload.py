"""A rigid body on the last moving link. Same columns as that link's inertial parameters, so it takes their name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from hybrid_dynamics.effects.base import Effect, Family, Term, register
from hybrid_dynamics.effects.inertia import BODY_PARAMETERS, BODY_SCALE, random_block, to_body, to_dynamic, torque_error
from hybrid_dynamics.effects.state import Equivalence, Motion
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array


@register
class Payload(Family):
    name = "payload"
    scope = "robot"
    equation = r"\tau = Y_n(q, \dot q, \ddot q)\,\pi,\quad \pi \text{ a body that can exist}"
    parameters = BODY_PARAMETERS
    size = 10
    is_body = True
    contains = ("link_mass", "link_com")
    changes_body = True
    by_regressor = True
    detachable = True
    between_runs = ("the arm carried another load", ())
    drawn_against = "time"
    shown_by = "the wrist turns through many orientations at rest and then accelerates in each of them"
    equivalent_to = (
        Equivalence(
            ("link_inertia",),
            "a body on the last link changes that link's inertial parameters",
            "no motion can tell; a run with the tool removed would",
            always=True,
        ),
    )

    def twin(self, term: Term, robot: Robot) -> Term | None:
        return Term("link_inertia", robot.n_joints - 1)

    def joints_of(self, robot: Robot, term: Term) -> list[int]:
        return [robot.n_joints - 1]

    def columns(self, motion: Motion, term: Term) -> Array:
        return motion.regressor[:, :, -10:]

    def prior_scale(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        return BODY_SCALE

    def inertial_bodies(self, robot: Robot, term: Term) -> list[tuple[int, Array]]:
        return [(0, np.zeros(10))]

    def inertial_changes(self, x: Array, robot: Robot, term: Term) -> list[Array]:
        return [x]

    def parameters_of(self, x: Array, robot: Robot, term: Term) -> dict[str, float]:
        return to_body(x)

    def coordinates_of(self, parameters: Mapping[str, float], robot: Robot, term: Term) -> Array:
        return to_dynamic(parameters)

    def change(self, robot: Robot, effect: Effect) -> None:
        joint = robot.joint_ids[-1]
        total = robot.model.inertias[joint].toDynamicParameters() + to_dynamic(effect.parameters)
        robot.model.inertias[joint] = pin.Inertia.FromDynamicParameters(total)

    def draw(self, robot: Robot, term: Term, rng: np.random.Generator) -> Array:
        return random_block(rng)

    def parameter_error(
        self, true: Effect, found: Effect, robot: Robot, motions: Sequence[Motion] = ()
    ) -> dict[str, float]:
        return {"torque": torque_error(self, true, found, robot, motions)}
