"""The closed loop's models in MLflow's registry, and which of a dataset's versions is the champion.

A version is the champion because it predicts the held-out runs better than the one before. Both predict the runs that
are held out now: errors that were written down on other runs, or by other code, would not be comparable.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_dynamics.errors import HybridDynamicsError
from hybrid_dynamics.loop.model import load_model
from hybrid_dynamics.loop.prediction import predict
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.tracking.card import description
from hybrid_dynamics.trajectory import RECORDED, iter_trajectories
from hybrid_dynamics.types import Notify

CHAMPION = "champion"
ERROR_TAG = "held_out_relative_error"
ABOUT = "Closed loop: rigid body plus named effects. Every version has its own model card."
MODEL, URDF = "model.json", "robot.urdf"


def registered_name(dataset: str, provenance: str) -> str:
    """A recorded arm and its simulated twin are two things: one never replaces the other."""
    return f"hybrid_dynamics.{dataset}" + ("" if provenance == RECORDED else f".{provenance.replace(' ', '_')}")


def held_out_error(model: Path, urdf: Path, logs: Path) -> float:
    """Pooled relative error of ``model`` (model.json of the robot ``urdf``) on the test runs of ``logs``.

    Measured torque passes the filter that the prediction has passed. NaN where no run is held out.
    """
    completed = load_model(model, Robot.from_urdf(urdf))
    left, size = 0.0, 0.0
    for log in iter_trajectories(logs, split="test", require=("q", "tau")):
        prediction = predict(completed, log)
        assert prediction.measured_smooth is not None
        rows = prediction.covered
        left += float(np.sum((prediction.measured_smooth - prediction.tau)[rows] ** 2))
        size += float(np.sum(prediction.measured_smooth[rows] ** 2))
    return math.sqrt(left / size) if size > 0 else math.nan


def register(client: Any, name: str, logged: Any, run_id: str, card: str, tags: dict[str, str], error: float) -> str:
    """A new version of ``name`` from the logged model ``logged``, whose held-out error is ``error``."""
    from mlflow.exceptions import MlflowException

    try:
        client.get_registered_model(name)
    except MlflowException:
        client.create_registered_model(name, description=ABOUT)
    version = client.create_model_version(
        name,
        source=logged.model_uri,
        run_id=run_id,
        model_id=logged.model_id,
        description=description(card),
        tags={**tags, ERROR_TAG: repr(error)},
    )
    return str(version.version)


def crown(client: Any, name: str, version: str, error: float, logs: Path, notify: Notify = print) -> bool:
    """Make ``version`` the champion where it predicts the test runs of ``logs`` better than the champion does.

    The first version is the champion. A champion that cannot be asked (another robot, its files gone) stays, and it is
    said: whether it may go is no question of an error.
    """
    import mlflow
    from mlflow.exceptions import MlflowException

    try:
        champion = client.get_model_version_by_alias(name, CHAMPION)
    except MlflowException:
        client.set_registered_model_alias(name, CHAMPION, version)
        return True
    if champion.version == version:
        return False
    try:
        folder = Path(mlflow.artifacts.download_artifacts(f"models:/{name}/{champion.version}")) / "artifacts"
        before = held_out_error(folder / MODEL, folder / URDF, logs)
    except (HybridDynamicsError, MlflowException, OSError) as problem:
        reason = str(problem).splitlines()[0]
        notify(f"mlflow: {name}: version {champion.version} stays champion, it cannot be compared ({reason})")
        return False
    # Not a number (no run held out) is no improvement, and anything is one over it.
    better = error < before or (math.isnan(before) and not math.isnan(error))
    if better:
        client.set_registered_model_alias(name, CHAMPION, version)
    words = "is champion now" if better else f"does not replace version {champion.version}"
    notify(f"mlflow: {name}: version {version} {words}: held-out error {error:.4g}, champion's was {before:.4g}")
    return bool(better)
