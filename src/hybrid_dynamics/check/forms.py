"""How well a guess about the log explains a joint's torque: products of columns once, any number of guesses after.

A guess says which torque column belongs to the joint, its sign, where gravity points, how time was scaled. It explains
the torque by ``alpha (motion + gravity) + Fv dq + Fc sign(dq) + Ia ddq + beta beside + b``, all but ``b`` >= 0: no unit
is taken for granted, friction and rotors only ever oppose, and what a model has beside the rigid body may have changed.
What is left, as a share of the torque's own mean square, is compared between guesses on a logarithmic scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from hybrid_dynamics.check.columns import Columns
from hybrid_dynamics.types import Array

#: Shares below this are model error in any case: nothing is gained there.
FLOOR = 0.01
_FREE, _TORQUE = slice(4, 8), 8


@dataclass(frozen=True)
class Fit:
    """``left``: share of the mean square that a guess leaves; ``coefficients``: alpha, Fv, Fc, Ia, beta; ``rigid``
    [N m]: standard deviation of the rigid body's torque."""

    left: float
    coefficients: Array
    rigid: float

    @property
    def score(self) -> float:
        """The lower, the better."""
        return float(np.log(self.left + FLOOR))


class Forms:
    """Products of each joint's columns ``[motion, gx, gy, gz, dq, sign, ddq, beside, tau1 .. taun]`` without means."""

    def __init__(self, columns: Columns) -> None:
        self.n = columns.tau.shape[1]
        self.grams = []
        for j in range(self.n):
            table = np.column_stack(
                [
                    columns.motion[:, j],
                    columns.gravity[:, j],
                    columns.dq[:, j],
                    columns.sign[:, j],
                    columns.ddq[:, j],
                    columns.beside[:, j],
                    columns.tau,
                ]
            )
            table -= table.mean(axis=0)
            self.grams.append(table.T @ table / len(table))

    def fit(
        self,
        j: int,
        gravity: Array,
        source: int | None = None,
        sign: int = 1,
        pace: float = 1.0,
        rotor: bool = True,
        links: bool = True,
    ) -> Fit:
        """Explain torque column ``source`` (``j``) times ``sign`` as joint ``j`` under ``gravity`` (3,).

        ``pace``: true speed over the speed that the time stamps say. Without ``rotor`` the joint has none, without
        ``links`` it moves nothing but itself.
        """
        gram = self.grams[j]
        target = _TORQUE + (j if source is None else source)
        mix = np.zeros((len(gram), 6))
        if links:
            mix[0, 0], mix[1:4, 0] = pace**2, gravity
        mix[_FREE, 1:5] = np.diag([1.0, 1.0, float(rotor), 1.0])
        mix[target, 5] = sign
        return explain(mix.T @ gram @ mix)

    def search_gravity(self, size: float) -> list[Array]:
        """Directions of gravity (3,) of length ``size`` worth a closer look, signs of the torque unknown.

        Friction, rotors and effects are taken out first, so that the whole sphere is a few quadratic forms.
        """
        directions = sphere(2000) * size
        mixes = np.concatenate([np.ones((len(directions), 1)), directions], axis=1)
        keep, flip = np.zeros(len(directions)), np.zeros(len(directions))
        for j, gram in enumerate(self.grams):
            rows = [0, 1, 2, 3, _TORQUE + j]
            inner = gram[_FREE, _FREE] + 1e-12 * max(float(np.trace(gram[_FREE, _FREE])), 1e-30) * np.eye(4)
            rest = gram[np.ix_(rows, rows)] - gram[rows, _FREE] @ np.linalg.solve(inner, gram[_FREE, rows])
            if rest[4, 4] <= 1e-12 * max(gram[_TORQUE + j, _TORQUE + j], 1e-300):
                continue
            own = np.maximum(np.einsum("gi,ij,gj->g", mixes, rest[:4, :4], mixes), 1e-300)
            cross = mixes @ rest[:4, 4]
            share = np.clip(cross**2 / (own * rest[4, 4]), 0, 1)
            keep += np.log(1 - np.where(cross > 0, share, 0) + FLOOR)
            flip += np.log(1 - share + FLOOR)
        best = [directions[int(np.argmin(keep))], directions[int(np.argmin(flip))]]
        return [self._refine(g) for g in best] + best

    def _refine(self, gravity: Array) -> Array:
        """The direction near ``gravity`` for which the sum of scores (constraints kept) is least."""
        size = float(np.linalg.norm(gravity))
        best, score = gravity, self.total(gravity)
        for angle in (0.06, 0.02, 0.007):
            for _ in range(3):
                trials = [best + angle * size * d for d in _AROUND]
                trials = [t * size / np.linalg.norm(t) for t in trials]
                scores = [self.total(t) for t in trials]
                k = int(np.argmin(scores))
                if scores[k] >= score:
                    break
                best, score = trials[k], scores[k]
        return best

    def total(self, gravity: Array, pace: float = 1.0) -> float:
        """Sum of the joints' scores, columns and signs as they are."""
        return sum(self.fit(j, gravity, pace=pace).score for j in range(self.n))


_AROUND = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)


def explain(gram: Array) -> Fit:
    """Non-negative least squares from products (m + 1, m + 1) of m columns, the model's torque first, and torque."""
    power = float(gram[-1, -1])
    if power <= 0:
        return Fit(1.0, np.zeros(len(gram) - 1), 0.0)
    scale = np.sqrt(np.maximum(np.diag(gram)[:-1], 1e-300))
    a = gram[:-1, :-1] / scale[:, None] / scale[None, :] + 1e-9 * np.eye(len(scale))
    b = gram[:-1, -1] / scale / np.sqrt(power)
    root = np.linalg.cholesky(a)
    x, _ = nnls(root.T, np.linalg.solve(root, b))
    left = float(np.clip(1.0 - 2 * b @ x + x @ a @ x, 0.0, 1.0))
    return Fit(left, x * np.sqrt(power) / scale, float(np.sqrt(max(gram[0, 0], 0.0))))


def sphere(count: int) -> Array:
    """``count`` directions (count, 3), evenly spread (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    angle = np.pi * (1 + np.sqrt(5)) * k
    ring = np.sqrt(1 - z**2)
    return np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z])
