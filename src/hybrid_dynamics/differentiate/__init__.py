"""Derivatives of measured motion.

Whole runs: :func:`differentiate_trajectory`. Single signals: :func:`get_differentiator`, whose result is called as
``(x, dt, **options) -> (x_hat, dx_hat)``, and :func:`derivatives` for position -> velocity -> acceleration -> jerk.
:func:`derivative_errors` compares methods.
"""

from hybrid_dynamics.differentiate.chain import Chain, derivatives
from hybrid_dynamics.differentiate.evaluation import derivative_errors
from hybrid_dynamics.differentiate.method import DerivativeMethod
from hybrid_dynamics.differentiate.registry import DIFFERENTIATORS, get_differentiator
from hybrid_dynamics.differentiate.settings import DifferentiateSettings
from hybrid_dynamics.differentiate.trajectory import differentiate_trajectory

__all__ = [
    "DIFFERENTIATORS",
    "Chain",
    "DerivativeMethod",
    "DifferentiateSettings",
    "derivative_errors",
    "derivatives",
    "differentiate_trajectory",
    "get_differentiator",
]
