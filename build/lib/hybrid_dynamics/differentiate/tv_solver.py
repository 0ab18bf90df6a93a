"""Least squares with a penalty on the sum of absolute second differences, solved in O(N) with a certified gap.

    minimise over xi (N,)   F(xi) = 1/2 |xi - y|^2 + lam |D xi|_1,      (D xi)_k = xi_k - 2 xi_{k+1} + xi_{k+2}

Its dual is the box-constrained quadratic programme min 1/2 |D' nu|^2 - nu' D y, |nu_k| <= lam, with xi = y - D' nu
(Kim, Koh, Boyd, Gorinevsky: l1 trend filtering, SIAM Review 51, 2009). A primal-dual interior-point method with
Mehrotra's predictor-corrector solves it; each step factorises one matrix of five diagonals. For every feasible nu

    F(xi) - F* <= F(xi) - dual(nu) = sum_k ( lam |(D xi)_k| - nu_k (D xi)_k ),

a sum of terms none of which is negative, so the gap is had without cancellation and is a proof, not an estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from hybrid_dynamics.errors import ConfigError
from hybrid_dynamics.types import Array

#: Relative duality gap at which the iteration stops, and the largest with which it may end when rounding stops it.
TOLERANCE = 1e-10
ACCEPTED = 1e-6
MAX_ITERATIONS = 200
#: Iterations in a row that do not halve the gap, after which rounding is taken to have the last word; ten times as many
#: before the gap is acceptable.
STALLED = 4


@dataclass(frozen=True)
class Solution:
    """Minimiser ``xi`` (N,), objective F(xi), proven bound ``gap`` >= F(xi) - F*, number of ``iterations``."""

    xi: Array
    objective: float
    gap: float
    iterations: int


def second_difference(x: Array) -> Array:
    """D x: (N,) -> (N - 2,)."""
    return np.diff(x, 2)


def second_difference_transposed(nu: Array) -> Array:
    """D' nu: (N - 2,) -> (N,)."""
    out = np.zeros(len(nu) + 2)
    out[:-2] = nu
    out[1:-1] -= 2 * nu
    out[2:] += nu
    return out


def solve(y: Array, lam: float, tolerance: float = TOLERANCE) -> Solution:
    """Minimise F for ``y`` (N,) and ``lam`` > 0 (unit of ``y``) to a relative duality gap of ``tolerance``.

    Raises :class:`ConfigError` where rounding leaves a relative gap above 1e-6: ``lam`` so large that the solution is
    straight over thousands of samples.
    """
    line, rest = _split_line(y)
    scale = float(np.max(np.abs(rest)))
    if scale <= np.finfo(float).eps * float(np.max(np.abs(y), initial=0.0)) * len(y):
        return Solution(y.copy(), 0.0, 0.0, 0)
    # D' nu = rest has exactly one solution, a double cumulative sum; where it is feasible, the line is the minimiser.
    nu = np.cumsum(np.cumsum(rest))[:-2]
    if np.max(np.abs(nu)) <= lam:
        return Solution(line, float(0.5 * np.sum(rest**2)), 0.0, 0)
    xi, gap, iterations = _interior_point(rest / scale, lam / scale, tolerance)
    z = second_difference(xi)
    objective = 0.5 * float(np.sum((xi - rest / scale) ** 2)) + lam / scale * float(np.sum(np.abs(z)))
    if gap > max(ACCEPTED, tolerance) * objective:
        raise ConfigError(
            f"alpha is too large for these data: the minimiser is straight over so many samples that rounding leaves a "
            f"relative duality gap of {gap / objective:.1e}; choose a smaller alpha"
        )
    return Solution(line + scale * xi, scale**2 * objective, scale**2 * gap, iterations)


def straight(y: Array) -> float:
    """Smallest ``lam`` whose minimiser is the least-squares line through ``y``."""
    return float(np.max(np.abs(np.cumsum(np.cumsum(_split_line(y)[1]))[:-2])))


def _split_line(y: Array) -> tuple[Array, Array]:
    """The least-squares line through ``y`` and what is left."""
    t = np.linspace(-1, 1, len(y))
    line = np.mean(y) + t * _dot(t, y) / _dot(t, t)
    rest = y - line
    rest -= np.mean(rest) + t * _dot(t, rest) / _dot(t, t)
    return y - rest, rest


def _interior_point(y: Array, lam: float, tolerance: float) -> tuple[Array, float, int]:
    """Dual interior-point iteration; ``xi``, gap and number of steps of the best feasible point."""
    m = len(y) - 2
    nu = np.zeros(m)
    z = second_difference(y)
    spread = float(np.mean(np.abs(z))) + np.finfo(float).tiny
    # Multipliers of nu <= lam and nu >= -lam; their difference is D xi at the solution, and here from the start.
    upper, lower = np.maximum(z, 0) + spread, np.maximum(-z, 0) + spread
    # The distances of nu from its bounds are updated, not subtracted: near a bound only they keep their digits.
    room_up, room_low = np.full(m, lam), np.full(m, lam)
    bands = np.empty((3, m), order="F")
    best, best_gap, best_objective, stalled = y, np.inf, np.inf, 0
    for iteration in range(MAX_ITERATIONS):
        xi = y - second_difference_transposed(nu)
        z = second_difference(xi)
        gap = float(np.sum(lam * np.abs(z) - nu * z))
        stalled = stalled + 1 if gap > 0.5 * best_gap else 0
        if gap < best_gap:
            best, best_gap = xi, gap
            best_objective = 0.5 * float(np.sum((y - xi) ** 2)) + lam * float(np.sum(np.abs(z)))
        patience = STALLED if best_gap <= ACCEPTED * best_objective else 10 * STALLED
        if best_gap <= tolerance * best_objective or stalled >= patience:
            return best, best_gap, iteration
        mu = (_dot(upper, room_up) + _dot(lower, room_low)) / (2 * m)
        slope_up, slope_low = upper / room_up, lower / room_low
        bands[0] = 6 + slope_up + slope_low
        bands[1] = -4
        bands[2] = 1
        factor, info = lapack.dpbtrf(bands, lower=1)
        if info != 0:
            return best, best_gap, iteration
        # Predictor: straight for complementarity zero.
        step = lapack.dpbtrs(factor, z, lower=1)[0]
        d_upper = slope_up * step - upper
        d_lower = -slope_low * step - lower
        length = _step_length(step, room_up, room_low, d_upper / upper, d_lower / lower)
        mu_ahead = (
            _dot(upper + length * d_upper, room_up - length * step)
            + _dot(lower + length * d_lower, room_low + length * step)
        ) / (2 * m)
        # Corrector: aim at a smaller complementarity, with the predictor's second-order terms taken off.
        target = mu * (mu_ahead / mu) ** 3
        aim_up = (target + step * d_upper) / room_up
        aim_low = (target - step * d_lower) / room_low
        step = lapack.dpbtrs(factor, z - aim_up + aim_low, lower=1)[0]
        d_upper = aim_up - upper + slope_up * step
        d_lower = aim_low - lower - slope_low * step
        length = 0.995 * _step_length(step, room_up, room_low, d_upper / upper, d_lower / lower)
        room_up, room_low = room_up - length * step, room_low + length * step
        upper, lower = upper + length * d_upper, lower + length * d_lower
        nu = np.clip(nu + length * step, -lam, lam)
    return best, best_gap, MAX_ITERATIONS


def _dot(a: Array, b: Array) -> float:
    """Inner product without BLAS, whose threads cost far more than they save here when the cores are busy."""
    return float(np.einsum("i,i", a, b))


def _step_length(step: Array, room_up: Array, room_low: Array, rel_upper: Array, rel_lower: Array) -> float:
    """Longest step (at most 1/0.995) that keeps nu in its box and the multipliers positive."""
    shrink = max(
        float(np.max(step / room_up)),
        float(-np.min(step / room_low)),
        float(-np.min(rel_upper)),
        float(-np.min(rel_lower)),
        0.995,
    )
    return 1.0 / shrink
