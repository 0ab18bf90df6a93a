"""Derivatives of measured motion.

Whole runs: :func:`differentiate_trajectory`. Single signals: ``get_method(name)(x, dt, **options) -> (x_hat, dx_hat)``,
and :func:`derivatives` for position -> velocity -> acceleration -> jerk. :func:`derivative_errors` compares methods.
"""

from hybrid_dynamics.differentiate.chain import Chain, derivatives
from hybrid_dynamics.differentiate.evaluation import derivative_errors
from hybrid_dynamics.differentiate.method import Method
from hybrid_dynamics.differentiate.registry import METHODS, get_method
from hybrid_dynamics.differentiate.settings import DifferentiateSettings
from hybrid_dynamics.differentiate.trajectory import differentiate_trajectory

__all__ = [
    "METHODS",
    "Chain",
    "DifferentiateSettings",
    "Method",
    "derivative_errors",
    "derivatives",
    "differentiate_trajectory",
    "get_method",
]
