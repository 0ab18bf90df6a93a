"""Classical identification: base parameters and physically consistent least squares, the baseline of the study."""

from hybrid_dynamics.identification.base_parameters import BaseParameters, base_parameters
from hybrid_dynamics.identification.least_squares import LeastSquares, LeastSquaresSettings
from hybrid_dynamics.identification.physical import is_physical, pseudo_inertia

__all__ = [
    "BaseParameters",
    "LeastSquares",
    "LeastSquaresSettings",
    "base_parameters",
    "is_physical",
    "pseudo_inertia",
]
