"""Is the input what it claims to be? Units and signs. What is certainly wrong is refused in one line."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory

Array = NDArray[np.float64]

#: A joint angle beyond this is in degrees, or the log is of another robot.
MAX_ANGLE = 6 * np.pi
#: A torque that is this many times too large or small against the model is in another unit.
MAX_SCALE = 8.0
#: A joint is judged on its own where the model's torque reaches this share of the largest joint's.
STRONG = 0.15


def check_logs(robot: Robot, trajectories: Sequence[Trajectory]) -> None:
    """Raise :class:`InputError` for signals that are missing, not finite, not in radians or without torque."""
    for run in trajectories:
        for signal in ("q", "tau"):
            if signal not in run:
                raise InputError(
                    f"run {run.name}: no signal {signal!r}; expected {signal}1 to {signal}{robot.n_joints}"
                )
        if run.n_joints != robot.n_joints:
            raise InputError(
                f"run {run.name}: holds {run.n_joints} joints; robot {robot.name} has {robot.n_joints}; give the "
                "matching URDF or lock joints"
            )
        for signal in run.signals:
            if not np.isfinite(run[signal]).all():
                raise InputError(f"run {run.name}: {signal} holds values that are not finite; repair the log")
        largest = float(np.abs(run["q"]).max())
        if largest > MAX_ANGLE:
            joint = robot.joint_names[int(np.abs(run["q"]).max(axis=0).argmax())]
            raise InputError(
                f"run {run.name}: joint {joint} reaches {largest:.4g} rad; expected radians "
                "(convert degrees to radians)"
            )
        if not np.any(np.ptp(run["tau"], axis=0) > 0):
            raise InputError(f"run {run.name}: all torques are constant; expected measured joint torques in N m")
    names = [run.name for run in trajectories]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"run {name}: the name is given twice; give every run its own file name")


def check_torque(model: Model, runs: Sequence[Run]) -> None:
    """Compare sign and size of the measured torque with the model's; raises where it cannot be right.

    Per joint the measured torque is regressed on the model's torque, speed, direction and a constant. An undeclared
    payload may well outweigh a wrist, so a weak joint is only called reversed where its friction would also drive it
    or where it is the exact mirror image; and a unit is only called wrong where most strong joints say so.
    """
    names = model.robot.joint_names
    n = len(names)
    strength, correlation, factor, friction = np.zeros(n), np.zeros(n), np.ones(n), np.zeros(n)
    for j in range(n):
        tau = np.concatenate([run.tau[:, j] for run in runs])
        dq = np.concatenate([run.dq[:, j] for run in runs])
        rigid = np.concatenate([run.smooth(Evidence.predict_fine(model, run))[:, j] for run in runs])
        if len(tau) < 20 or np.std(tau) < 1e-12:
            continue
        basis = np.column_stack([dq, np.ones_like(dq)])
        own, measured = (x - basis @ np.linalg.lstsq(basis, x, rcond=None)[0] for x in (rigid, tau))
        strength[j] = float(np.sqrt(np.mean(own**2)))
        size = float(np.linalg.norm(own) * np.linalg.norm(measured))
        if size <= 1e-12:
            continue
        correlation[j] = float(own @ measured) / size
        factor[j] = float(own @ measured) / float(own @ own)
        columns = np.column_stack([rigid, dq, np.ones_like(dq)])
        damping = np.linalg.lstsq(columns, tau, rcond=None)[0][1] * np.std(dq)
        friction[j] = damping / max(float(np.std(tau)), 1e-12)
    strong = strength >= STRONG * max(float(strength.max()), 1e-12)
    reversed_ = (strong & (correlation < -0.6)) | ((correlation < -0.6) & (friction < -0.1))
    reversed_ |= (correlation < -0.97) & (np.abs(factor + 1) < 0.3)
    if reversed_.any():
        j = int(np.argmax(reversed_))
        raise InputError(
            f"measured torque anti-correlates with the model on joint {j + 1} ({names[j]}, correlation "
            f"{correlation[j]:.2f}); expected the torque the drive delivers, positive along the joint axis: "
            "flip its sign"
        )
    off = strong & (correlation > 0.6) & ((factor > MAX_SCALE) | (factor < 1 / MAX_SCALE))
    if off.any() and 2 * off.sum() >= strong.sum():
        j = int(np.argmax(off))
        raise InputError(
            f"measured torque is {factor[j]:.3g} times the model's on joint {j + 1} ({names[j]}); expected N m at the "
            "joint: convert the unit (N cm, mN m, motor current and motor-side torque need a factor)"
        )
