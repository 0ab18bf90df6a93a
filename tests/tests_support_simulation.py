"""Helpers shared by the tests of the simulation."""

from __future__ import annotations

import numpy as np

from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation import Controller, Rollout


def passive_controller(robot: Robot, period: float) -> Controller:
    """A controller that does nothing at all, not even gravity compensation."""
    floating = robot.copy()
    floating.model.gravity.linear = np.zeros(3)
    zero = np.zeros(robot.n_joints)
    return Controller(floating, period, zero, zero, zero, zero)


def interval_residual(robot: Robot, rollout: Rollout) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Per control interval: torque beyond the rigid body, mean velocity, and whether the joint kept its direction."""
    dt = rollout.time[1] - rollout.time[0]
    q, dq = rollout.q, rollout.dq
    mean = 0.5 * (dq[1:] + dq[:-1])
    rigid = robot.inverse_dynamics(0.5 * (q[1:] + q[:-1]), mean, np.diff(dq, axis=0) / dt)
    return rollout.tau[:-1] - rigid, mean, dq[1:] * dq[:-1] > 0
