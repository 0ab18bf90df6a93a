"""Reading the log files a command names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hybrid_dynamics.readers.log import read_pieces
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory

LOG_HELP = (
    "A LOG is CSV or Parquet with the header time,q1..qn[,dq1..dqn],tau1..taun (SI units; joints in the order of the "
    "URDF; torque is what the drive delivers, positive along the joint axis), or a ROS bag or MCAP with JointState."
)


def read_logs(
    paths: Sequence[Path], robot: Robot, split: str, notices: list[str], torque: bool = True
) -> list[Trajectory]:
    """All logs; a log with long gaps gives several runs. Names are file names, made distinct where they repeat."""
    out: list[Trajectory] = []
    stems = [p.stem for p in paths]
    for path in paths:
        name = path.stem if stems.count(path.stem) == 1 else str(path)
        out += read_pieces(path, robot.joint_names, f"{split}:{name}", split, notify=notices.append, torque=torque)
    return out
