"""Errors of every method on every trajectory and on the pool, one trajectory in memory at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from hybrid_dynamics.errors import InputError, require
from hybrid_dynamics.metrics import Errors, torque_errors
from hybrid_dynamics.study.layout import POOL
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: Trajectory -> predicted torque (T, n) [N m].
Predictor = Callable[[Trajectory], Array]

ERROR_COLUMNS = (
    "dataset",
    "provenance",
    "split",
    "trajectory",
    "method",
    "joint",
    "rmse",
    "relative_rmse",
    "relative_error",
)


@dataclass(frozen=True)
class EvaluationSettings:
    """How many predictions are kept for the figures: ``points`` a run, of the first ``runs_per_split`` runs."""

    points: int = 1500
    runs_per_split: int = 1

    def __post_init__(self) -> None:
        require(2 <= self.points <= 100_000, f"evaluate.points is {self.points}; expected 2 to 100000")
        require(
            0 <= self.runs_per_split <= 1000, f"evaluate.runs_per_split is {self.runs_per_split}; expected 0 to 1000"
        )


@dataclass(frozen=True)
class Evaluation:
    """``errors``: a row per split, trajectory (and the pool, ``all``), method and joint (:data:`ERROR_COLUMNS`).

    ``predictions``: ``trajectory split method time tau1..n tau_hat1..n`` [s, N m], decimated, for figures only.
    """

    errors: pd.DataFrame
    predictions: pd.DataFrame


class PooledErrors:
    """The three error measures of runs seen one after the other; equal to those of the runs laid end to end.

    The mean and the sum of squares about it are merged by Chan, Golub and LeVeque's update (1979), which does not
    cancel when the torque's mean is large against its spread.
    """

    def __init__(self, n_joints: int) -> None:
        self._count = 0
        self._mean = np.zeros(n_joints)
        self._about_mean = np.zeros(n_joints)
        self._square = 0.0
        self._error_square = np.zeros(n_joints)

    def add(self, tau: Array, tau_hat: Array) -> None:
        """Take in one run: measured and predicted torque (T, n) [N m]."""
        count = len(tau)
        mean = tau.mean(axis=0)
        total = self._count + count
        shift = mean - self._mean
        self._about_mean += ((tau - mean) ** 2).sum(axis=0) + shift**2 * self._count * count / total
        self._mean = self._mean + shift * count / total
        self._square += float((tau**2).sum())
        self._error_square += ((tau - tau_hat) ** 2).sum(axis=0)
        self._count = total

    def errors(self) -> Errors:
        """Errors over everything seen so far (see :func:`hybrid_dynamics.metrics.torque_errors`)."""
        rmse = np.sqrt(self._error_square / max(self._count, 1))
        spread = np.sqrt(self._about_mean / max(self._count, 1))
        relative = np.divide(rmse, spread, out=np.full_like(rmse, np.nan), where=spread > 0)
        size = self._square**0.5
        return Errors(rmse, relative, float(self._error_square.sum()) ** 0.5 / size if size > 0 else float("nan"))


def evaluate_predictions(
    predictors: Mapping[str, Predictor],
    trajectories: Iterable[Trajectory],
    dataset: str,
    provenance: str,
    settings: EvaluationSettings | None = None,
) -> Evaluation:
    """Errors of ``predictors`` (method -> predictor) on ``trajectories``, which are consumed one by one.

    Every trajectory must hold ``tau``. Raises :class:`InputError` where a prediction has the wrong shape or is not
    finite, naming the method and the trajectory.
    """
    settings = settings or EvaluationSettings()
    rows: list[tuple[object, ...]] = []
    kept: list[pd.DataFrame] = []
    pools: dict[tuple[str, str], PooledErrors] = {}
    seen = {"train": 0, "test": 0}
    for trajectory in trajectories:
        tau, split = trajectory["tau"], trajectory.split
        step = max(1, -(-len(tau) // settings.points))
        for method, predict in predictors.items():
            tau_hat = _checked(predict(trajectory), tau, method, trajectory.name)
            rows += _rows(dataset, provenance, split, trajectory.name, method, torque_errors(tau, tau_hat))
            pools.setdefault((split, method), PooledErrors(tau.shape[1])).add(tau, tau_hat)
            if seen[split] < settings.runs_per_split:
                kept.append(_decimated(trajectory, method, tau_hat, step))
        seen[split] += 1
    if not rows:
        raise InputError(f"dataset {dataset}: no trajectory to evaluate; run the stage featurize (dvc repro)")
    for (split, method), pool in pools.items():
        rows += _rows(dataset, provenance, split, POOL, method, pool.errors())
    errors = pd.DataFrame(rows, columns=list(ERROR_COLUMNS))
    return Evaluation(errors, pd.concat(kept, ignore_index=True) if kept else pd.DataFrame())


def _checked(tau_hat: Array, tau: Array, method: str, trajectory: str) -> Array:
    tau_hat = np.asarray(tau_hat, float)
    if tau_hat.shape != tau.shape:
        raise InputError(
            f"method {method}, trajectory {trajectory}: prediction has shape {tau_hat.shape}; expected {tau.shape}"
        )
    if not np.isfinite(tau_hat).all():
        row, joint = np.argwhere(~np.isfinite(tau_hat))[0]
        raise InputError(
            f"method {method}, trajectory {trajectory}: prediction of joint {joint + 1} is "
            f"{tau_hat[row, joint]} at row {row + 1}; train the method again (dvc repro)"
        )
    return tau_hat


def _rows(
    dataset: str, provenance: str, split: str, trajectory: str, method: str, errors: Errors
) -> list[tuple[object, ...]]:
    return [
        (
            dataset,
            provenance,
            split,
            trajectory,
            method,
            joint + 1,
            float(errors.rmse[joint]),
            float(errors.relative_rmse[joint]),
            errors.relative_error,
        )
        for joint in range(len(errors.rmse))
    ]


def _decimated(trajectory: Trajectory, method: str, tau_hat: Array, step: int) -> pd.DataFrame:
    rows = slice(None, None, step)
    columns: dict[str, object] = {
        "trajectory": trajectory.name,
        "split": trajectory.split,
        "method": method,
        "time": trajectory.time[rows],
    }
    for name, values in (("tau", trajectory["tau"]), ("tau_hat", tau_hat)):
        columns |= {f"{name}{j + 1}": values[rows, j] for j in range(values.shape[1])}
    return pd.DataFrame(columns)
