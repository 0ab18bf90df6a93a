"""The methods by name, as compositions of a few estimators (paper, Section "Methods compared")."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import sympy as sp

from hybrid_dynamics.errors import require
from hybrid_dynamics.models.base import Estimator, HybridEstimator, RigidBody
from hybrid_dynamics.models.factor import Factor
from hybrid_dynamics.models.network import NetworkEstimator, NetworkSettings
from hybrid_dynamics.models.sindy import SindyEstimator, SindySettings
from hybrid_dynamics.models.symbolic import SymbolicEstimator, SymbolicSettings

#: What a method is built on: the method whose fitted model is its first layer (None: it starts from nothing).
METHODS: dict[str, str | None] = {
    "rigid_body": None,
    "sr": None,
    "sindy": None,
    "r_sr": "rigid_body",
    "r_sindy": "rigid_body",
    "r_sindy_sr": "r_sindy_scaled",
    "nn": None,
    "r_nn": "rigid_body",
    "sindy_scaled": None,
    "r_sindy_scaled": "rigid_body",
    "r_sindy_sr_published": "r_sindy",
}
_LAYERS = {"r_sr": "sr", "r_sindy": "sindy", "r_sindy_sr": "sr", "r_nn": "nn"} | {
    "r_sindy_scaled": "sindy_scaled",
    "r_sindy_sr_published": "sr",
}


@dataclass(frozen=True)
class MethodSettings:
    """Settings of every kind of layer; a method uses those of its own layers."""

    sr: SymbolicSettings = field(default_factory=SymbolicSettings)
    sindy: SindySettings = field(default_factory=SindySettings)
    sindy_scaled: SindySettings = field(default_factory=lambda: SindySettings(threshold=1e-3, alpha=1e-6, scaled=True))
    nn: NetworkSettings = field(default_factory=NetworkSettings)

    def __post_init__(self) -> None:
        require(not self.sindy.scaled, "sindy.scaled is true; expected false (sindy_scaled is the scaled one)")
        require(self.sindy_scaled.scaled, "sindy_scaled.scaled is false; expected true (sindy is the published one)")


def build_estimator(
    method: str,
    settings: MethodSettings | None = None,
    *,
    base: Estimator | None = None,
    progress: Callable[..., Any] | None = None,
) -> Estimator:
    """The estimator of ``method``, not fitted. Raises :class:`ConfigError` for an unknown name.

    ``base``, a fitted model of the method that :data:`METHODS` names, is used as it stands for the first layer instead
    of fitting it again. ``progress`` is handed to the layers that take long (symbolic regression, network).
    """
    require(method in METHODS, f"method is {method!r}; expected one of {', '.join(METHODS)}")
    settings = settings or MethodSettings()
    below = METHODS[method]
    if below is None:
        return _layer(method, settings, progress)
    first = base if base is not None else build_estimator(below, settings, progress=progress)
    return HybridEstimator(first, _layer(_LAYERS[method], settings, progress), base_is_fitted=base is not None)


def fit_factor(method: str, settings: MethodSettings, factor: Factor) -> Estimator:
    """The fitted estimator of a SINDy ``method`` from the factor of its dataset (see :func:`factorize`)."""
    estimator = build_estimator(method, settings)
    if isinstance(estimator, SindyEstimator):
        return estimator.fit_factor(factor)
    require(
        isinstance(estimator, HybridEstimator)
        and isinstance(estimator.base, RigidBody)
        and isinstance(estimator.residual, SindyEstimator),
        f"method is {method!r}; expected a SINDy method (sindy, sindy_scaled, r_sindy, r_sindy_scaled)",
    )
    assert isinstance(estimator, HybridEstimator)
    assert isinstance(estimator.base, RigidBody)
    assert isinstance(estimator.residual, SindyEstimator)
    estimator.residual.fit_factor(factor.less_rigid_body())
    estimator.base.n_joints_ = estimator.n_joints_ = factor.n_joints
    return estimator


def _layer(name: str, settings: MethodSettings, progress: Callable[..., Any] | None) -> Estimator:
    if name == "rigid_body":
        return RigidBody()
    if name == "sr":
        return SymbolicEstimator(settings.sr, progress)
    if name == "nn":
        return NetworkEstimator(settings.nn, progress)
    return SindyEstimator(settings.sindy_scaled if name == "sindy_scaled" else settings.sindy)


def estimator_expressions(estimator: Estimator) -> list[sp.Expr] | None:
    """What was learned, one expression per joint over the features: the torque, or for a hybrid its learned residual.

    For a hybrid on the rigid body ``tau = tau_inertia + tau_coriolis + tau_gravity + expression``. ``None`` where some
    layer has no closed form (a network), and for the rigid body, which learns nothing.
    """
    if isinstance(estimator, SymbolicEstimator):
        return list(estimator.expressions_)
    if isinstance(estimator, SindyEstimator):
        return estimator.expressions()
    if isinstance(estimator, HybridEstimator):
        layers = [estimator_expressions(x) for x in (estimator.base, estimator.residual) if not _is_rigid(x)]
        if any(layer is None for layer in layers):
            return None
        return [sp.Add(*parts) for parts in zip(*(layer for layer in layers if layer is not None), strict=True)]
    return None


def _is_rigid(estimator: Estimator) -> bool:
    return isinstance(estimator, RigidBody)


def estimator_front(estimator: Estimator) -> list[dict[str, Any]]:
    """The kept Pareto front of the symbolic layers, as rows of a table; empty where there is none."""
    if isinstance(estimator, SymbolicEstimator):
        return [row.as_dict() for row in estimator.front_]
    if isinstance(estimator, HybridEstimator):
        return estimator_front(estimator.base) + estimator_front(estimator.residual)
    return []
