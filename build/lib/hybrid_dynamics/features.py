"""The 7 n features of the paper: motion, its derivatives and the rigid-body torques (paper, section III)."""

from __future__ import annotations

import numpy as np

from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: Signals of the feature matrix, in the order of its column blocks.
FEATURES = ("q", "dq", "ddq", "dddq", "tau_inertia", "tau_coriolis", "tau_gravity")


def add_features(robot: Robot, trajectory: Trajectory) -> Trajectory:
    """``trajectory`` (with ``q dq ddq``) and its rigid-body torques ``tau_inertia tau_coriolis tau_gravity`` [N m]."""
    torques = robot.rigid_body_torques(trajectory["q"], trajectory["dq"], trajectory["ddq"])
    return trajectory.with_signals(
        tau_inertia=torques.inertia, tau_coriolis=torques.coriolis, tau_gravity=torques.gravity
    )


def feature_matrix(trajectory: Trajectory) -> Array:
    """(T, 7 n) in the order of :func:`feature_names`. Raises :class:`InputError` naming a missing signal."""
    return np.hstack([trajectory[signal] for signal in FEATURES])


def feature_names(n_joints: int) -> tuple[str, ...]:
    """The 7 n column names ``q1 .. qn dq1 .. dqn ddq1 ..``, in the order of :data:`FEATURES`."""
    return tuple(f"{signal}{j}" for signal in FEATURES for j in range(1, n_joints + 1))
