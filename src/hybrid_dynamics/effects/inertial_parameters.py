"""The inertial parameters of all links differ from the model's and are identified together.

Coordinates are the differences (10 a link) to the robot's own; each link stays a body that can exist, in a ball about
its joint: within 1.5 times the distance to the joints around it, or of the model's own matter (a last link, which may
carry a tool, three quarters of the arm; slides and rails anywhere). The published values are the new ones of every
link, keyed ``"joint/mass"``, ...; setting ``links``: the joints that move the links concerned. Only the base parameters
among them are determined by data, the rest stays near the robot's own values.
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
    body_scale,
    link_parameters,
    to_body,
    to_dynamic,
    torque_error,
)
from hybrid_dynamics.effects.keys import joint_number, split_key
from hybrid_dynamics.effects.state import Equivalence, Motion
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: Names of the joints whose links are identified.
LINKS = "links"
_NAMES = tuple(p.name for p in BODY_PARAMETERS)
#: All links together are one cause that costs about as much as three single bodies.
_PRICE = 30


@register
class InertialParameters(Family):
    name = "inertial_parameters"
    scope = "robot"
    known_settings = (LINKS,)
    equation = (
        r"\tau = \sum_i Y_i(q, \dot q, \ddot q)\,(\pi_i - \pi_i^\text{URDF}),"
        r"\quad \text{every } \pi_i \text{ a body that can exist}"
    )
    parameters = BODY_PARAMETERS
    size = 10
    is_body = True
    all_links = True
    contains = ("link_inertia", "link_mass", "link_com")
    changes_body = True
    by_regressor = True
    searched = True
    drawn_against = "time"
    shown_by = "all joints move together through many postures and accelerate hard in them"
    equivalent_to = (
        Equivalence(
            ("payload",),
            "a body on the last link is part of the last link's parameters",
            "no motion can tell; a run with the tool removed would",
            always=True,
        ),
        Equivalence(
            ("link_inertia",),
            "the parameters of one link are part of all links' parameters",
            "the simpler one is named where it predicts as well",
            always=True,
        ),
    )

    def terms(self, robot: Robot, moving: NDArray[np.bool_], options: Mapping[str, Any]) -> list[Term]:
        links = tuple(name for k, name in enumerate(robot.joint_names) if moving[: k + 1].any())
        return [Term(self.name, None, ((LINKS, links),))] if links else []

    def size_of(self, term: Term) -> int:
        return 10 * len(term.options[LINKS])

    def columns(self, motion: Motion, term: Term) -> Array:
        return np.concatenate(
            [motion.regressor[:, :, 10 * k : 10 * k + 10] for k in self._links(motion.robot, term)], axis=2
        )

    def prior_scale(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        if robot is None or term is None:
            raise InputError(f"effect {self.name}: its prior follows the robot's own links; give robot and term")
        return np.concatenate([body_scale(link_parameters(robot, k)) for k in self._links(robot, term)])

    def inertial_bodies(self, robot: Robot, term: Term) -> list[tuple[int, Array]]:
        return [(10 * i, link_parameters(robot, k)) for i, k in enumerate(self._links(robot, term))]

    def joints_of(self, robot: Robot, term: Term) -> list[int]:
        return self._links(robot, term)

    def covers(self, term: Term, special: Term) -> bool:
        # Bodies of single links, on whatever joint, and one at the end.
        return special.effect in (*self.contains, "payload")

    def price(self, settings: Mapping[str, Any]) -> int:
        return min(super().price(settings), _PRICE)

    def published(self, settings: Mapping[str, Any]) -> tuple[str, ...]:
        if not settings.get(LINKS):
            raise InputError(f"effect {self.name}: setting {LINKS} is missing; expected the joints of its links")
        return tuple(f"{joint}/{name}" for joint in settings[LINKS] for name in _NAMES)

    def parameters_of(self, x: Array, robot: Robot, term: Term) -> dict[str, float]:
        out: dict[str, float] = {}
        for i, k in enumerate(self._links(robot, term)):
            body = to_body(link_parameters(robot, k) + x[10 * i : 10 * i + 10])
            out |= {f"{robot.joint_names[k]}/{name}": body[name] for name in _NAMES}
        return out

    def coordinates_of(self, parameters: Mapping[str, float], robot: Robot, term: Term) -> Array:
        bodies = _bodies(parameters)
        return np.concatenate(
            [to_dynamic(bodies[robot.joint_names[k]]) - link_parameters(robot, k) for k in self._links(robot, term)]
        )

    def jacobian(self, x: Array, robot: Robot, term: Term) -> Array:
        out = np.zeros((len(x), len(x)))
        for i, k in enumerate(self._links(robot, term)):
            own = slice(10 * i, 10 * i + 10)
            single = Term(self.name, None, ((LINKS, (robot.joint_names[k],)),))
            out[own, own] = super().jacobian(x[own], robot, single)
        return out

    def change(self, robot: Robot, effect: Effect) -> None:
        for joint, body in _bodies(effect.parameters).items():
            number = robot.joint_ids[joint_number(robot, joint, f"effect {self.name}")]
            robot.model.inertias[number] = pin.Inertia.FromDynamicParameters(to_dynamic(body))

    def draw(self, robot: Robot, term: Term, rng: np.random.Generator) -> Array:
        # Every link heavier or lighter as a whole, and its centre of mass elsewhere: physical for small sizes.
        parts = []
        for k in self._links(robot, term):
            own = link_parameters(robot, k)
            parts.append(own * rng.uniform(-0.3, 0.3))
        return np.concatenate(parts)

    def parameter_error(
        self, true: Effect, found: Effect, robot: Robot, motions: Sequence[Motion] = ()
    ) -> dict[str, float]:
        return {"torque": torque_error(self, true, found, robot, motions)}

    def _links(self, robot: Robot, term: Term) -> list[int]:
        return [joint_number(robot, name, f"effect {self.name}") for name in term.options[LINKS]]


def _bodies(parameters: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Body parameters by joint name, from keys ``"joint/name"``."""
    out: dict[str, dict[str, float]] = {}
    for key, value in parameters.items():
        joint, name = split_key(key)
        out.setdefault(str(joint), {})[name] = float(value)
    return out
