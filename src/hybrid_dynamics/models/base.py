"""What every torque estimator shares: the feature matrix X, the rigid-body model, and the hybrid composition."""

from __future__ import annotations

from typing import Protocol, Self, runtime_checkable

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.features import FEATURES
from hybrid_dynamics.types import Array


@runtime_checkable
class Estimator(Protocol):
    """A torque model. ``X`` is (N, 7n) in SI units, ``y`` (N, n) [N m]; what was learned stands in ``..._``.

    ``variance`` (n,) [N^2 m^2] is the variance of the whole torque: a residual layer judges by it what is worth
    learning. It defaults to the variance of ``y``.
    """

    def fit(self, X: Array, y: Array, variance: Array | None = None) -> Self: ...

    def predict(self, X: Array) -> Array: ...


def check_features(X: Array, n_joints: int | None = None) -> Array:
    """``X`` as a finite float array (N, 7n); raises :class:`InputError` otherwise."""
    X = np.asarray(X, float)
    columns = f"{7 * n_joints} columns (7 per joint)" if n_joints is not None else "7 columns per joint"
    wrong = X.ndim != 2 or X.shape[1] % 7 or (n_joints is not None and X.shape[1] != 7 * n_joints)
    if wrong or X.shape[1] == 0:
        raise InputError(f"features X have shape {X.shape}; expected (samples, {columns}): {', '.join(FEATURES)}")
    _finite(X, "features X")
    return X


def check_data(X: Array, y: Array) -> tuple[Array, Array]:
    """``X`` (N, 7n) and ``y`` (N, n) as matching finite float arrays; raises :class:`InputError` otherwise."""
    y = np.asarray(y, float)
    if y.ndim != 2 or len(y) == 0:
        raise InputError(f"torque y has shape {y.shape}; expected (samples, joints) with at least one sample")
    X = check_features(X, y.shape[1])
    if len(X) != len(y):
        raise InputError(f"features X hold {len(X)} samples and torque y {len(y)}; expected as many")
    _finite(y, "torque y")
    return X, y


def _finite(values: Array, what: str) -> None:
    # One sum finds NaN and infinity without a temporary of the array's size; only then is the place looked for.
    if not np.isfinite(values.sum()):
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            row, column = bad[0]
            raise InputError(
                f"{what} hold {values[row, column]} in row {row + 1}, column {column + 1}; remove or repair the row"
            )


class RigidBody(RegressorMixin, BaseEstimator):
    """The rigid-body torque: M(q)ddq + C(q,dq)dq + g(q), read from X. Learns nothing."""

    def fit(self, X: Array, y: Array, variance: Array | None = None) -> Self:
        """Check the shapes; there is nothing to learn."""
        _, y = check_data(X, y)
        self.n_joints_ = y.shape[1]
        return self

    def predict(self, X: Array) -> Array:
        """(N, n) [N m]."""
        X = check_features(X)
        n = X.shape[1] // 7
        return X[:, 4 * n : 5 * n] + X[:, 5 * n : 6 * n] + X[:, 6 * n : 7 * n]


class HybridEstimator(RegressorMixin, BaseEstimator):
    """``base`` first, then ``residual`` on what ``base`` leaves: tau = base(x) + residual(x).

    Nested it gives the paper's r-SINDy-SR (Section "Methods compared"). With ``base_is_fitted`` the base is used as it
    stands (the paper keeps the first layers fixed), so that a stage can build on the model another stage has trained.
    """

    def __init__(self, base: Estimator, residual: Estimator, base_is_fitted: bool = False) -> None:
        self.base = base
        self.residual = residual
        self.base_is_fitted = base_is_fitted

    def fit(self, X: Array, y: Array, variance: Array | None = None) -> Self:
        """Fit both layers; ``variance`` (n,) [N^2 m^2] of the whole torque is handed on to them."""
        X, y = check_data(X, y)
        if variance is None:
            variance = np.var(y, axis=0)
        if not self.base_is_fitted:
            self.base.fit(X, y, variance)
        self.residual.fit(X, y - self.base.predict(X), variance)
        self.n_joints_ = y.shape[1]
        return self

    def predict(self, X: Array) -> Array:
        """(N, n) [N m]."""
        return self.base.predict(X) + self.residual.predict(X)
