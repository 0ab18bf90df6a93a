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
from hybrid_dynamics.models.triangular import triangular_factor
from hybrid_dynamics.types import Array

#: A column whose share outside the span of the simpler ones is below this adds nothing a double can tell.
_DEPENDENT = 1e-9
_CHUNK_ROWS = 12_000
_NEWTON_ROWS = 50_000


@dataclass(frozen=True)
class Fit:
    """A re-fitted sum of terms: ``bases`` times ``coefficients``.

    ``mse`` is the mean squared error on all samples, ``held_out`` the one on blocks of samples left out of the fit.
    """

    bases: tuple[sp.Expr, ...]
    coefficients: tuple[float, ...]
    mse: float
    held_out: float

    @property
    def expression(self) -> sp.Expr:
        """The sum as one expression."""
        return sp.Add(*(sp.Float(c) * b for c, b in zip(self.coefficients, self.bases, strict=True)))


def expand(expression: sp.Expr) -> sp.Expr:
    """Multiply out products and integer powers; leave exponentials and logarithms whole."""
    return sp.expand(expression, power_base=False, power_exp=False, log=False)


def bases_of(expression: sp.Expr) -> list[sp.Expr]:
    """The terms of the expanded expression without their numeric factors."""
    return list(dict.fromkeys(term.as_coeff_Mul()[1] for term in sp.Add.make_args(expand(expression)) if term != 0))


@dataclass(frozen=True)
class Pruning:
    """When a term is worth keeping.

    Of the models along backward elimination the smallest is taken whose held-out error is at most
    ``(1 + share) * best + least`` (``least`` in N^2 m^2). ``blocks`` contiguous blocks are held out in turn: samples
    beside each other are alike, so only whole stretches of a recording test a model.
    """

    least: float
    share: float
    blocks: int


def fit_terms(bases: Sequence[sp.Expr], X: Array, y: Array, names: Sequence[str], pruning: Pruning) -> Fit:
    """Least squares over ``bases`` on all samples, and backward elimination: see :class:`Pruning`."""
    ordered = sorted(dict.fromkeys(bases), key=lambda b: (complexity(b), str(b)))
    count, samples = len(ordered), len(X)
    factors, norms = _block_factors(CompiledExpressions(ordered, names), count, X, y, pruning.blocks)
    whole = np.asarray(np.linalg.qr(np.vstack(list(factors)), mode="r"))
    keep = _independent(whole, count)
    path: list[tuple[NDArray[np.intp], Array, float, float]] = []
    while True:
        values, costs, left = _solve(whole, keep, count)
        path.append((keep, values, left / samples, _held_out(factors, keep, count) / samples))
        if not len(keep):
            break
        keep = np.delete(keep, int(np.argmin(costs)))
    bound = (1 + pruning.share) * min(step[3] for step in path) + pruning.least
    keep, values, mse, held_out = [step for step in path if step[3] <= bound][-1]
    return Fit(tuple(ordered[k] for k in keep), tuple(float(v) for v in values / norms[keep]), mse, held_out)


def _block_factors(compiled: CompiledExpressions, count: int, X: Array, y: Array, blocks: int) -> tuple[Array, Array]:
    """Triangular factors of [b(x) y] of contiguous blocks, columns of unit length over all, and those lengths."""
    edges = np.linspace(0, len(X), min(blocks, max(len(X) // 2, 1)) + 1).astype(int)
    factors = np.zeros((len(edges) - 1, count + 1, count + 1))
    for factor, start, stop in zip(factors, edges[:-1], edges[1:], strict=True):
        if count:
            factor[:] = triangular_factor(X[start:stop], y[start:stop, None], compiled, count, _CHUNK_ROWS)
        else:
            factor[0, 0] = np.linalg.norm(y[start:stop])
    norms = np.sqrt(np.sum(factors[:, :, :count] ** 2, axis=(0, 1)))
    norms[norms == 0] = 1.0
    factors[:, :, :count] /= norms
    return factors, norms


def _independent(whole: Array, count: int) -> NDArray[np.intp]:
    """Columns that are finite, not zero, and not a combination of those before them (which are simpler)."""
    size = np.linalg.norm(whole[:, :count], axis=0)
    keep = np.flatnonzero(np.isfinite(size) & (size > 0))
    while len(keep):
        diagonal = np.abs(np.diag(np.asarray(np.linalg.qr(whole[:, keep], mode="r"))))
        dependent = np.flatnonzero(diagonal < _DEPENDENT)
        if not len(dependent):
            break
        keep = np.delete(keep, dependent[0])
    return keep


def _solve(whole: Array, keep: NDArray[np.intp], count: int) -> tuple[Array, Array, float]:
    """Coefficients, the rise of the squared error when each is left out, and the squared error of all."""
    p = len(keep)
    r = np.asarray(np.linalg.qr(whole[:, [*keep, count]], mode="r"))
    left = float(np.sum(r[p:, p] ** 2))
    if p == 0:
        return np.zeros(0), np.zeros(0), left
    inverse = solve_triangular(r[:p, :p], np.eye(p))
    values = inverse @ r[:p, p]
    return values, values**2 / np.sum(inverse**2, axis=1), left


def _held_out(factors: Array, keep: NDArray[np.intp], count: int) -> float:
    """Squared error, summed over the blocks, each predicted by the fit to all the others."""
    p, blocks = len(keep), len(factors)
    parts = factors[:, :, [*keep, count]]
    if p == 0 or blocks == 1:
        return float(np.sum(parts[:, :, p] ** 2)) if p == 0 else _solve(factors[0], keep, count)[2]
    others = np.stack([np.delete(parts, k, axis=0).reshape(-1, p + 1) for k in range(blocks)])
    # A trace of ridge keeps a fold solvable in which a term does not move.
    ridge = np.broadcast_to(_DEPENDENT * np.eye(p, p + 1), (blocks, p, p + 1))
    r = np.asarray(np.linalg.qr(np.concatenate([others, ridge], axis=1), mode="r"))
    values = np.linalg.solve(r[:, :p, :p], r[:, :p, p:])
    errors = parts[:, :, :p] @ values - parts[:, :, p:]
    return float(np.sum(errors**2))


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
        return np.asarray(np.nan_to_num(np.broadcast_to(error, target.shape), nan=1e150, posinf=1e150, neginf=-1e150))

    def jacobian(p: Array) -> Array:
        with np.errstate(all="ignore"):
            parts = slope(*p, *data)
        return np.asarray(np.nan_to_num(np.column_stack([np.broadcast_to(part, target.shape) for part in parts])))

    start = np.array([float(c) for c in constants])
    scale = np.maximum(np.abs(start), 1e-6)
    found = least_squares(residual, start, jac=jacobian, method="lm", x_scale=scale, max_nfev=60)
    if not np.all(np.isfinite(found.x)) or found.cost >= 0.5 * float(np.sum(residual(start) ** 2)):
        return expression
    return pattern.xreplace({p: sp.Float(float(v)) for p, v in zip(parameters, found.x, strict=True)})
