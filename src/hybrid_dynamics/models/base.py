"""What every torque estimator shares: the feature matrix X, the rigid-body model, and the hybrid composition."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, RegressorMixin

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.features import FEATURES
from hybrid_dynamics.types import Array, Progress

if TYPE_CHECKING:
    import sympy as sp


@runtime_checkable
class Estimator(Protocol):
    """A torque model. ``X`` is (N, 7n) in SI units, ``y`` (N, n) [N m]; what was learned stands in ``..._``.

    ``variance`` (n,) [N^2 m^2] is the variance of the whole torque: a residual layer judges by it what is worth
    learning. It defaults to the variance of ``y``.
    """

    def fit(self, X: Array, y: Array, variance: Array | None = None) -> Self:
        """Learn ``y`` (N, n) [N m] from ``X`` (N, 7n); ``variance`` (n,) of the whole torque."""

    def predict(self, X: Array) -> Array:
        """Torque (N, n) [N m]."""

    def expressions(self) -> list[sp.Expr] | None:
        """What was learned, one expression a joint over the features: the torque, or of a hybrid its learned residual.

        For a hybrid on the rigid body ``tau = tau_inertia + tau_coriolis + tau_gravity + expression``. None where some
        layer has no closed form (a network), and for the rigid body, which learns nothing.
        """
        ...

    def front(self) -> list[dict[str, Any]]:
        """The kept Pareto front of symbolic layers, as rows of a table; empty where there is none."""
        ...

    @property
    def engine(self) -> str:
        """What found the expressions; empty where there are none."""
        ...


#: Arrays of a stored model that are too large for JSON, by name (safetensors).
Weights = dict[str, NDArray[np.float32]]


class LayerEstimator(Estimator, Protocol):
    """An estimator that a method may have as its layer: made from settings, kept as a JSON document and arrays."""

    settings_type: ClassVar[type]

    def __init__(self, settings: Any = None, progress: Progress | None = None) -> None: ...

    def document(self, weights: Weights, path: str) -> dict[str, Any]:
        """What was learned, as JSON values; large arrays go into ``weights`` under names that begin with ``path``."""
        ...

    @classmethod
    def from_document(cls, document: dict[str, Any], weights: Weights) -> Self:
        """Inverse of :meth:`document`: predicts the same numbers to the last bit."""
        ...


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

    def expressions(self) -> None:
        """None: nothing is learned."""
        return None

    def front(self) -> list[dict[str, Any]]:
        """Empty: nothing is searched for."""
        return []

    @property
    def engine(self) -> str:
        """The program that searched; none here."""
        return ""


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

    def expressions(self) -> list[sp.Expr] | None:
        """Sum of what the layers learned, the rigid body apart; see :meth:`Estimator.expressions`."""
        import sympy as sp

        layers = [layer.expressions() for layer in (self.base, self.residual) if not isinstance(layer, RigidBody)]
        known = [layer for layer in layers if layer is not None]
        return [sp.Add(*parts) for parts in zip(*known, strict=True)] if len(known) == len(layers) else None

    def front(self) -> list[dict[str, Any]]:
        """Of both layers."""
        return self.base.front() + self.residual.front()

    @property
    def engine(self) -> str:
        """Of the last layer."""
        return self.residual.engine
