"""How far the held-out runs leave what was seen in training: the first question when a model fails on them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hybrid_dynamics.features import FEATURES, feature_matrix
from hybrid_dynamics.trajectory import Trajectory, iter_trajectories
from hybrid_dynamics.types import Array


@dataclass(frozen=True)
class Extrapolation:
    """``distance``: root-mean-square Mahalanobis distance of the held-out features, per direction (training rows: 1).

    ``outside``: share of held-out samples in which at least one feature lies outside its training range.
    """

    distance: float
    outside: float


def extrapolation(features: Path) -> Extrapolation | None:
    """Compare the ``test`` runs of ``features.parquet`` with its ``train`` runs; None where either is missing.

    Two passes, one trajectory in memory at a time.
    """
    moments = _moments(iter_trajectories(features, "train", FEATURES))
    if moments is None:
        return None
    mean, spread, inverse_root, low, high = moments
    square, outside, count = 0.0, 0, 0
    for run in iter_trajectories(features, "test", FEATURES):
        X = feature_matrix(run)
        square += float(((((X - mean) / spread) @ inverse_root) ** 2).sum())
        outside += int(((low > X) | (high < X)).any(axis=1).sum())
        count += len(X)
    if not count:
        return None
    return Extrapolation((square / count / inverse_root.shape[1]) ** 0.5, outside / count)


def _moments(runs: Iterable[Trajectory]) -> tuple[Array, Array, Array, Array, Array] | None:
    """Mean, spread, whitening of the standardised features (directions that vary), and the range of each feature."""
    count = 0
    total, product = np.zeros(1), np.zeros((1, 1))
    low, high = np.array(np.inf), np.array(-np.inf)
    for run in runs:
        X = feature_matrix(run)
        count += len(X)
        total = total + X.sum(axis=0)
        product = product + X.T @ X
        low, high = np.minimum(low, X.min(axis=0)), np.maximum(high, X.max(axis=0))
    if not count:
        return None
    mean = total / count
    covariance = product / count - np.outer(mean, mean)
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    spread = np.where(spread > 1e-9, spread, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(spread, spread))
    kept = values > 1e-8 * values[-1]
    return mean, spread, vectors[:, kept] / np.sqrt(values[kept]), low, high
