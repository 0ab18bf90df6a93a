"""Is the input what it claims to be? Units, signs, lengths. What is certainly wrong is refused in one line."""

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
MAX_SCALE = 20.0


def check_logs(robot: Robot, trajectories: Sequence[Trajectory]) -> None:
    """Raise :class:`InputError` for signals that are missing, not finite, not in radians or without torque."""
    for run in trajectories:
        for signal in ("q", "tau"):
            if signal not in run:
                raise InputError(f"run {run.name}: no signal {signal!r}; expected {signal}1 to {signal}{robot.n_joints}")
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
                f"run {run.name}: joint {joint} reaches {largest:.4g} rad; expected radians (convert degrees to radians)"
            )
        if not np.any(np.ptp(run["tau"], axis=0) > 0):
            raise InputError(f"run {run.name}: all torques are constant; expected measured joint torques in N m")
    names = [run.name for run in trajectories]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"run {name}: the name is given twice; give every run its own file name")


def check_torque(model: Model, runs: Sequence[Run]) -> list[str]:
    """Compare sign and size of the measured torque with the model's; returns notes, raises where it cannot be right.

    Per joint the measured torque is regressed on the model's torque, speed, direction and a constant; only where the
    model's torque matters (partial correlation above 0.6) is its factor judged.
    """
    notes = []
    names = model.robot.joint_names
    wrong_scale = []
    for j, name in enumerate(names):
        tau = np.concatenate([run.tau[:, j] for run in runs])
        dq = np.concatenate([run.dq[:, j] for run in runs])
        rigid = np.concatenate([run.smooth(Evidence.predict_fine(model, run))[:, j] for run in runs])
        if len(tau) < 20 or np.std(rigid) < 1e-6 or np.std(tau) < 1e-12:
            continue
        nuisance = np.column_stack([dq, np.tanh(dq / 0.05), np.ones_like(dq)])

        def clean(x: Array, basis: Array = nuisance) -> Array:
            return np.asarray(x - basis @ np.linalg.lstsq(basis, x, rcond=None)[0])

        own, measured = clean(rigid), clean(tau)
        size = float(np.linalg.norm(own) * np.linalg.norm(measured))
        if size <= 0 or np.linalg.norm(own) < 0.02 * np.linalg.norm(rigid):
            continue
        correlation = float(own @ measured) / size
        factor = float(own @ measured) / float(own @ own)
        if correlation < -0.6:
            raise InputError(
                f"measured torque anti-correlates with the model on joint {j + 1} ({name}, correlation "
                f"{correlation:.2f}); expected the torque the drive delivers, positive along the joint axis: flip its sign"
            )
        if correlation > 0.6 and not 1 / MAX_SCALE < factor < MAX_SCALE:
            wrong_scale.append((j, factor))
        elif correlation > 0.9 and not 0.5 < factor < 2.0:
            notes.append(
                f"measured torque of joint {j + 1} ({name}) is {factor:.2g} times the model's: check its unit and gain"
            )
    if wrong_scale:
        j, factor = wrong_scale[0]
        where = ", ".join(str(k + 1) for k, _ in wrong_scale)
        raise InputError(
            f"measured torque is {factor:.3g} times the model's on joint {j + 1} (joints {where}); expected N m at the "
            "joint: convert the unit (mN m, N cm, motor current or motor-side torque need a factor)"
        )
    return notes
