"""A two-joint arm for the examples: its URDF, and runs of it with friction that the URDF does not know.

Stands in for your robot and your logs; replace it by them.
"""

from __future__ import annotations

from pathlib import Path

from hybrid_dynamics import Robot
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.simulation.excitation import excitations
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
#: What the drives feel beyond the URDF: the loop is to find it.
HIDDEN = (
    Effect("viscous_friction", ("shoulder",), {"viscous_coefficient": 3.0}),
    Effect("coulomb_friction", ("elbow",), {"coulomb_torque": 1.5}),
)


def write_urdf(folder: Path) -> Path:
    """The arm's URDF as a file."""
    path = folder / "demo_arm.urdf"
    path.write_text(URDF)
    return path


def record(robot: Robot, seconds: float = 8.0) -> tuple[list[Trajectory], list[Trajectory]]:
    """Two runs to learn from and one held out: positions [rad] and drive torques [N m] at 400 Hz."""
    return excitations(robot, HIDDEN, train=2, test=1, duration=seconds, rate=400.0)
