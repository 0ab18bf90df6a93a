"""A planar arm of two links, for tests that need a robot and little time."""

from pathlib import Path

from tests.small_arm import write_folder

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.excitation import excitations

URDF = """<robot name="two_links"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="3"/>
  <inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="fore"><inertial><origin xyz="0.15 0 0.01"/><mass value="2"/>
  <inertia ixx="0.005" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3" velocity="5" effort="40"/></joint>
<joint name="elbow" type="revolute"><origin xyz="0.4 0 0"/><parent link="upper"/><child link="fore"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3" velocity="5" effort="20"/></joint></robot>
"""
EFFECTS = (
    Effect("viscous_friction", ("shoulder",), {"viscous_coefficient": 2.0}),
    Effect("torque_offset", ("elbow",), {"offset": 0.8}),
)


def two_links() -> Robot:
    """The arm as its URDF says it is."""
    return Robot.from_text(URDF, "two_links.urdf")


def write_recordings(folder: Path, duration: float = 6.0, rate: float = 200.0) -> None:
    """``robot.urdf`` and the logs ``train_1 train_2 test_1`` of the arm with :data:`EFFECTS`."""
    write_folder(folder, URDF, *excitations(two_links(), EFFECTS, train=2, test=1, duration=duration, rate=rate))
