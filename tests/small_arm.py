"""A two-joint arm and logs of it, for tests and for the examples in docstrings: small, planar, exact."""

from __future__ import annotations

from pathlib import Path

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.loop.excitation import excitations
from hybrid_dynamics.readers import write_log
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory

URDF = """<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="4"/>
    <inertia ixx="0.06" iyy="0.06" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0 0 0.15"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-2.5" upper="2.5" velocity="3" effort="60"/></joint>
  <joint name="elbow" type="revolute"><origin xyz="0 0 0.4"/><parent link="upper"/><child link="fore"/>
    <axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5" velocity="3" effort="30"/></joint>
</robot>
"""
#: What the logs hold beyond the URDF.
HIDDEN = (
    Effect("viscous_friction", ("shoulder",), {"viscous_coefficient": 3.0}),
    Effect("coulomb_friction", ("elbow",), {"coulomb_torque": 1.5}),
)


def arm() -> Robot:
    """The arm as its URDF says it is."""
    return Robot.from_text(URDF, "small arm")


def runs(train: int = 2, test: int = 1, duration: float = 8.0) -> tuple[list[Trajectory], list[Trajectory]]:
    """Logs of the arm with what is hidden: 400 Hz, ``q`` and ``tau``."""
    return excitations(arm(), HIDDEN, train=train, test=test, duration=duration, rate=400.0)


def write_logs(folder: Path) -> Path:
    """``robot.urdf``, ``train_1.parquet``, ``train_2.parquet`` and ``test_1.parquet`` in ``folder``."""
    (folder / "robot.urdf").write_text(URDF, encoding="utf-8")
    robot = arm()
    for run in (run for split in runs() for run in split):
        write_log(folder / f"{run.name}.parquet", run, robot.joint_names)
    return folder
