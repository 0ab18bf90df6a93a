"""The examples' two-joint arm and logs of it, for tests and for the examples in docstrings: small, planar, exact."""

from __future__ import annotations

from pathlib import Path

from examples.demo_arm import HIDDEN, URDF

from hybrid_dynamics.readers import write_log
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.excitation import excitations
from hybrid_dynamics.trajectory import Trajectory

__all__ = ["HIDDEN", "URDF", "arm", "runs", "write_folder", "write_logs"]


def arm() -> Robot:
    """The arm as its URDF says it is."""
    return Robot.from_text(URDF, "small arm")


def runs(train: int = 2, test: int = 1, duration: float = 8.0) -> tuple[list[Trajectory], list[Trajectory]]:
    """Logs of the arm with what is hidden: 400 Hz, ``q`` and ``tau``."""
    return excitations(arm(), HIDDEN, train=train, test=test, duration=duration, rate=400.0)


def write_logs(folder: Path) -> Path:
    """``robot.urdf``, ``train_1.parquet``, ``train_2.parquet`` and ``test_1.parquet`` in ``folder``."""
    return write_folder(folder, URDF, *runs())


def write_folder(folder: Path, urdf: str, train: list[Trajectory], test: list[Trajectory]) -> Path:
    """``robot.urdf`` and a Parquet log a run in ``folder``."""
    (folder / "robot.urdf").write_text(urdf, encoding="utf-8")
    for run in (*train, *test):
        write_log(folder / f"{run.name}.parquet", run, Robot.from_text(urdf, "robot.urdf").joint_names)
    return folder
