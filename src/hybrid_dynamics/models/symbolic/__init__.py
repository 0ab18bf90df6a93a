"""Symbolic regression: two engines behind one interface, constants re-fitted, small terms dropped, the front kept."""

from hybrid_dynamics.models.symbolic.engines import Engine
from hybrid_dynamics.models.symbolic.estimator import SymbolicEstimator
from hybrid_dynamics.models.symbolic.registry import make_engine
from hybrid_dynamics.models.symbolic.search import symbolic_regression
from hybrid_dynamics.models.symbolic.settings import Candidate, FrontRow, SymbolicResult, SymbolicSettings

__all__ = [
    "Candidate",
    "Engine",
    "FrontRow",
    "SymbolicEstimator",
    "SymbolicResult",
    "SymbolicSettings",
    "make_engine",
    "symbolic_regression",
]
