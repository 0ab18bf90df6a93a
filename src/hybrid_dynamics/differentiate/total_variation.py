"""Total-variation regularised differentiation (Chartrand 2011), in a form that is banded.

Chartrand minimises over the derivative u and the initial value x0

    1/2 integral (x0 + A u - x)^2 dt + alpha integral |u'| dt,      A = integration.

Discretised on the samples: u is constant on each interval, xi_0 = x0 is free, xi_{k+1} = xi_k + dt u_k exactly, so

    F = dt/2 sum_k (xi_k - x_k)^2 + alpha sum_k |u_{k+1} - u_k|
      = dt [ 1/2 |xi - x|^2 + lam |D xi|_1 ],      lam = alpha / dt^2,

with D the second difference: the same minimiser, and the unknown is the signal itself (:mod:`.tv_solver`). ``alpha``
does not depend on the sampling rate. The derivative is a staircase; at a sample it is the mean of the steps that meet.
"""

from __future__ import annotations

import numpy as np

from hybrid_dynamics.differentiate import tv_solver
from hybrid_dynamics.differentiate.method import DerivativeMethod
from hybrid_dynamics.errors import ConfigError
from hybrid_dynamics.types import Array


def objective(x_hat: Array, x: Array, dt: float, alpha: float) -> float:
    """F of a candidate ``x_hat`` (T,) for the signal ``x`` (T,)."""
    rates = np.diff(x_hat) / dt
    return float(0.5 * dt * np.sum((x_hat - x) ** 2) + alpha * np.sum(np.abs(np.diff(rates))))


def solve(x: Array, dt: float, alpha: float, tolerance: float = tv_solver.TOLERANCE) -> tv_solver.Solution:
    """Minimise F; ``objective`` and ``gap`` of the result are in units of F."""
    if len(x) < 4:
        raise ConfigError(f"total_variation: {len(x)} samples; expected at least 4")
    found = tv_solver.solve(np.asarray(x, float), alpha / dt**2, tolerance)
    return tv_solver.Solution(found.xi, dt * found.objective, dt * found.gap, found.iterations)


def _column(x: Array, dt: float, value: float, /, tolerance: float = tv_solver.TOLERANCE) -> tuple[Array, Array]:
    smooth = solve(x, dt, value, tolerance).xi
    steps = np.diff(smooth) / dt
    return smooth, np.concatenate([steps[:1], (steps[:-1] + steps[1:]) / 2, steps[-1:]])


def _candidates(x: Array, dt: float) -> Array:
    """Twelve values below the smallest alpha that turns the whole run into a straight line."""
    largest = tv_solver.straight(np.asarray(x, float)) * dt**2
    return np.geomspace(0.03 * largest, 1e-10 * largest, 12)


def _edge(value: float, dt: float) -> int:
    """No response, no transient of known length; the low-pass of the torque sets the trim."""
    return 0


#: ``total_variation(x, dt, alpha=..., criterion=..., tolerance=...)``.
METHOD = DerivativeMethod("total_variation", "alpha", _column, _candidates, None, ("tolerance",), _edge, 0.1)
