"""Symbolic regression of seven joints against pyoperon called directly with the same settings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

ROWS = 10_000
JOINTS = 7


def residual(side: str, evaluations: int) -> Callable[[], dict[str, Any]]:
    """What a rigid body leaves: viscous friction, with noise; ``evaluations`` a joint, one worker on both sides."""
    from hybrid_dynamics.models import SymbolicSettings

    rng = np.random.default_rng(0)
    X = rng.normal(size=(ROWS, 7 * JOINTS))
    y = X[:, 7:14] * np.linspace(6.75, 2.25, JOINTS) + 1e-3 * rng.normal(size=(ROWS, JOINTS))
    settings = SymbolicSettings(evaluations=evaluations, workers=1)
    return (lambda: _ours(X, y, settings)) if side == "ours" else (lambda: _peer(X, y, settings))


def _ours(X: np.ndarray, y: np.ndarray, settings: Any) -> dict[str, Any]:
    from hybrid_dynamics.models import SymbolicEstimator

    predicted = SymbolicEstimator(settings).fit(X, y).predict(X)
    return {"relative_error": float(np.linalg.norm(predicted - y) / np.linalg.norm(y))}


def _peer(X: np.ndarray, y: np.ndarray, settings: Any) -> dict[str, Any]:
    from pyoperon.sklearn import SymbolicRegressor

    predicted = np.empty_like(y)
    rows = np.random.default_rng(0).choice(len(X), min(settings.batch, len(X)), replace=False)
    for j in range(y.shape[1]):
        regressor = SymbolicRegressor(
            allowed_symbols=",".join([*(s for s in settings.operators if s != "sign"), "constant", "variable"]),
            objectives=["mse", "length"],
            optimizer_iterations=1,
            population_size=settings.population,
            max_evaluations=settings.evaluations,
            generations=settings.evaluations,
            max_length=settings.max_length,
            epsilon=1e-14,
            n_threads=1,
            random_state=j,
        )
        predicted[:, j] = np.asarray(regressor.fit(X[rows], y[rows, j]).predict(X)).ravel()
    return {"relative_error": float(np.linalg.norm(predicted - y) / np.linalg.norm(y))}
