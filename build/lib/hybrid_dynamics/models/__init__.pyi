from .base import Estimator, HybridEstimator, RigidBody
from .expressions import CompiledExpressions, complexity, format_expression, parse_expression
from .factor import Factor
from .methods import METHODS, build_estimator, fit_factor
from .network import NetworkEstimator, NetworkSettings
from .sindy import SindyEstimator, SindySettings, factorize
from .storage import load_estimator, save_estimator
from .symbolic import (
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
    "factorize",
    "fit_factor",
    "format_expression",
    "load_estimator",
    "parse_expression",
    "save_estimator",
    "symbolic_regression",
]
