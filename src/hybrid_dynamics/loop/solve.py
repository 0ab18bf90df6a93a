"""Least squares in normal-equation form under physical constraints: lower bounds, friction that opposes the motion at
every speed seen, and bodies that can exist.

Minimises x'Ax/2 - b'x. Without an active constraint this is one linear solve; otherwise a barrier method (convex, since
the pseudo-inertia of a body is linear in its parameters: Sousa and Cortesao, IJRR 2014; Wensing et al., RA-L 2018).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.inertia import pseudo_inertia_basis

Array = NDArray[np.float64]

_BASIS = pseudo_inertia_basis()
#: A solid body (kg, kg m^2) and a distance from bounds that make the starting point strictly feasible, well inside.
_SEED = np.array([3.0, 0.0, 0.0, 0.0, 3e-2, 0.0, 3e-2, 0.0, 0.0, 3e-2])
_INSIDE = 1.0


@dataclass(frozen=True)
class Constraints:
    """``lower`` (K,) bounds; ``bodies``: first index of ten coordinates and the inertia (10,) they are added to.

    ``rows`` (R, K) and ``least`` (R,): ``rows @ x >= least``, coefficients >= 0, met with room at x = 1.
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
        return all(
            np.linalg.eigvalsh(np.einsum("k,kij->ij", offset + x[i : i + 10], _BASIS))[0] > 0
            for i, offset in self.bodies
        )


def solve_free(a: Array, b: Array) -> Array:
    """Unconstrained minimiser, columns scaled to unit diagonal."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(a), 1e-300))
    scaled = a * scale[:, None] * scale[None, :]
    try:
        return np.asarray(scale * np.linalg.solve(scaled, b * scale))
    except np.linalg.LinAlgError:
        return np.asarray(scale * np.linalg.lstsq(scaled, b * scale, rcond=1e-12)[0])


def solve_bounded(a: Array, b: Array, lower: Array) -> Array:
    """Minimiser under ``lower`` bounds, by fixing what violates them and releasing what would leave them."""
    x = solve_free(a, b)
    fixed = np.zeros(len(b), bool)
    for _ in range(3 * len(b)):
        bad = ~fixed & (x < lower - 1e-12)
        if not bad.any():
            gradient = a @ x - b
            release = fixed & (gradient < -1e-9 * np.maximum(np.abs(b), 1e-12))
            if not release.any():
                break
            fixed[np.argmin(np.where(release, gradient, np.inf))] = False
        fixed |= bad
        x = np.where(fixed, lower, 0.0)
        free = ~fixed
        if free.any():
            x[free] = solve_free(a[np.ix_(free, free)], b[free] - a[np.ix_(free, fixed)] @ x[fixed])
    return x


def solve(a: Array, b: Array, constraints: Constraints) -> Array:
    """Minimiser under all ``constraints``; exact where only bounds are active, else within a small barrier."""
    x = solve_bounded(a, b, constraints.lower) if np.isfinite(constraints.lower).any() else solve_free(a, b)
    if not constraints.coupled or constraints.satisfied(np.maximum(x, constraints.lower)):
        return x
    return _barrier(a, b, constraints)


def _barrier(a: Array, b: Array, constraints: Constraints) -> Array:
    bounded = np.flatnonzero(np.isfinite(constraints.lower))
    lower = constraints.lower[bounded]
    x = np.zeros(len(b))
    x[bounded] = lower + _INSIDE
    least = constraints.least
    rows = constraints.rows if len(least) else np.zeros((0, len(b)))
    x[np.any(rows != 0, axis=0)] = _INSIDE
    for i, _ in constraints.bodies:
        x[i : i + 10] = _SEED

    def matrices(point: Array) -> list[Array]:
        return [np.einsum("k,kij->ij", offset + point[i : i + 10], _BASIS) for i, offset in constraints.bodies]

    def value(point: Array, mu: float) -> float:
        gap = np.concatenate([point[bounded] - lower, rows @ point - least])
        if np.any(gap <= 0):
            return np.inf
        total = 0.5 * point @ a @ point - b @ point - mu * np.log(gap).sum()
        for matrix in matrices(point):
            try:
                diagonal = np.diag(np.linalg.cholesky(matrix))
            except np.linalg.LinAlgError:
                return np.inf
            if diagonal.min() < 1e-8 * diagonal.max():
                return np.inf
            total -= 2 * mu * np.log(diagonal).sum()
        return float(total)

    # Barrier weights in units of the objective (squared errors in noise floors): from far above to far below one.
    size = float(b @ solve_free(a, b))
    mu, last = max(1e4, 1e-3 * size), max(1e-3, 1e-9 * size)
    while mu > last:
        # On the way only near the central path; on it at the end.
        near = 1e-6 if 0.1 * mu <= last else 0.1
        for _ in range(30):
            gradient, hessian = a @ x - b, a.copy()
            gap = x[bounded] - lower
            gradient[bounded] -= mu / gap
            hessian[bounded, bounded] += mu / gap**2
            room = rows @ x - least
            gradient -= rows.T @ (mu / room)
            hessian += rows.T @ ((mu / room**2)[:, None] * rows)
            for (i, _offset), matrix in zip(constraints.bodies, matrices(x), strict=True):
                inverse = np.linalg.inv(matrix + 1e-14 * np.trace(matrix) * np.eye(4))
                products = inverse @ _BASIS
                gradient[i : i + 10] -= mu * np.trace(products, axis1=1, axis2=2)
                turned = products.transpose(0, 2, 1).reshape(10, 16)
                hessian[i : i + 10, i : i + 10] += mu * products.reshape(10, 16) @ turned.T
            step = -solve_free(hessian, gradient)
            decrement = -float(gradient @ step)
            if decrement < near * mu:
                break
            length, start = 1.0, value(x, mu)
            while length > 1e-10 and not value(x + length * step, mu) <= start - 1e-4 * length * decrement:
                length *= 0.5
            if length <= 1e-10:
                break
            x = x + length * step
        mu *= 0.1
    return x
