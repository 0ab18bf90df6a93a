"""A small study for the tests of reporting and tracking: a Panda whose torque is rigid body + D dq."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd

from hybrid_dynamics.features import add_features
from hybrid_dynamics.files import write_text
from hybrid_dynamics.models import RigidBody, save_estimator
from hybrid_dynamics.robots import Robot, find_description, lock_joints
from hybrid_dynamics.study.evaluation import EvaluationSettings, evaluate_predictions
from hybrid_dynamics.trajectory import Trajectory, write_trajectories

DAMPING = np.array([6.75, 6.0, 5.25, 4.5, 3.75, 3.0, 2.25])
FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
SHORT = ("sr", "sindy_scaled", "r_sr", "r_sindy_scaled", "r_sindy_sr")


def write_dataset(
    folder: Path, provenance: str = "simulated", damping_error: float = 1e-4, runs: tuple[int, int] = (2, 2)
) -> Path:
    """Write every result file of one dataset to ``folder``; symbolic models are off by ``damping_error``."""
    folder.mkdir(parents=True, exist_ok=True)
    urdf = find_description("panda_description/urdf/panda.urdf")
    write_text(folder / "robot.urdf", lock_joints(urdf, FINGERS))
    robot = Robot.from_urdf(folder / "robot.urdf")
    names = [("train", f"train_{k}") for k in range(runs[0])] + [("test", f"test_{k}") for k in range(runs[1])]
    trajectories = [_trajectory(robot, name, split, seed) for seed, (split, name) in enumerate(names)]
    metadata: dict[str, object] = {"dataset": folder.name, "provenance": provenance}
    if folder.name == "panda":
        metadata["damping"] = DAMPING.tolist()
    recorded = [_keep(t, "q", "dq", "tau", "q_ref", "dq_ref") for t in trajectories]
    derived = [_keep(t, "q", "dq", "ddq", "dddq", "tau") for t in trajectories]
    write_trajectories(folder / "trajectories.parquet", recorded, metadata)
    write_trajectories(folder / "derivatives.parquet", derived, metadata)
    features = [add_features(robot, t) for t in derived]
    write_trajectories(folder / "features.parquet", features, metadata)

    rng = np.random.default_rng(3)
    noise = rng.standard_normal((7, 7))

    def rigid(t: Trajectory) -> np.ndarray:
        return t["tau_inertia"] + t["tau_coriolis"] + t["tau_gravity"]

    def exact(t: Trajectory) -> np.ndarray:
        return rigid(t) + (1 + damping_error) * DAMPING * t["dq"]

    def network(t: Trajectory) -> np.ndarray:
        size = 0.1 if t.split == "train" else 0.9
        return t["tau"] + size * np.sin(3 * t["q"] @ noise)

    predictors = {"rigid_body": rigid, **dict.fromkeys(SHORT, exact), "nn": network, "r_nn": network}
    evaluation = evaluate_predictions(
        predictors, iter(features), folder.name, provenance, EvaluationSettings(points=300)
    )
    evaluation.errors.to_parquet(folder / "errors.parquet")
    evaluation.predictions.to_parquet(folder / "predictions.parquet")
    for method in predictors:
        _write_model(folder, method, damping_error)
    return folder


def _keep(trajectory: Trajectory, *signals: str) -> Trajectory:
    return Trajectory(trajectory.name, trajectory.split, trajectory.time, {s: trajectory[s] for s in signals})


def _trajectory(robot: Robot, name: str, split: str, seed: int) -> Trajectory:
    rng = np.random.default_rng(seed)
    time = np.arange(600) * 0.01
    middle = np.array([0.0, -0.3, 0.0, -1.8, 0.0, 1.9, 0.6])
    q, dq, ddq, dddq = (np.zeros((600, 7)) for _ in range(4))
    q += middle
    for joint in range(7):
        for _ in range(3):
            a, w, p = rng.uniform(0.1, 0.25), 2 * np.pi * rng.uniform(0.2, 0.7), rng.uniform(0, 6)
            q[:, joint] += a * np.sin(w * time + p)
            dq[:, joint] += a * w * np.cos(w * time + p)
            ddq[:, joint] -= a * w**2 * np.sin(w * time + p)
            dddq[:, joint] -= a * w**3 * np.cos(w * time + p)
    tau = robot.inverse_dynamics(q, dq, ddq) + DAMPING * dq
    signals = {"q": q, "dq": dq, "ddq": ddq, "dddq": dddq, "tau": tau, "q_ref": q + 0.01, "dq_ref": dq}
    return Trajectory(name, split, time, signals)


def _write_model(folder: Path, method: str, damping_error: float) -> None:
    model = folder / "models" / method
    model.mkdir(parents=True, exist_ok=True)
    write_text(folder / "timing" / f"{method}.json", json.dumps({"wall_s": 1.25, "peak_memory_mb": 300.0}))
    rigid = RigidBody()
    rigid.n_joints_ = 7
    save_estimator(rigid, model)
    if method not in SHORT:
        return
    rows, fronts = [], []
    for j in range(1, 8):
        expression = f"{float((1 + damping_error) * DAMPING[j - 1])!r}*dq{j}"
        if not method.startswith("r_"):
            gravity = "" if j == 1 else f" + 1.0*tau_gravity{j}"
            expression = f"1.0*tau_inertia{j} + 1.0*tau_coriolis{j}{gravity} + {expression}"
        rows.append((j, "operon", expression, 3))
        fronts += [(j, 1, c, 10.0**-c, expression) for c in (1, 3, 5, 7)]
    pd.DataFrame(rows, columns=["joint", "engine", "expression", "complexity"]).to_csv(
        model / "expressions.csv", index=False
    )
    if "sr" in method:
        pd.DataFrame(fronts, columns=["joint", "round", "complexity", "loss", "expression"]).to_csv(
            model / "front.csv", index=False
        )
