"""The inertial parameters of one link differ from the model's; the published ones are the new values of that link.

The last link is left out: there the same columns are called ``payload``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Effect, Family, Term, register
from hybrid_dynamics.effects.inertia import (
    BODY_PARAMETERS,
    BODY_SCALE,
    link_parameters,
    random_block,
    to_body,
    to_dynamic,
    torque_error,
)
from hybrid_dynamics.effects.state import Equivalence, Motion
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array


@register
class LinkInertia(Family):
    name = "link_inertia"
    scope = "link"
    equation = r"\tau = Y_i(q, \dot q, \ddot q)\,(\pi_i - \pi_i^\text{URDF}),\quad \pi_i \text{ a body that can exist}"
    parameters = BODY_PARAMETERS
    size = 10
    is_body = True
    contains = ("link_mass", "link_com")
    changes_body = True
    by_regressor = True
    drawn_against = "time"
    shown_by = "the joint of that link and those before it accelerate together in many postures"
    equivalent_to = (
        Equivalence(
            ("armature",),
            "inertia about the joint's own axis, where nothing else moves the link",
            "on the first joint of a fixed base no motion tells; elsewhere move the joints before it as well",
        ),
        Equivalence(
            ("joint_spring",),
            "the first moment of the first link that gravity loads makes a torque of sine and cosine of its position",
            "accelerate the joint hard: a spring does not resist acceleration",
        ),
        Equivalence(
            ("torque_gain",),
            "a gain makes every torque of its joint larger, as heavier links do",
            "compare the joints before it: a heavier link loads them too, a gain does not",
        ),
    )

    def terms(self, robot: Robot, moving: NDArray[np.bool_], options: Mapping[str, Any]) -> list[Term]:
        return [Term(self.name, j) for j in range(robot.n_joints - 1) if moving[: j + 1].any()]

    def columns(self, motion: Motion, term: Term) -> Array:
        first = 10 * term.index
        return motion.regressor[:, :, first : first + 10]

    def prior_scale(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        return BODY_SCALE

    def inertial_bodies(self, robot: Robot, term: Term) -> list[tuple[int, Array]]:
        return [(0, link_parameters(robot, term.index))]

    def inertial_changes(self, x: Array, robot: Robot, term: Term) -> list[Array]:
        return [x]

    def parameters_of(self, x: Array, robot: Robot, term: Term) -> dict[str, float]:
        return to_body(link_parameters(robot, term.index) + x)

    def coordinates_of(self, parameters: Mapping[str, float], robot: Robot, term: Term) -> Array:
        return to_dynamic(parameters) - link_parameters(robot, term.index)

    def change(self, robot: Robot, effect: Effect) -> None:
        joint = robot.joint_ids[effect.joint_index(robot) or 0]
        robot.model.inertias[joint] = pin.Inertia.FromDynamicParameters(to_dynamic(effect.parameters))

    def draw_term(self, robot: Robot, moving: NDArray[np.bool_], rng: np.random.Generator) -> Term:
        # The first link only turns: a hidden one there is an armature by another name.
        return Term(self.name, int(rng.integers(1, robot.n_joints - 1)))

    def draw(self, robot: Robot, term: Term, rng: np.random.Generator) -> Array:
        return random_block(rng)

    def parameter_error(
        self, true: Effect, found: Effect, robot: Robot, motions: Sequence[Motion] = ()
    ) -> dict[str, float]:
        return {"torque": torque_error(self, true, found, robot, motions)}
