"""Constants and terms: all constants re-fitted together on all samples, small terms dropped.

An expression is a sum of terms ``c_k b_k(x)``. The outer constants c are linear: they come from a QR factorisation of
[b(x) y] (in chunks, so memory stays bounded). Constants inside a term (``exp(-3.1 x)``) come from Gauss-Newton.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares

from hybrid_dynamics.models.expressions import CompiledExpressions, complexity
from hybrid_dynamics.models.sindy import triangular_factor

Array = NDArray[np.float64]

#: A column whose share outside the span of the simpler ones is below this adds nothing a double can tell.
_DEPENDENT = 1e-9
_CHUNK_ROWS = 12_000
_NEWTON_ROWS = 50_000


@dataclass(frozen=True)
class Fit:
    """A re-fitted sum of terms: ``bases`` times ``coefficients``, and the mean squared error it leaves."""

    bases: tuple[sp.Expr, ...]
    coefficients: tuple[float, ...]
    mse: float

    @property
    def expression(self) -> sp.Expr:
        return sp.Add(*(sp.Float(c) * b for c, b in zip(self.coefficients, self.bases, strict=True)))


def expand(expression: sp.Expr) -> sp.Expr:
    """Multiply out products and integer powers; leave exponentials and logarithms whole."""
    return sp.expand(expression, power_base=False, power_exp=False, log=False)


def bases_of(expression: sp.Expr) -> list[sp.Expr]:
    """The terms of the expanded expression without their numeric factors."""
    return list(dict.fromkeys(term.as_coeff_Mul()[1] for term in sp.Add.make_args(expand(expression)) if term != 0))


def fit_terms(bases: Sequence[sp.Expr], X: Array, y: Array, names: Sequence[str], least: float, share: float) -> Fit:
    """Least squares over ``bases`` on all samples, then backward elimination.

    The term whose removal costs least is removed (the others re-fitted) while that cost is below
    ``least + share * (variance left unexplained)``, both in N^2 m^2.
    """
    ordered = sorted(dict.fromkeys(bases), key=lambda b: (complexity(b), str(b)))
    compiled = CompiledExpressions(ordered, names)
    count, samples = len(ordered), len(X)
    factor = triangular_factor(X, y[:, None], compiled, count, _CHUNK_ROWS) if count else np.array([[_norm(y)]])
    keep = _independent(factor, count)
    while True:
        values, costs, left = _solve(factor, keep, count)
        mse = left / samples
        if not len(keep) or costs.min() / samples >= least + share * mse:
            break
        keep = np.delete(keep, int(np.argmin(costs)))
    return Fit(tuple(ordered[k] for k in keep), tuple(float(v) for v in values), mse)


def _norm(y: Array) -> float:
    return float(np.linalg.norm(y))


def _independent(factor: Array, count: int) -> NDArray[np.intp]:
    """Columns that are finite, not zero, and not a combination of those before them (which are simpler)."""
    norms = np.linalg.norm(factor[:, :count], axis=0)
    keep = np.flatnonzero(np.isfinite(norms) & (norms > 0))
    while len(keep):
        scaled = factor[:, keep] / norms[keep]
        diagonal = np.abs(np.diag(np.linalg.qr(scaled, mode="r")))
        dependent = np.flatnonzero(diagonal < _DEPENDENT)
        if not len(dependent):
            break
        keep = np.delete(keep, dependent[0])
    return keep


def _solve(factor: Array, keep: NDArray[np.intp], count: int) -> tuple[Array, Array, float]:
    """Coefficients, the rise of the squared error when each is left out, and the squared error of all."""
    norms = np.linalg.norm(factor[:, keep], axis=0)
    r = np.asarray(np.linalg.qr(np.column_stack([factor[:, keep] / norms, factor[:, count]]), mode="r"))
    p = len(keep)
    left = float(np.sum(r[p:, p] ** 2))
    if p == 0:
        return np.zeros(0), np.zeros(0), left
    inverse = solve_triangular(r[:p, :p], np.eye(p))
    values = inverse @ r[:p, p]
    costs = values**2 / np.sum(inverse**2, axis=1)
    return values / norms, costs, left


def fit_constants(expression: sp.Expr, X: Array, y: Array, names: Sequence[str]) -> sp.Expr:
    """Gauss-Newton (Levenberg-Marquardt) over every decimal constant of ``expression``, inner ones included.

    Uses at most 50,000 evenly spaced samples; the outer constants are re-fitted on all samples afterwards. Gives the
    expression back unchanged where the fit does not improve.
    """
    constants = sorted(expression.atoms(sp.Float), key=float)
    if not constants or len(constants) >= len(X):
        return expression
    step = max(1, len(X) // _NEWTON_ROWS)
    inputs, target = X[::step], y[::step]
    parameters = [sp.Symbol(f"p_{k}", real=True) for k in range(len(constants))]
    pattern = expression.xreplace(dict(zip(constants, parameters, strict=True)))
    columns = [name for name in names if sp.Symbol(name, real=True) in expression.free_symbols]
    position = {name: k for k, name in enumerate(names)}
    data = [np.ascontiguousarray(inputs[:, position[name]]) for name in columns]
    arguments = [*parameters, *(sp.Symbol(name, real=True) for name in columns)]
    value = sp.lambdify(arguments, pattern, modules="numpy", cse=True)
    slope = sp.lambdify(arguments, [sp.diff(pattern, p) for p in parameters], modules="numpy", cse=True)

    def residual(p: Array) -> Array:
        with np.errstate(all="ignore"):
            error = value(*p, *data) - target
        return np.nan_to_num(np.broadcast_to(error, target.shape), nan=1e150, posinf=1e150, neginf=-1e150)

    def jacobian(p: Array) -> Array:
        with np.errstate(all="ignore"):
            parts = slope(*p, *data)
        return np.nan_to_num(np.column_stack([np.broadcast_to(part, target.shape) for part in parts]))

    start = np.array([float(c) for c in constants])
    scale = np.maximum(np.abs(start), 1e-6)
    found = least_squares(residual, start, jac=jacobian, method="lm", x_scale=scale, max_nfev=60)
    if not np.all(np.isfinite(found.x)) or found.cost >= 0.5 * float(np.sum(residual(start) ** 2)):
        return expression
    return pattern.xreplace({p: sp.Float(float(v)) for p, v in zip(parameters, found.x, strict=True)})
