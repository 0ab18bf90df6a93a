"""What a rigid robot of unknown mounting would need: torque of the motion, and of gravity along each base axis.

Newton-Euler torque is linear in the vector of gravity, so three passes with gravity along x, y and z give the gravity
torque for every way the base can stand. What a model has beside the rigid body is a column of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_dynamics.check.completed import Completed, beside_body, body_of, true_stretches
from hybrid_dynamics.check.samples import Stretch, direction
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

GRAVITY = 9.81


@dataclass(frozen=True)
class Columns:
    """``motion`` (K, n) [N m]: inertia and Coriolis; ``gravity`` (K, n, 3): torque for gravity of 1 m/s^2 along x, y, z
    of the base; ``beside`` (K, n) [N m]: what the model has beside the rigid body; ``dq ddq sign tau`` (K, n)."""

    motion: Array
    gravity: Array
    beside: Array
    dq: Array
    ddq: Array
    sign: Array
    tau: Array

    def model(self, j: int, gravity: Array, pace: float = 1.0) -> Array:
        """(K,) [N m] the model's torque of joint ``j`` under ``gravity`` (3,) [m/s^2], motion ``pace`` times faster."""
        return np.asarray(pace**2 * self.motion[:, j] + self.gravity[:, j] @ gravity + self.beside[:, j])

    def free(self, j: int) -> Array:
        """(K, 4) columns of joint ``j`` that a rigid body does not determine: friction, rotor, offset."""
        return np.column_stack([self.dq[:, j], self.sign[:, j], self.ddq[:, j], np.ones(len(self.dq))])


#: A run and its columns alone.
OfRun = tuple[Trajectory, Columns]


def of_each(model: Robot | Completed, runs: Sequence[Trajectory]) -> list[OfRun]:
    """Those of ``runs`` that have something to look at, each with its own columns."""
    parted = ((run, true_stretches(model, [run])) for run in runs)
    return [(run, columns_of(model, parts)) for run, parts in parted if parts]


def columns_of(
    model: Robot | Completed,
    parts: Sequence[Stretch],
    swap: tuple[int, int] | None = None,
    mirror: int | None = None,
) -> Columns:
    """Columns along all of ``parts``; first ``swap`` exchanges the positions of two joints (0-based), ``mirror`` turns
    the sign of one joint's position."""
    robot = body_of(model)
    order = np.arange(robot.n_joints)
    if swap is not None:
        order[list(swap)] = order[list(reversed(swap))]
    q, dq, ddq, tau = (np.concatenate([getattr(p, s) for p in parts]) for s in ("q", "dq", "ddq", "tau"))
    turn = np.where(np.arange(robot.n_joints) == (-1 if mirror is None else mirror), -1.0, 1.0)
    q, dq, ddq = (turn * x[:, order] for x in (q, dq, ddq))
    free = robot.copy()
    free.model.gravity.linear = np.zeros(3)
    motion = free.inverse_dynamics(q, dq, ddq)
    gravity = np.empty((*q.shape, 3))
    zero = np.zeros_like(q)
    for k in range(3):
        free.model.gravity.linear = np.eye(3)[k]
        gravity[:, :, k] = free.inverse_dynamics(q, zero, zero)
    return Columns(motion, gravity, beside_body(model, parts, q, dq, ddq), dq, ddq, direction(dq), tau)


def standing(robot: Robot) -> Array:
    """Gravity (3,) [m/s^2] in the base frame as the model has it."""
    return np.asarray(robot.model.gravity.linear, float).copy()
