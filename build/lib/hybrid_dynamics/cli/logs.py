"""Reading the log files a command names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hybrid_dynamics.readers.log import read_pieces
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory


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
