"""Does the torque have a sign at all?

Servo drives and some loggers give the size of a current or load and keep its direction elsewhere, or nowhere. Friction
and rotors then push the way the joint does not go, and links weigh what they cannot: a better guess of signs and
gravity is no cure, since none is right for the whole log.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.check.clipped import own_torque
from hybrid_dynamics.check.findings import Finding
from hybrid_dynamics.differentiate.butterworth import lowpass
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory

#: A joint tells where the robot's own torque has either sign on at least this share of the samples, and where the
#: measured one comes as near to zero as this share of its largest: a magnitude turns back at zero, not before.
BOTH_SIGNS, NEAR_ZERO = 0.1, 0.01
#: Joints that tell, at least: the torque of one may well be pulled to one side by something.
FEWEST = 2
#: Cut-off [Hz] of the motion that the robot's own torque is asked about, and its share of the sampling rate at most.
CUTOFF, CUTOFF_SHARE = 5.0, 0.1


def check_magnitude(robot: Robot, runs: Sequence[Trajectory]) -> list[Finding]:
    """A hard finding where no joint's torque ever changes its sign, though that of several joints should."""
    if not runs or robot.n_joints < FEWEST:
        return []
    tau = np.concatenate([run["tau"] for run in runs])
    if not (np.all(tau >= 0) or np.all(tau <= 0)):
        return []
    smooth = [lowpass(run["q"], run.dt, min(CUTOFF, CUTOFF_SHARE / run.dt)) for run in runs]
    own = np.concatenate([own_torque(robot, q, run.dt) for q, run in zip(smooth, runs, strict=True)])
    either = np.minimum(np.mean(own > 0, axis=0), np.mean(own < 0, axis=0))
    size = np.abs(tau)
    near = (size.max(axis=0) > 0) & (size.min(axis=0) <= NEAR_ZERO * size.max(axis=0))
    telling = [robot.joint_names[j] for j in np.flatnonzero((either >= BOTH_SIGNS) & near)]
    if len(telling) < FEWEST:
        return []
    text = (
        f"no torque is ever {'negative' if np.any(tau > 0) else 'positive'}, though that of {', '.join(telling)} has "
        "to turn over on the way: it is a magnitude without its direction; log the torque (or current) with its sign"
    )
    return [Finding("torque_unsigned", "hard", text)]
