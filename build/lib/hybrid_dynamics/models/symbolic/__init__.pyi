from .engines import Engine
from .estimator import SymbolicEstimator
from .registry import make_engine
from .search import symbolic_regression
from .settings import Candidate, FrontRow, SymbolicResult, SymbolicSettings

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
