"""SINDy with a quadratic library of 49 features: PySINDy on the whole library against its STLSQ on our factor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

JOINTS = 7
THRESHOLD, ALPHA = 0.01, 1e-4


def data(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Features (rows, 49) of sizes from 1e-2 to 30, as those of an arm, and a sparse torque (rows, 7) with noise."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(rows, 7 * JOINTS)) * np.repeat([1.0, 1.0, 3.0, 30.0, 1.0, 0.5, 5.0], JOINTS)
    y = np.stack([X[:, 28 + j] + X[:, 35 + j] + X[:, 42 + j] + (3 - 0.3 * j) * X[:, 7 + j] for j in range(JOINTS)], 1)
    return X, y + 0.2 * X[:, :1] * X[:, 7:14] + 0.05 * rng.normal(size=y.shape)


def fit(side: str, rows: int) -> Callable[[], dict[str, Any]]:
    X, y = data(rows)
    return (lambda: _ours(X, y)) if side == "ours" else (lambda: _peer(X, y))


def _summary(coefficients: np.ndarray) -> dict[str, Any]:
    return {"terms": int(np.count_nonzero(coefficients)), "sum": float(np.abs(coefficients).sum())}


def _ours(X: np.ndarray, y: np.ndarray) -> dict[str, Any]:
    from hybrid_dynamics.models import SindyEstimator, SindySettings

    return _summary(SindyEstimator(SindySettings(threshold=THRESHOLD, alpha=ALPHA)).fit(X, y).coef_)


def _peer(X: np.ndarray, y: np.ndarray) -> dict[str, Any]:
    from pysindy.feature_library import PolynomialLibrary
    from pysindy.optimizers import STLSQ

    theta = np.asarray(PolynomialLibrary(degree=2).fit_transform(X))
    return _summary(STLSQ(threshold=THRESHOLD, alpha=ALPHA, max_iter=100).fit(theta, y).coef_)
