"""Derivatives of measured motion: whole runs (:func:`differentiate_trajectory`) and single signals."""

from hybrid_dynamics.differentiate.settings import DifferentiateSettings
from hybrid_dynamics.differentiate.trajectory import differentiate_trajectory

__all__ = ["DifferentiateSettings", "differentiate_trajectory"]
