"""Does the log fit the robot: positions, speeds and torques against the URDF's limits, degrees taken for radians."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.check.findings import Finding
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory

#: A joint with limits beyond this [rad] is in degrees, or the log is of another robot; one that turns on and on, later.
MAX_ANGLE, MAX_TURNING = 6 * np.pi, 12 * np.pi
#: Limits are exceeded by more than this: radians, and shares.
ANGLE_MARGIN, SPEED_MARGIN, EFFORT_MARGIN = 0.05, 1.1, 1.2
#: Speeds of all joints this many times their limits are a matter of the clock, not of a joint that moves too fast.
CLOCK = 3.0


def check_angles(robot: Robot, runs: Sequence[Trajectory]) -> list[Finding]:
    """Hard where positions cannot be radians."""
    low, high = robot.position_limits
    bounded = np.isfinite(low) & np.isfinite(high) & (high > low)
    for run in runs:
        largest = np.abs(run["q"]).max(axis=0)
        beyond = np.where(bounded, largest > MAX_ANGLE, largest > MAX_TURNING)
        out = ((run["q"] < low - 1.0) | (run["q"] > high + 1.0)).astype(float)
        outside = bounded & (out.mean(axis=0) > 0.1)
        as_degrees = np.deg2rad(run["q"])
        within = (as_degrees >= low - ANGLE_MARGIN) & (as_degrees <= high + ANGLE_MARGIN)
        fits = np.asarray(np.all(within, axis=0))
        degrees = outside.sum() > 0.5 * bounded.sum() and bool(fits[bounded].all())
        if beyond.any() or degrees:
            j = int(np.argmax(np.where(beyond if beyond.any() else outside, largest, 0.0)))
            text = f"reaches {largest[j]:.4g} rad; expected radians (convert degrees to radians)"
            cure = {"units": {"q": "deg"}} if fits.all() else {}
            if robot.joint_names[j] in robot.prismatic:
                text, cure = f"reaches {largest[j]:.4g} m; expected metres (convert millimetres to metres)", {}
            return [Finding("degrees", "hard", text, run=run.name, joint=robot.joint_names[j], suggestion=cure)]
    return []


def check_limits(robot: Robot, runs: Sequence[Trajectory]) -> list[Finding]:
    """Where the log goes beyond the limits of the URDF, one finding a kind; limits of zero count as not given."""
    low, high = robot.position_limits
    speed, effort = robot.velocity_limits, robot.effort_limits
    angles, speeds, torques = [], [], []
    of_limit = []  # fastest speeds, in multiples of what the URDF allows
    length, effort_unit = ("rad or m", "N m or N") if robot.prismatic else ("rad", "N m")
    for j, name in enumerate(robot.joint_names):
        q = np.concatenate([run["q"][:, j] for run in runs])
        if high[j] > low[j] and (q.min() < low[j] - ANGLE_MARGIN or q.max() > high[j] + ANGLE_MARGIN):
            angles.append(f"{name} {q.min():.3g} to {q.max():.3g} (limits {low[j]:.3g} to {high[j]:.3g})")
        fastest = max(float(np.percentile(np.abs(np.gradient(run["q"][:, j], run.dt)), 99.5)) for run in runs)
        of_limit += [fastest / speed[j]] if speed[j] > 0 and fastest > 0 else []
        if 0 < speed[j] * SPEED_MARGIN < fastest:
            speeds.append(f"{name} {fastest:.3g} (limit {speed[j]:.3g})")
        largest = max((float(np.abs(run["tau"][:, j]).max()) for run in runs if "tau" in run), default=0.0)
        if 0 < effort[j] * EFFORT_MARGIN < largest:
            torques.append(f"{name} {largest:.3g} (limit {effort[j]:.3g})")
    clock = "are the time stamps in seconds?" if min(of_limit, default=0.0) > CLOCK else ""
    return [
        Finding(code, "warning", f"{what} beyond the URDF's limits: {', '.join(found)}; {question}".removesuffix("; "))
        for code, what, found, question in (
            (
                "beyond_limits",
                f"positions [{length}]",
                angles,
                "is it this robot, and is its zero position the URDF's?",
            ),
            ("beyond_speed", f"speeds [{length}/s]", speeds, clock),
            ("beyond_effort", f"torques [{effort_unit}]", torques, f"are they {effort_unit} at the joint?"),
        )
        if found
    ]
