"""Cubic smoothing spline: minimise sum (s(t_k) - x_k)^2 + lambda integral s''(t)^2 dt (Reinsch 1967)."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solveh_banded

from hybrid_dynamics.differentiate.method import DerivativeMethod, cutoff_candidates
from hybrid_dynamics.types import Array


def _column(x: Array, dt: float, value: float, /) -> tuple[Array, Array]:
    """Reinsch's equations in samples, O(T): (R + lambda Q'Q) gamma = Q' x, s = x - lambda Q gamma.

    gamma are the second derivatives at the inner samples (zero at the ends), Q' the second difference, R the Gram
    matrix of the hat functions. The response is one half at ``value`` [Hz]: lambda = (2 pi value dt)^-4 in samples.
    """
    penalty = (2 * np.pi * value * dt) ** -4.0
    inner = len(x) - 2
    bands = np.empty((3, inner))
    bands[0] = 2 / 3 + 6 * penalty
    bands[1] = 1 / 6 - 4 * penalty
    bands[2] = penalty
    gamma = np.zeros(len(x))
    gamma[1:-1] = solveh_banded(bands, np.diff(x, 2), lower=True, check_finite=False)
    smooth = x.copy()
    smooth[:-2] -= penalty * gamma[1:-1]
    smooth[1:-1] += 2 * penalty * gamma[1:-1]
    smooth[2:] -= penalty * gamma[1:-1]
    # Slope of the cubic piece at its left end, and of the last piece at its right end.
    slope = np.empty(len(x))
    slope[:-1] = np.diff(smooth) - (2 * gamma[:-1] + gamma[1:]) / 6
    slope[-1] = smooth[-1] - smooth[-2] + (gamma[-2] + 2 * gamma[-1]) / 6
    return smooth, slope / dt


def _response(frequency: Array, dt: float, value: float) -> Array:
    """Exact for an endless signal: Q'Q and R of Reinsch's equations are sines, the slope is that of the spline."""
    angle = 2 * np.pi * frequency * dt
    second = 2 - 2 * np.cos(angle)
    gram = (2 + np.cos(angle)) / 3
    smooth = 1 / (1 + (2 * np.pi * value * dt) ** -4.0 * second**2 / gram)
    slope = np.ones_like(angle)
    slope[angle > 0] = 3 * np.sin(angle[angle > 0]) / ((2 + np.cos(angle[angle > 0])) * angle[angle > 0])
    return np.asarray(smooth * slope)


#: ``spline(x, dt, cutoff_hz=...)``: cubic smoothing spline whose response is one half at ``cutoff_hz``.
METHOD = DerivativeMethod("spline", "cutoff_hz", _column, cutoff_candidates, _response)
