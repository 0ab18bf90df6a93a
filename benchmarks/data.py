"""Robots, motions and logs made on the spot: nothing is downloaded, the same seed gives the same data."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hybrid_dynamics.readers.table import write_log
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory

LINK = (
    '<link name="link{k}"><inertial><origin xyz="0.02 -0.01 0.15"/><mass value="{mass}"/>'
    '<inertia ixx="{i}" ixy="0" ixz="0" iyy="{i}" iyz="0" izz="{i}"/></inertial></link>'
)
JOINT = (
    '<joint name="joint{k}" type="revolute"><parent link="link{below}"/><child link="link{k}"/>'
    '<origin xyz="0 0 0.3"/><axis xyz="{axis}"/>'
    '<limit lower="-3" upper="3" velocity="3" effort="200"/></joint>'
)


def arm_urdf(joints: int) -> str:
    """URDF text of an arm of ``joints`` revolute joints that turn about z, y, y, z, y, y, ... ; links get lighter."""
    parts = ['<robot name="arm"><link name="link0"/>']
    for k in range(1, joints + 1):
        mass = 8.0 / (1 + 0.5 * k)
        parts.append(LINK.format(k=k, mass=f"{mass:.6g}", i=f"{0.02 * mass:.6g}"))
        parts.append(JOINT.format(k=k, below=k - 1, axis="0 0 1" if k % 3 == 1 else "0 1 0"))
    return "".join([*parts, "</robot>"])


def arm(joints: int) -> Robot:
    return Robot.from_text(arm_urdf(joints), "arm.urdf")


def motion(robot: Robot, seconds: float, rate: float, seed: int) -> tuple[np.ndarray, ...]:
    """Time (T,) and multi-sine ``q dq ddq`` (T, n), each joint with its own frequencies and phases."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate)) / rate
    w = 2 * np.pi * np.array([0.1, 0.23, 0.47, 0.9])[None, :] * rng.uniform(0.8, 1.2, (robot.n_joints, 4))
    size = np.array([0.5, 0.3, 0.15, 0.06]) * rng.uniform(0.7, 1.3, w.shape)
    phase = rng.uniform(0, 2 * np.pi, w.shape)
    angle = time[:, None, None] * w + phase
    return (
        time,
        (size * np.sin(angle)).sum(-1),
        (size * w * np.cos(angle)).sum(-1),
        (-size * w**2 * np.sin(angle)).sum(-1),
    )


def log(
    robot: Robot, seconds: float, rate: float, seed: int, friction: float = 1.0, viscous: float = 0.5
) -> Trajectory:
    """A run with Coulomb [N m] and viscous [N m s/rad] friction on every other joint, read by noisy sensors."""
    rng = np.random.default_rng(1000 + seed)
    time, q, dq, ddq = motion(robot, seconds, rate, seed)
    where = (np.arange(robot.n_joints) % 2 == 0).astype(float)
    torque = robot.inverse_dynamics(q, dq, ddq) + where * (friction * np.sign(dq) + viscous * dq)
    torque += rng.normal(scale=0.05, size=torque.shape)
    return Trajectory(f"run{seed}", "train", time, {"q": q + rng.normal(scale=2e-6, size=q.shape), "tau": torque})


def write_csv(run: Trajectory, folder: Path) -> Path:
    """A log as users have them: ``time,q1..qn,tau1..taun``; returns its file in ``folder``."""
    n = run["q"].shape[1]
    path = folder / f"{run.name}.csv"
    header = ",".join(["time", *(f"q{j + 1}" for j in range(n)), *(f"tau{j + 1}" for j in range(n))])
    np.savetxt(path, np.column_stack([run.time, run["q"], run["tau"]]), "%.9g", ",", header=header, comments="")
    return path


def write_parquet(run: Trajectory, folder: Path) -> Path:
    """The same as Parquet."""
    path = folder / f"{run.name}.parquet"
    write_log(path, run, [f"joint{k + 1}" for k in range(run.n_joints)])
    return path
