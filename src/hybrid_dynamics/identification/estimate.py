"""The linear algebra of the fit on block factors: weighting, sign widths by cross-validation, jackknife errors.

Unknowns are ``x = [base (p), fv (n), fc (n), fo (n)]``, m = p + 3 n of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from hybrid_dynamics.identification.factors import BlockFactors
from hybrid_dynamics.types import Array

Index = NDArray[np.intp]

#: Directions whose singular value (unit columns) is below this share of the largest count as not excited.
EXCITATION_TOLERANCE = 1e-8
#: Least torque noise that the weighting assumes, as a share of the rms torque.
NOISE_FLOOR = 1e-5


@dataclass(frozen=True)
class Estimate:
    """Ordinary weighted estimate: ``x`` (m,), jackknife ``std_error`` (m,) (infinite where the data does not tell),
    ``noise`` (n,) residual deviation [N m], ``width_index`` (n,), ``factor`` (m, m) and ``target`` (m,) of the
    weighted system, ``rows`` behind it, ``condition_number`` of its columns scaled to unit length (infinite where a
    direction is not excited), ``base_condition_number`` of the unweighted inertial columns in SI units."""

    x: Array
    std_error: Array
    noise: Array
    width_index: Index
    factor: Array
    target: Array
    rows: int
    condition_number: float
    base_condition_number: float


class Problem:
    """Views of ``blocks`` for a robot with ``p`` base parameters."""

    def __init__(self, blocks: BlockFactors, p: int) -> None:
        self.blocks = blocks
        self.p = p
        self.n = blocks.factors.shape[1]
        self.m = p + 3 * self.n
        self.grams = _grams(blocks.factors)
        self.joint_factors = [
            scipy.linalg.qr(blocks.factors[:, j].reshape(-1, blocks.factors.shape[-1]), mode="r")[0]
            for j in range(self.n)
        ]

        # An exact fit has no noise; a floor at this share of the torque keeps weights and conic solver sane.
        torque = np.array([np.linalg.norm(factor[:, -1]) for factor in self.joint_factors])
        torque /= np.sqrt(np.maximum(blocks.rows.sum(axis=0), 1))
        self._noise_floor = NOISE_FLOOR * np.maximum(torque, max(1e-3 * torque.max(), 1e-9))

    def _columns(self, j: int, width: int) -> tuple[Index, Index]:
        """Where the columns of joint ``j`` come from and where they go among the m + 1 columns."""
        p, n, m = self.p, self.n, self.m
        last = self.blocks.factors.shape[-1] - 1
        source, goal = list(range(p)), list(range(p))
        if self.blocks.moving[j]:
            source += [p, p + 1 + width]
            goal += [p + j, p + n + j]
        return np.array([*source, last - 1, last]), np.array([*goal, p + 2 * n + j, m])

    def weighted_grams(self, grams: Array, noise: Array, widths: Index) -> Array:
        """Weighted Gram matrices (B, m + 1, m + 1) of all joints together, target last, from ``grams`` (B, n, c, c)."""
        out = np.zeros((len(grams), self.m + 1, self.m + 1))
        for j in range(self.n):
            source, goal = self._columns(j, int(widths[j]))
            out[:, goal[:, None], goal] += grams[:, j][:, source[:, None], source] / noise[j] ** 2
        return out

    def system(self, noise: Array, widths: Index) -> tuple[Array, Array]:
        """Triangular factor (m, m) and target (m,) of all data, by QR (no squared condition)."""
        stacked = []
        for j in range(self.n):
            source, goal = self._columns(j, int(widths[j]))
            part = np.zeros((len(self.joint_factors[j]), self.m + 1))
            part[:, goal] = self.joint_factors[j][:, source] / noise[j]
            stacked.append(part)
        upper = scipy.linalg.qr(np.vstack(stacked), mode="r")[0][: self.m + 1]
        upper = np.pad(upper, ((0, self.m + 1 - len(upper)), (0, 0)))
        return upper[: self.m, : self.m], upper[: self.m, self.m]

    def noise(self, x: Array, widths: Index) -> Array:
        """Residual deviation (n,) [N m] of each joint under ``x``, with the fitted degrees of freedom taken off."""
        rows = self.blocks.rows.sum(axis=0)
        free = max(1.0 - self.m / max(rows.sum(), 1), 0.1)
        out = np.empty(self.n)
        for j in range(self.n):
            source, goal = self._columns(j, int(widths[j]))
            residual = self.joint_factors[j][:, source] @ np.append(x, -1.0)[goal]
            out[j] = np.linalg.norm(residual) / np.sqrt(max(rows[j], 1) * free)
        return np.asarray(np.maximum(out, self._noise_floor))


def _grams(factors: Array) -> Array:
    return np.asarray(np.matmul(np.swapaxes(factors, -1, -2), factors))


def solve_factor(factor: Array, target: Array) -> tuple[Array, Array, Array]:
    """Minimum-norm least squares in unit columns: solution, singular values, and which entries are not determined."""
    length = np.linalg.norm(factor, axis=0)
    scale = np.where(length > 0, length, 1.0)
    u, s, vt = np.linalg.svd(factor / scale, full_matrices=False)
    kept = s > EXCITATION_TOLERANCE * s[0]
    x = (vt[kept].T @ ((u[:, kept].T @ target) / s[kept])) / scale
    lost = (np.linalg.norm(vt[~kept], axis=0) > 1e-6) | (length == 0)
    return x, s, lost


def _solve_gram(gram: Array) -> Array:
    """Solution (m,) of normal equations (m + 1, m + 1), target last, in unit columns."""
    normal, right = gram[:-1, :-1], gram[:-1, -1]
    scale = np.sqrt(np.diag(normal))
    scale[scale <= 0] = 1.0
    value, vector = np.linalg.eigh(normal / scale[:, None] / scale)
    kept = value > 1e-12 * value[-1]
    return np.asarray((vector[:, kept] @ ((vector[:, kept].T @ (right / scale)) / value[kept])) / scale)


def jackknife(grams: Array) -> Array:
    """Standard errors (m,) by leaving out one block at a time.

    Blocks longer than the residual's correlation make it robust to autocorrelation, unequal variance and correlation
    between joints (Kuensch, Annals of Statistics 17(3), 1989; MacKinnon and White's HC3 with blocks for samples).
    """
    total = grams.sum(axis=0)
    count = len(grams)
    estimates = np.array([_solve_gram(total - gram) for gram in grams])
    spread = estimates - estimates.mean(axis=0)
    return np.asarray(np.sqrt((count - 1) / count * np.sum(spread**2, axis=0)))


def _folds(blocks: BlockFactors) -> Index:
    """Fold (B,) of each block: whole runs where there are three or more, else four contiguous stretches."""
    runs = len(np.unique(blocks.trajectory))
    if runs >= 3:
        return blocks.trajectory
    return np.arange(len(blocks.trajectory)) * 4 // len(blocks.trajectory)


def choose_widths(problem: Problem, noise: Array) -> Index:
    """Width of sign(dq) per joint with the least cross-validated weighted error: a common one, then joint by joint.

    Slow rows count in the held-out error, though they are not fitted: the width is what they are for.
    """
    blocks = problem.blocks
    folds = _folds(blocks)
    names = np.unique(folds)
    fitted = np.array([problem.grams[folds == f].sum(axis=0) for f in names])
    scored = fitted + np.array([_grams(blocks.slow[folds == f]).sum(axis=0) for f in names])

    def held_out_error(widths: Index) -> float:
        inside = problem.weighted_grams(fitted, noise, widths)
        total, error = inside.sum(axis=0), 0.0
        for own, test in zip(inside, problem.weighted_grams(scored, noise, widths), strict=True):
            x = np.append(_solve_gram(total - own), -1.0)
            error += float(x @ test @ x)
        return error

    count = len(blocks.widths)
    common = [held_out_error(np.full(problem.n, w)) for w in range(count)]
    widths, best = np.full(problem.n, int(np.argmin(common))), min(common)
    for j in np.flatnonzero(blocks.moving):
        for w in range(count):
            trial = widths.copy()
            trial[j] = w
            error = best if w == widths[j] else held_out_error(trial)
            if error < best * (1 - 1e-6):
                widths, best = trial, error
    return widths


def estimate(blocks: BlockFactors, p: int, reweightings: int) -> Estimate:
    """Weighted least squares with per-joint noise found by re-weighting, sign widths chosen after the first pass."""
    problem = Problem(blocks, p)
    widths = np.zeros(problem.n, dtype=np.intp)
    noise = np.ones(problem.n)
    for k in range(reweightings + 1):
        x = solve_factor(*problem.system(noise, widths))[0]
        noise = problem.noise(x, widths)
        if k == 0 and len(blocks.widths) > 1:
            widths = choose_widths(problem, noise)
    factor, target = problem.system(noise, widths)
    x, singular, lost = solve_factor(factor, target)
    std_error = jackknife(problem.weighted_grams(problem.grams, noise, widths))
    std_error[lost] = np.inf
    used = singular[singular > 0]
    inertial = np.linalg.svd(np.vstack([factor[:, :p] for factor in problem.joint_factors]), compute_uv=False)
    excited = inertial[-1] > EXCITATION_TOLERANCE * inertial[0]
    return Estimate(
        x=x,
        std_error=std_error,
        noise=problem.noise(x, widths),
        width_index=widths,
        factor=factor,
        target=target,
        rows=int(blocks.rows.sum()),
        condition_number=float(used[0] / used[-1]) if not lost.any() else float("inf"),
        base_condition_number=float(inertial[0] / inertial[-1]) if excited else float("inf"),
    )
