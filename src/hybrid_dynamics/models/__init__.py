"""Torque models shaped like scikit-learn's: ``fit(X, y)``, ``predict(X)``, learned state in names that end in ``_``."""

from hybrid_dynamics.models.base import (
    FEATURE_GROUPS,
    Estimator,
    HybridEstimator,
    RigidBody,
    feature_names,
)
from hybrid_dynamics.models.sindy import SindyEstimator, SindySettings

__all__ = [
    "FEATURE_GROUPS",
    "Estimator",
    "HybridEstimator",
    "RigidBody",
    "SindyEstimator",
    "SindySettings",
    "feature_names",
]
