"""The encoder's zero is wrong: q_true = q_read + offset, so the whole model moves along.

The columns are the derivative of the rigid-body torque with respect to the joint's position, on all joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid_dynamics.effects.base import Family, Term, register
from hybrid_dynamics.effects.state import Equivalence, Motion, Parameter
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

_STEP = 1e-4  # rad: the difference is exact to 1e-8 of the torque, far above rounding


@register
class PositionOffset(Family):
    name = "position_offset"
    scope = "joint"
    equation = r"\tau = \tau_\text{model}(q + \delta e_j, \dot q, \ddot q) - \tau_\text{model}(q, \dot q, \ddot q)"
    parameters = (Parameter("offset", "rad"),)
    searched = False
    nonlinear = True
    changes_reading = True
    uses_body = True
    drawn_against = "q"
    shown_by = (
        "the joint carries a load at rest in positions all over its range, the joints after it stretched and folded"
    )
    equivalent_to = (
        Equivalence(
            ("torque_offset",),
            "near one posture a wrong zero changes the gravity torque by a constant",
            "move the joint over a wide range of positions",
        ),
        Equivalence(
            ("gravity_tilt",),
            "a wrong zero turns the arm about the joint's axis, as a tilted base does about an axis parallel to it",
            "turn the joints before it: the tilt's torque changes with them",
        ),
        Equivalence(
            ("link_com",),
            "both turn the first moment of what the joint carries",
            "move the joints after it: a wrong zero turns all of them together",
        ),
    )

    def in_descriptions(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> dict[str, float]:
        return {"position_offset": 1.0}

    def columns(self, motion: Motion, term: Term) -> Array:
        shift = np.zeros(motion.robot.n_joints)
        shift[term.index] = _STEP
        up, down = (motion.robot.inverse_dynamics(motion.q + s * shift, motion.dq, motion.ddq) for s in (1, -1))
        out: Array = ((up - down) / (2 * _STEP))[:, :, None]
        # Rounding where nothing depends on the position (the first joint of a level base) is no column.
        out[:, np.abs(out).max(axis=(0, 2)) < 1e-6] = 0.0
        return out

    def prior_scale(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        return np.full(1, 0.5)
