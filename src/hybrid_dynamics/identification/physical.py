"""Physically consistent parameters: a semidefinite programme on the triangular factor of the weighted regressor.

A link's parameters belong to a body of positive mass density exactly when its 4 x 4 pseudo-inertia

    J = [[Sigma, h], [h', m]],   Sigma = 1/2 tr(I) 1 - I

is positive definite (Wensing, Kim and Slotine, IEEE RA-L 3(1), 2018, eq. 10; semidefinite identification: Sousa and
Cortesao, IJRR 33(6), 2014). Minimised is

    |R (x - x_ols)|^2 / N + prior_weight * sum_i d(J_i | J0_i) + prior_weight * sum_j ((Ia_j - Ia0_j) / M_j)^2

where x are base parameters and friction, R the factor of the regressor weighted by the torque noise, N its rows, and
d the log-determinant divergence ``-log det(J J0^-1) + tr(J J0^-1) - 4`` towards the robot's description (Lee,
Wensing and Park, IEEE T-RO 36(1), 2020: independent of units and frames, infinite at the border). It fixes what no
motion shows. The cost of the programme does not depend on the number of samples.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg

from hybrid_dynamics.errors import HybridDynamicsError, needs_extra
from hybrid_dynamics.types import Array

if TYPE_CHECKING:
    import cvxpy as cp
log = logging.getLogger(__name__)

# Multiples of the wanted pull towards the prior that are tried in turn.
_STRONGER = (1.0, 10.0, 100.0, 1000.0)

# A description may hold point masses or inertias no body can have: bodies below this radius of gyration [m], and
# below this share of the robot's mass, are enlarged to it before they serve as the prior.
_SMALLEST_RADIUS = 0.005
_SMALLEST_MASS_SHARE = 1e-3


def pseudo_inertia(parameters: Array) -> Array:
    """Pseudo-inertia (4, 4) of ten parameters ``m lx ly lz Lxx Lxy Lyy Lxz Lyz Lzz`` [kg, kg m, kg m^2]."""
    m, lx, ly, lz, xx, xy, yy, xz, yz, zz = np.asarray(parameters, float)
    half = (xx + yy + zz) / 2
    return np.array([[half - xx, -xy, -xz, lx], [-xy, half - yy, -yz, ly], [-xz, -yz, half - zz, lz], [lx, ly, lz, m]])


def _pseudo_inertia_inverse_map() -> Array:
    """(10, 16) matrix with ``parameters = map @ J.ravel()``."""
    out = np.zeros((10, 16))
    out[0, 15] = 1.0
    for k in range(3):
        out[1 + k, 4 * k + 3] = 1.0
    for row, (a, b) in {4: (1, 2), 6: (0, 2), 9: (0, 1)}.items():
        out[row, [5 * a, 5 * b]] = 1.0
    for row, (a, b) in {5: (0, 1), 7: (0, 2), 8: (1, 2)}.items():
        out[row, 4 * a + b] = -1.0
    return out


def is_physical(parameters: Array, tolerance: float = 0.0) -> bool:
    """Whether every link of ``parameters`` (10 n,) has a positive definite pseudo-inertia (so mass > 0)."""
    links = np.asarray(parameters, float).reshape(-1, 10)
    return all(np.linalg.eigvalsh(pseudo_inertia(link))[0] > tolerance for link in links)


def feasible_prior(parameters: Array) -> Array:
    """The nearest usable prior (10 n,): bodies of the description that cannot exist are enlarged to ones that can."""
    links = np.asarray(parameters, float).reshape(-1, 10).copy()
    smallest = _SMALLEST_MASS_SHARE * max(links[:, 0].sum(), 1e-3)
    back = _pseudo_inertia_inverse_map()
    for link in links:
        j = pseudo_inertia(link)
        mass = max(link[0], smallest)
        centre = j[:3, 3] / mass
        second = j[:3, :3] - mass * np.outer(centre, centre)
        value, vector = np.linalg.eigh(second)
        second = (vector * np.maximum(value, mass * _SMALLEST_RADIUS**2)) @ vector.T
        j[:3, :3], j[3, 3] = second + mass * np.outer(centre, centre), mass
        link[:] = back @ j.ravel()
    return links.ravel()


def _solve(problem: cp.Problem, weight: cp.Parameter, prior_weight: float, parameters: Callable[[], Array]) -> Array:
    """Solve with the wanted pull towards the prior, or with the least stronger one that the solver can cope with; the
    ``parameters`` (10 n,) of the bodies then.

    Short or poor recordings leave directions that only the prior determines; a pull of 1e-5 against well measured
    directions is then beyond double precision: the solver stops short, or with a body that cannot exist. What was
    needed is logged, not hidden.
    """
    import cvxpy as cp

    status = ""
    for weight.value in (prior_weight * step for step in _STRONGER):
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Solution may be inaccurate", category=UserWarning)
            try:
                problem.solve(solver=cp.CLARABEL)
                status = str(problem.status)
            except cp.SolverError as error:
                status = str(error)
        if status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
            found = parameters()
            if not is_physical(found):
                status = "a body with a pseudo-inertia that is not positive definite"
                continue
            if weight.value > prior_weight:
                log.warning(
                    "physically consistent least squares: solved with prior_weight %.3g instead of %.3g; "
                    "the motions leave many parameters to the robot's description",
                    weight.value,
                    prior_weight,
                )
            return found
    raise HybridDynamicsError(
        f"physically consistent least squares: {status}; expected 'optimal'; consider more exciting motions or a "
        f"prior_weight larger than {prior_weight * _STRONGER[-1]:g}"
    )


def physical_least_squares(
    factor: Array,
    target: Array,
    rows: int,
    grouping: Array,
    prior: Array,
    prior_armature: Array,
    armature_scale: Array,
    prior_weight: float,
) -> tuple[Array, Array, Array]:
    """Physically consistent minimiser of ``|factor @ x - target|^2`` with ``x = [base (p), fv, fc, fo (n each)]``.

    ``factor`` (k, p + 3 n) and ``target`` (k,) are weighted by the torque noise, ``rows`` is N, ``grouping``
    (p, 11 n) as in :class:`~hybrid_dynamics.identification.base_parameters.BaseParameters`, ``prior`` (10 n,),
    ``prior_armature`` and ``armature_scale`` (n,) [kg m^2]. Returns ``pi`` (10 n,), ``Ia`` (n,) and friction
    ``[fv, fc, fo]`` (3 n,). Constraints: pseudo-inertias positive definite; Ia, fv, fc >= 0. Deterministic.
    """
    with needs_extra("study", "the least-squares baseline"):
        import cvxpy as cp  # here: it takes a second to import

    n = len(prior_armature)
    p = len(grouping)
    links = feasible_prior(prior).reshape(n, 10)
    back = _pseudo_inertia_inverse_map()
    inertial = np.zeros((p, 16 * n))  # base parameters of the normalised pseudo-inertias P_i (prior: identity)
    to_parameters = []
    for i, link in enumerate(links):
        lower = np.linalg.cholesky(pseudo_inertia(link))  # J0 = L L', J = L P L'
        to_parameters.append(back @ np.kron(lower, lower))
        inertial[:, 16 * i : 16 * (i + 1)] = grouping[:, 10 * i : 10 * (i + 1)] @ to_parameters[-1]

    bodies = [cp.Variable((4, 4), PSD=True) for _ in range(n)]
    armature = cp.Variable(n, nonneg=True)  # in units of armature_scale
    size = np.linalg.norm(factor[:, p:], axis=0) / np.sqrt(rows)
    still = size == 0  # joints that never move
    size[still] = 1.0  # friction in units that give a torque of one noise deviation
    friction = cp.Variable(3 * n)
    weighted = factor / np.sqrt(rows)
    stacked = cp.hstack([cp.reshape(body, (16,), order="C") for body in bodies])
    base = inertial @ stacked + (grouping[:, 10 * n :] * armature_scale) @ armature
    # Rotated to a square system; subtracting the unconstrained optimum keeps the large constant out of the solver.
    left, upper = scipy.linalg.qr(weighted, mode="economic")
    goal = left.T @ (target / np.sqrt(rows))
    residual = upper[:, :p] @ base + (upper[:, p:] / size) @ friction - goal
    divergence = cp.sum([cp.trace(body) - cp.log_det(body) for body in bodies])
    away = cp.sum_squares(armature - prior_armature / armature_scale)
    weight = cp.Parameter(nonneg=True)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(residual) + weight * (divergence + away)), [friction[: 2 * n] >= 0])

    def fitted() -> Array:
        symmetric = [(body.value + body.value.T) / 2 for body in bodies]
        return np.concatenate([t @ body.ravel() for t, body in zip(to_parameters, symmetric, strict=True)])

    parameters = _solve(problem, weight, prior_weight, fitted)
    values = friction.value / size
    values[: 2 * n] = np.maximum(values[: 2 * n], 0.0)
    values[still] = 0.0
    return parameters, np.maximum(armature.value, 0.0) * armature_scale, values
