"""The centre of mass of one link lies elsewhere; its mass and its inertia about the centre of mass stay.

Such a body can always exist. Coordinates: the change of the first moment (3,) [kg m]; the inertia about the joint frame
follows by the parallel-axis theorem, so the torque is linear only for small shifts. Published: the new centre of mass.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Effect, Family, Term, register
from hybrid_dynamics.effects.inertia import link_parameters, links_with_mass, to_body, to_dynamic
from hybrid_dynamics.effects.state import Equivalence, Motion, Parameter
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

_AXES = ("com_x", "com_y", "com_z")


def _shifted(own: Array, com: Array) -> Array:
    """Dynamic parameters of the body ``own`` with its centre of mass at ``com`` (3,) [m]."""
    return to_dynamic({**to_body(own), **dict(zip(_AXES, com.tolist(), strict=True))})


@register
class LinkCom(Family):
    name = "link_com"
    scope = "link"
    equation = r"\tau = Y_i(q, \dot q, \ddot q)\,\bigl(\pi_i(m_i, c, I_i^c) - \pi_i^\text{URDF}\bigr)"
    parameters = tuple(Parameter(axis, "m") for axis in _AXES)
    size = 3
    nonlinear = True
    changes_body = True
    by_regressor = True
    searched = False
    drawn_against = "time"
    shown_by = "the joints before that link hold it at rest in many orientations"
    equivalent_to = (
        Equivalence(
            ("link_inertia",),
            "the first moment is part of the link's inertial parameters",
            "the simpler one is named where it predicts as well",
            always=True,
        ),
        Equivalence(
            ("joint_spring",),
            "the first moment of the first link that gravity loads makes a torque of sine and cosine of its position",
            "accelerate the joint hard, or turn the joints before it",
        ),
    )

    def terms(self, robot: Robot, moving: NDArray[np.bool_], options: Mapping[str, Any]) -> list[Term]:
        return [Term(self.name, j) for j in links_with_mass(robot, moving)]

    def columns(self, motion: Motion, term: Term) -> Array:
        own = link_parameters(motion.robot, term.index)
        mass, com = float(own[0]), own[1:4] / own[0]
        # Quadratic in the shift, so the central difference is the derivative.
        slopes = [(_shifted(own, com + e) - _shifted(own, com - e)) / (2 * mass) for e in np.eye(3)]
        first = 10 * term.index
        return motion.regressor[:, :, first : first + 10] @ np.column_stack(slopes)

    def prior_scale(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        return np.ones(3)

    def inertial_changes(self, x: Array, robot: Robot, term: Term) -> list[Array]:
        return [np.concatenate([[0.0], x, np.zeros(6)])]

    def parameters_of(self, x: Array, robot: Robot, term: Term) -> dict[str, float]:
        own = link_parameters(robot, term.index)
        return dict(zip(_AXES, ((own[1:4] + x) / own[0]).tolist(), strict=True))

    def coordinates_of(self, parameters: Mapping[str, float], robot: Robot, term: Term) -> Array:
        own = link_parameters(robot, term.index)
        return np.asarray(np.array([parameters[axis] for axis in _AXES]) * own[0] - own[1:4])

    def change(self, robot: Robot, effect: Effect) -> None:
        link = effect.joint_index(robot) or 0
        com = np.array([effect.parameters[axis] for axis in _AXES])
        moved = _shifted(link_parameters(robot, link), com)
        robot.model.inertias[robot.joint_ids[link]] = pin.Inertia.FromDynamicParameters(moved)
