"""Torque models shaped like scikit-learn's: ``fit(X, y)``, ``predict(X)``, learned state in names that end in ``_``."""

from hybrid_dynamics.features import feature_names
from hybrid_dynamics.models.base import Estimator, HybridEstimator, RigidBody
from hybrid_dynamics.models.expressions import CompiledExpressions, complexity, format_expression, parse_expression
from hybrid_dynamics.models.factor import Factor
from hybrid_dynamics.models.methods import (
    METHODS,
    MethodSettings,
    build_estimator,
    estimator_expressions,
    estimator_front,
    fit_factor,
)
from hybrid_dynamics.models.network import NetworkEstimator, NetworkSettings
from hybrid_dynamics.models.sindy import SindyEstimator, SindySettings, factorize
from hybrid_dynamics.models.storage import load_estimator, save_estimator
from hybrid_dynamics.models.symbolic import (
    SymbolicEstimator,
    SymbolicResult,
    SymbolicSettings,
    symbolic_regression,
)

__all__ = [
    "METHODS",
    "CompiledExpressions",
    "Estimator",
    "Factor",
    "HybridEstimator",
    "MethodSettings",
    "NetworkEstimator",
    "NetworkSettings",
    "RigidBody",
    "SindyEstimator",
    "SindySettings",
    "SymbolicEstimator",
    "SymbolicResult",
    "SymbolicSettings",
    "build_estimator",
    "complexity",
    "estimator_expressions",
    "estimator_front",
    "factorize",
    "feature_names",
    "fit_factor",
    "format_expression",
    "load_estimator",
    "parse_expression",
    "save_estimator",
    "symbolic_regression",
]
