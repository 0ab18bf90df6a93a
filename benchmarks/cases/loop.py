"""The command line and the loop: whole runs of the program, and growth with samples, runs and joints."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.data import arm, arm_urdf, log, write_csv, write_parquet
from hybrid_dynamics.trajectory import Trajectory

PROGRAM = [sys.executable, "-c", "from hybrid_dynamics.cli import main; main()"]


def show_help(side: str, size: int) -> Callable[[], dict[str, Any]]:
    return lambda: {"exit": subprocess.run([*PROGRAM, "--help"], capture_output=True, check=True).returncode}


def _program(
    joints: int, runs: int, seconds: float, rate: float, write: Callable[[Trajectory, Path], Path] = write_csv
) -> Callable[[], dict[str, Any]]:
    """``close-loop`` as a user calls it, logs as CSV, or as ``write`` writes them."""
    folder = Path(tempfile.mkdtemp(prefix="bench-"))
    robot = arm(joints)
    (folder / "arm.urdf").write_text(arm_urdf(joints))
    names = []
    for seed in range(runs):
        names.append(str(write(log(robot, seconds, rate, seed), folder)))
    command = [*PROGRAM, "close-loop", "--robot", str(folder / "arm.urdf"), "--out", str(folder / "out")]
    command += ["--train", *names[:-1], "--test", names[-1]]

    def run() -> dict[str, Any]:
        import json

        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(done.stderr.strip().splitlines()[-1])
        return {"verdict": json.loads((folder / "out" / "diagnosis.json").read_text())["verdict"]}

    return run


def small(side: str, size: int) -> Callable[[], dict[str, Any]]:
    """Two joints, two runs of ten seconds at 200 Hz."""
    return _program(2, 2, 10.0, 200.0)


def arm_500_hz(side: str, seconds: int) -> Callable[[], dict[str, Any]]:
    """Seven joints, four runs at 500 Hz, the whole catalogue."""
    return _program(7, 4, seconds, 500.0)


def arm_1_khz(side: str, seconds: int) -> Callable[[], dict[str, Any]]:
    """Seven joints, four runs at 1 kHz, the whole catalogue."""
    return _program(7, 4, seconds, 1000.0)


def _closed(joints: int, runs: int, seconds: float, rate: float = 250.0) -> Callable[[], dict[str, Any]]:
    from hybrid_dynamics import LoopSettings, close_loop

    robot = arm(joints)
    logs = [log(robot, seconds, rate, seed) for seed in range(runs)]
    settings = LoopSettings(effects=("viscous_friction", "coulomb_friction", "torque_offset", "armature"), longest=1e9)
    return lambda: {"effects": len(close_loop(robot, logs, [], settings).diagnosis.effects)}


def samples(side: str, size: int) -> Callable[[], dict[str, Any]]:
    """``size`` samples in four runs of three joints."""
    return _closed(3, 4, size / 4 / 250.0)


def runs(side: str, size: int) -> Callable[[], dict[str, Any]]:
    """``size`` runs of ten seconds, three joints."""
    return _closed(3, size, 10.0)


def joints(side: str, size: int) -> Callable[[], dict[str, Any]]:
    """``size`` joints, four runs of ten seconds."""
    return _closed(size, 4, 10.0)


def predict(side: str, samples: int) -> Callable[[], dict[str, Any]]:
    """Torque of a completed model along ``samples`` samples of seven joints."""
    import numpy as np

    from hybrid_dynamics import Model
    from hybrid_dynamics.loop.process import ProcessSettings, process

    robot = arm(7)
    run = log(robot, samples / 500.0, 500.0, 0)
    model = Model(robot)

    def go() -> dict[str, Any]:
        motion = process(run, robot, ProcessSettings()).motion
        return {"sum": float(np.abs(model.predict(motion.q, motion.dq, motion.ddq, motion.time)).sum())}

    return go


def many_hours(side: str, hours: int) -> Callable[[], dict[str, Any]]:
    """``close-loop`` on ``hours`` hours of seven joints at 500 Hz, a Parquet log a quarter of an hour, the whole
    catalogue."""
    return _program(7, 4 * hours, 900.0, 500.0, write_parquet)
