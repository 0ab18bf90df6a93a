"""A two-joint arm for the examples: its URDF, and runs of it with friction that the URDF does not know.

    python examples/demo_arm.py --out demo       # robot.urdf, train_1.parquet, train_2.parquet, test_1.parquet

Stands in for your robot and your logs; replace it by them.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from hybrid_dynamics import Robot
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.readers import write_log
from hybrid_dynamics.simulation.excitation import excitations
from hybrid_dynamics.trajectory import Trajectory

URDF = """<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="4"/>
    <inertia ixx="0.06" iyy="0.06" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0 0 0.15"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-2.5" upper="2.5" velocity="4" effort="60"/></joint>
  <joint name="elbow" type="revolute"><origin xyz="0 0 0.4"/><parent link="upper"/><child link="fore"/>
    <axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5" velocity="4" effort="30"/></joint>
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


def write_files(folder: Path) -> list[Path]:
    """``robot.urdf`` and a log for every run, in ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    robot = Robot.from_text(URDF, "robot.urdf")
    files = [folder / "robot.urdf"]
    files[0].write_text(URDF, encoding="utf-8")
    train, test = record(robot)
    for run in (*train, *test):
        files.append(folder / f"{run.name}.parquet")
        write_log(files[-1], run, robot.joint_names)
    return files


def main() -> None:
    """Write the files, and say what is hidden in them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("demo"), metavar="FOLDER", help="folder to make (demo)")
    folder = parser.parse_args().out
    if folder.exists() and any(folder.iterdir()):
        sys.exit(f"error: {folder}: holds files already; give another folder")
    for path in write_files(folder):
        print(path)
    for effect in HIDDEN:
        values = ", ".join(f"{name} {value:g}" for name, value in effect.parameters.items())
        print(f"hidden: {effect.effect} ({effect.joints[0]}): {values}")


if __name__ == "__main__":
    main()
