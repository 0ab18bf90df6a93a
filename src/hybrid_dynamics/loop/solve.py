"""Least squares in normal-equation form under physical constraints: lower bounds, friction that opposes the motion,
and bodies that can exist.

Minimises x'Ax/2 - b'x. Without an active constraint this is one linear solve; otherwise a cone program for Clarabel
(convex, since the pseudo-inertia of a body is linear in its parameters: Sousa and Cortesao, IJRR 2014; Wensing et al.,
RA-L 2018).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

from hybrid_dynamics.effects.inertia import pseudo_inertia_basis
from hybrid_dynamics.types import Array

_BASIS = pseudo_inertia_basis()
#: What adds one to all eigenvalues of a pseudo-inertia: 1 kg, and 1 kg m^2 of second moment along each axis.
_BALL = np.array([1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 2.0, 0.0, 0.0, 2.0])
#: Smallest eigenvalue (kg, kg m^2) of a fitted pseudo-inertia: inside, beyond the solver's tolerance.
_MARGIN = 1e-8
#: The farthest constraint lies at most 1 / this from the origin in the solver's units; tried in turn.
FARTHEST = (0.02, 0.2, 2.0)
#: A share of the diagonal that is added to it, far above what sums of squares round to, and far below what a sample
#: says: two columns that are one leave a direction of which only rounding says anything, and along it the minimum lies
#: anywhere. (Found on nine seconds of a Kinova Gen3: in a part of them the difference of two speeds never changed its
#: sign. Its friction and two offsets had forty newton metres each, other ones after any change of another joint, and
#: the held-out samples were predicted by these.)
LEAST = 1e-11
#: The share where the solver does not converge, and beforehand along directions that hold less than :data:`OPEN` of
#: it: less than this the solver, which stops short of the minimum, would not see.
RIDGE, OPEN = 1e-7, 1e-9
#: How the solver is then asked, in turn, with a margin inside what can exist and without one (in the units of a log
#: without noise it lies too far off): as ever, with shorter steps, in units of our own, at last for less precision.
STEPS = {"max_step_fraction": 0.9}
OWN = {"equilibrate_enable": False}
LOOSE = {**OWN, "tol_gap_abs": 1e-6, "tol_gap_rel": 1e-6, "tol_feas": 1e-6}
TRIES: tuple[tuple[float, Mapping[str, Any], bool], ...] = (
    (0.0, {}, True),
    *((RIDGE, again, True) for again in ({}, STEPS, OWN)),
    *((RIDGE, again, False) for again in ({}, OWN)),
    *((RIDGE, LOOSE, margin) for margin in (True, False)),
)
#: Bodies that the solver leaves further outside than this [kg, kg m^2] are no solution.
OUTSIDE = 1e-5


def _cone_rows() -> tuple[Array, Array]:
    """Maps (10, 10) inertial parameters, and the margin (10,), to the upper triangle in Clarabel's scaling."""
    upper = [(i, j) for j in range(4) for i in range(j + 1)]
    scale = np.array([1.0 if i == j else np.sqrt(2.0) for i, j in upper])
    pick = tuple(np.array(upper).T)
    return scale[:, None] * np.array([m[pick] for m in _BASIS]).T, scale * _MARGIN * np.eye(4)[pick]


_TRIANGLE, _RIM = _cone_rows()


@dataclass(frozen=True)
class _Stacked:
    """``rows @ x - limit`` must lie in ``cones``, ``inside`` of it the margin of bodies; rows of one ``group`` can only
    be scaled together."""

    rows: csc_matrix
    limit: Array
    inside: Array
    group: NDArray[np.int_]
    cones: tuple[Any, ...]


@dataclass(frozen=True)
class Constraints:
    """``lower`` (K,) bounds; ``bodies``: first index of ten coordinates and the inertia (10,) they are added to.

    ``rows`` (R, K) and ``least`` (R,): ``rows @ x >= least``.
    """

    lower: Array
    bodies: tuple[tuple[int, Array], ...] = ()
    rows: Array = field(default_factory=lambda: np.zeros((0, 0)))
    least: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def coupled(self) -> bool:
        """True where coordinates constrain each other, beyond single bounds."""
        return bool(self.bodies) or len(self.least) > 0

    def satisfied(self, x: Array) -> bool:
        """True where ``x`` meets all of them."""
        if np.any(x < self.lower) or (len(self.least) and np.any(self.rows @ x < self.least)):
            return False
        if not self.bodies:
            return True
        inertias = np.array([offset + x[i : i + 10] for i, offset in self.bodies])
        return bool(np.all(np.linalg.eigvalsh(np.tensordot(inertias, _BASIS, axes=1)) > 0))

    @cached_property
    def stacked(self) -> _Stacked:
        """The same in the solver's form."""
        total = len(self.lower)
        bounded = np.flatnonzero(np.isfinite(self.lower))
        bounds = np.zeros((len(bounded), total))
        bounds[np.arange(len(bounded)), bounded] = 1.0
        half_spaces = len(bounded) + len(self.least)
        blocks, limits, inside = [bounds], [self.lower[bounded]], [np.zeros(half_spaces)]
        if len(self.least):
            blocks.append(self.rows)
            limits.append(self.least)
        cones = [clarabel.NonnegativeConeT(half_spaces)] if half_spaces else []
        for start, offset in self.bodies:
            body = np.zeros((10, total))
            body[:, start : start + 10] = _TRIANGLE
            blocks.append(body)
            limits.append(_RIM - _TRIANGLE @ offset)
            inside.append(_RIM)
            cones.append(clarabel.PSDTriangleConeT(4))
        group = np.concatenate([np.arange(half_spaces), half_spaces + np.repeat(np.arange(len(self.bodies)), 10)])
        rows, limit = csc_matrix(np.vstack(blocks)), np.concatenate(limits)
        return _Stacked(rows, limit, np.concatenate(inside), group, tuple(cones))


def solve_free(a: Array, b: Array) -> Array:
    """Unconstrained minimisers (m, K) of ``a`` (m, K, K) and ``b`` (m, K), columns scaled to unit diagonal; where a
    direction is open, the least along it (:data:`LEAST`)."""
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("mkk->mk", a), 1e-300))
    scaled, target = a * scale[:, :, None] * scale[:, None, :], b * scale
    scaled += LEAST * np.eye(a.shape[1])
    return np.asarray(scale * np.linalg.solve(scaled, target[:, :, None])[:, :, 0])


def solve_bounded(a: Array, b: Array, lower: Array) -> Array:
    """Minimisers (m, K) under ``lower`` (K,) bounds, by fixing what violates them and releasing what would leave them:
    ``a`` (m, K, K), ``b`` (m, K). Those that fix the same are solved at once."""
    x = solve_free(a, b)
    fixed = np.zeros(b.shape, bool)
    left = np.arange(len(b))
    for _ in range(3 * b.shape[1]):
        bad = ~fixed[left] & (x[left] < lower - 1e-12)
        good = left[~bad.any(axis=1)]
        gradient = np.einsum("mij,mj->mi", a[good], x[good]) - b[good]
        release = fixed[good] & (gradient < -1e-9 * np.maximum(np.abs(b[good]), 1e-12))
        last = np.where(release, gradient, np.inf).argmin(axis=1)
        more = release.any(axis=1)
        fixed[good[more], last[more]] = False
        fixed[left] |= bad
        left = np.setdiff1d(left, good[~more])
        if not len(left):
            break
        for pattern in dict.fromkeys(row.tobytes() for row in fixed[left]):
            some = left[[row.tobytes() == pattern for row in fixed[left]]]
            held = fixed[some[0]]
            x[some] = np.where(held, lower, 0.0)
            if not held.all():
                rows, free = some[:, None], np.flatnonzero(~held)
                known = a[some[:, None, None], free[:, None], np.flatnonzero(held)] @ lower[held]
                x[rows, free] = solve_free(a[some[:, None, None], free[:, None], free], b[rows, free] - known)
    return x


def solve(a: Array, b: Array, constraints: Constraints) -> Array:
    """Minimiser (K,) under all ``constraints``; exact where only bounds are active, else to the solver's tolerance, and
    with the remedies of :data:`TRIES` where it does not converge. Bodies can exist."""
    return np.asarray(solve_all(a[None], b[None], constraints)[0])


def solve_all(a: Array, b: Array, constraints: Constraints, closing: bool = True) -> Array:
    """:func:`solve` of several problems: ``a`` (m, K, K), ``b`` (m, K), minimisers (m, K); not ``closing``: open
    directions are held already."""
    x = solve_bounded(a, b, constraints.lower) if np.isfinite(constraints.lower).any() else solve_free(a, b)
    if constraints.coupled:
        for m in range(len(x)):
            if not constraints.satisfied(np.maximum(x[m], constraints.lower)):
                x[m] = _solve_coupled(_closed(a[m]) if closing else a[m], b[m], constraints)
    return x


def _solve_coupled(a: Array, b: Array, constraints: Constraints) -> Array:
    """Minimiser (K,) where coordinates constrain each other; raises RuntimeError where no remedy converges."""
    for (ridge, again, margin), farthest in product(TRIES, FARTHEST):
        stiffer = a + ridge * np.diag(np.diag(a)) if ridge else a
        solution = _solve_cones(stiffer, b, constraints, farthest, again, margin)
        if solution is not None and (inside := _inside(solution, constraints)) is not None:
            return inside
    raise RuntimeError(f"the physically consistent fit of {len(b)} coordinates did not converge")


def _closed(a: Array) -> Array:
    """``a`` (K, K), with up to :data:`RIDGE` along the directions that it leaves open, the more open the more."""
    size = np.sqrt(np.maximum(np.diag(a), 1e-300))
    scaled = a / size[:, None] / size
    try:
        np.linalg.cholesky(scaled - OPEN * np.eye(len(a)))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(scaled)
        free = vectors * np.sqrt(RIDGE * np.clip(1.0 - values / OPEN, 0.0, 1.0)) * size[:, None]
        return np.asarray(a + free @ free.T)
    return a


def _upper_triangle(a: Array) -> csc_matrix:
    """What is not zero in the upper triangle of the symmetric ``a``, column by column."""
    rows, columns = np.nonzero(np.tril(a.T))
    starts = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=len(a)))])
    return _sparse(a[columns, rows], columns, starts, (len(a), len(a)))


def _sparse(data: Array, indices: Any, starts: Any, shape: tuple[int, int]) -> csc_matrix:
    """Columns one behind the other, without the checks of the constructor, which take longer than a small solve."""
    out = csc_matrix(shape)
    out.data, out.indices, out.indptr = data, indices, starts
    return out


def _inside(x: Array, constraints: Constraints) -> Array | None:
    """``x`` with a point mass and a ball on each body that lies outside what can exist, or on its rim, by the solver's
    tolerance; None where one lies further outside."""
    x = x.copy()
    for start, offset in constraints.bodies:
        short = _MARGIN - float(np.linalg.eigvalsh(np.tensordot(offset + x[start : start + 10], _BASIS, axes=1))[0])
        if short > OUTSIDE:
            return None
        if short > 0.5 * _MARGIN:
            x[start : start + 10] += short * _BALL
    return x


def _solve_cones(
    a: Array, b: Array, constraints: Constraints, farthest: float, again: Mapping[str, Any], margin: bool
) -> Array | None:
    """Minimise over y, x = scale * y: unit diagonal, linear term of size one; h - G y must lie in the cones.

    Constraints far beyond what the data asks for would spoil the solver's start: the farthest lies at most at
    1 / ``farthest``. ``again``: settings of the solver other than ours; without ``margin`` bodies may lie on the
    rim of what can exist. None where it does not converge.
    """
    unit = 1.0 / np.sqrt(np.maximum(np.diag(a), 1e-300))
    bounded = np.flatnonzero(np.isfinite(constraints.lower))
    far = [np.abs(constraints.lower[bounded] / unit[bounded])]
    far += [np.abs(offset / unit[start : start + 10]) for start, offset in constraints.bodies]
    size = max(float(np.abs(b * unit).max()), farthest * max(float(f.max(initial=0.0)) for f in far), 1e-300)
    scale = unit * size
    stacked = constraints.stacked
    rows, group = stacked.rows, stacked.group
    data = rows.data * np.repeat(scale, np.diff(rows.indptr))
    # Rows of a half space may be scaled one by one, those of a body only together.
    length = np.zeros(len(group))
    np.maximum.at(length, group[rows.indices], np.abs(data))
    length = np.where(length > 0, length, 1.0)[group]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-9
    for name, value in again.items():
        setattr(settings, name, value)
    solver = clarabel.DefaultSolver(
        _upper_triangle(a * unit[:, None] * unit),
        -b * unit / size,
        _sparse(-data / length[rows.indices], rows.indices, rows.indptr, (rows.shape[0], rows.shape[1])),
        -(stacked.limit if margin else stacked.limit - stacked.inside) / length,
        list(stacked.cones),
        settings,
    )
    try:
        solution = solver.solve()
    except BaseException as error:
        # Its eigenvalue routine may give up on data that says nothing; a panic in Rust is no Exception.
        if type(error).__name__ != "PanicException":
            raise
        return None
    if solution.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
        return None
    return np.asarray(np.maximum(scale * np.array(solution.x), constraints.lower))
