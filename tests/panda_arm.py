"""The Panda of the package, its fingers fixed, and logs of it as the checks of logs want them: friction and noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation.excitation import excitation
from hybrid_dynamics.trajectory import Trajectory

FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
JOINTS = [f"panda_joint{j}" for j in range(1, 8)]
FRICTION = [
    *(Effect("coulomb_friction", (j,), {"coulomb_torque": 0.5}) for j in JOINTS),
    *(Effect("viscous_friction", (j,), {"viscous_coefficient": 0.8}) for j in JOINTS),
]


def load_panda() -> Robot:
    """The arm as its URDF says it is."""
    return Robot.from_urdf(find_description("panda.urdf"), FINGERS)


def recorded(robot: Robot, effects: Sequence[Effect], duration: float, seed: int) -> Trajectory:
    """``duration`` [s] at 200 Hz of ``robot`` with ``effects``, white noise of 0.05 N m on its torque."""
    log = excitation(robot, effects, duration=duration, rate=200.0)
    noise = np.random.default_rng(seed).normal(size=log["tau"].shape)
    return log.with_signals(tau=log["tau"] + 0.05 * noise)
