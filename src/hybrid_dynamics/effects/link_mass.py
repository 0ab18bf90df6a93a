"""The mass of one link differs: centre of mass and radii of gyration stay (a denser or lighter link).

One coordinate, the change of mass; all ten dynamic parameters of the link grow in proportion. Published: the new mass.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Effect, Family, Term, register
from hybrid_dynamics.effects.inertia import link_parameters, links_with_mass
from hybrid_dynamics.effects.state import Equivalence, Motion, Parameter
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: Share of its mass that a link keeps at least.
_LEAST = 0.02


@register
class LinkMass(Family):
    name = "link_mass"
    scope = "link"
    equation = r"\tau = Y_i(q, \dot q, \ddot q)\,\pi_i^\text{URDF}\,(m_i / m_i^\text{URDF} - 1)"
    parameters = (Parameter("mass", "kg"),)
    changes_body = True
    by_regressor = True
    searched = False
    drawn_against = "time"
    shown_by = "the joints before that link carry it at rest and accelerate it in many postures"
    equivalent_to = (
        Equivalence(
            ("link_inertia",),
            "the mass is one of the link's inertial parameters",
            "the simpler one is named where it predicts as well",
            always=True,
        ),
        Equivalence(
            ("torque_gain",),
            "a gain makes every torque of its joint larger, as heavier links do",
            "compare the joints before it: a heavier link loads them too, a gain does not",
        ),
    )

    def terms(self, robot: Robot, moving: NDArray[np.bool_], options: Mapping[str, Any]) -> list[Term]:
        return [Term(self.name, j) for j in links_with_mass(robot, moving)]

    def columns(self, motion: Motion, term: Term) -> Array:
        own = link_parameters(motion.robot, term.index)
        first = 10 * term.index
        return np.asarray((motion.regressor[:, :, first : first + 10] @ (own / own[0]))[:, :, None])

    def lower_bounds(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        own = 0.0 if robot is None or term is None else float(link_parameters(robot, term.index)[0])
        return np.array([(_LEAST - 1.0) * own])

    def prior_scale(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        return np.array([5.0])

    def inertial_changes(self, x: Array, robot: Robot, term: Term) -> list[Array]:
        return [link_parameters(robot, term.index) * x[0] / link_parameters(robot, term.index)[0]]

    def parameters_of(self, x: Array, robot: Robot, term: Term) -> dict[str, float]:
        return {"mass": float(link_parameters(robot, term.index)[0] + x[0])}

    def coordinates_of(self, parameters: Mapping[str, float], robot: Robot, term: Term) -> Array:
        return np.array([parameters["mass"] - link_parameters(robot, term.index)[0]])

    def change(self, robot: Robot, effect: Effect) -> None:
        link = effect.joint_index(robot) or 0
        own = link_parameters(robot, link)
        scaled = own * effect.parameters["mass"] / own[0]
        robot.model.inertias[robot.joint_ids[link]] = pin.Inertia.FromDynamicParameters(scaled)

    def draw(self, robot: Robot, term: Term, rng: np.random.Generator) -> Array:
        return np.ones(1)  # heavier: a size that is drawn later cannot make the mass negative
