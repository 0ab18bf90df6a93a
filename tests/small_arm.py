"""The examples' two-joint arm and logs of it, for tests and for the examples in docstrings: small, planar, exact."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from examples.demo_arm import HIDDEN, URDF

from hybrid_dynamics.effects import Effect, family, predict
from hybrid_dynamics.readers import write_log
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.excitation import excitations
from hybrid_dynamics.trajectory import Trajectory

__all__ = ["HIDDEN", "URDF", "arm", "heavier_links", "noisy_log", "runs", "write_folder", "write_logs"]


def arm() -> Robot:
    """The arm as its URDF says it is."""
    return Robot.from_text(URDF, "small arm")


def heavier_links(share: float) -> Effect:
    """All links of the arm heavier by ``share``, as the loop would name it."""
    robot = arm()
    (term,) = family("inertial_parameters").terms(robot, np.ones(2, bool), {})
    inertias = [robot.model.inertias[i].toDynamicParameters() for i in robot.joint_ids]
    values = term.family().parameters_of(share * np.concatenate(inertias), robot, term)
    return Effect("inertial_parameters", (), values, dict(term.settings))


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


def noisy_log(effects: Sequence[Effect], seed: int, split: str, noise: float) -> Trajectory:
    """20 s at 200 Hz of sums of three sines, the arm with ``effects``, white noise of ``noise`` [N m]."""
    rng = np.random.default_rng(seed)
    time = np.arange(4000) / 200.0
    speed = np.array([[0.9, 1.7, 3.1], [1.1, 2.3, 3.7]])
    phase = rng.uniform(0, 2 * np.pi, (2, 3))
    q = np.einsum("k,jkt->tj", [0.5, 0.25, 0.1], np.sin(speed[..., None] * time + phase[..., None]))
    dq = np.gradient(q, time, axis=0)
    tau = predict(arm(), effects, q, dq, np.gradient(dq, time, axis=0), time)
    signals = {"q": q, "dq": dq, "tau": tau + noise * rng.normal(size=tau.shape)}
    return Trajectory(f"{split}_{seed}", split, time, signals)
