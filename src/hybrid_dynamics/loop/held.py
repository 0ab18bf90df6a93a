"""Held-out predictions, scored from sums over blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_dynamics.loop.blocks import Folds, Indices
from hybrid_dynamics.loop.gram import BlockGrams
from hybrid_dynamics.loop.sums import FoldSums, picked
from hybrid_dynamics.types import Array


@dataclass(frozen=True)
class Held:
    """Held-out prediction of one combination of terms: every fold predicted by a fit on the others.

    ``coordinates`` (folds, K) are those that the other folds gave, ``places`` where they stand among the columns of
    each joint. With the vector v of :meth:`vector` the residual of a fold is columns @ v, so scores and block-wise
    products of residuals follow from the Gram matrices; nothing is predicted sample by sample. ``joint_errors`` (n,):
    squared held-out residual sums [N m]^2; ``score``: their weighted sum.
    """

    places: tuple[tuple[Indices, Indices], ...]
    coordinates: Array
    joint_errors: Array
    score: float

    @classmethod
    def of(cls, sums: FoldSums, places: Sequence[tuple[Indices, Indices]], coordinates: Array, weights: Array) -> Held:
        """Scores follow from the ``sums`` of products over each fold, joints weighed by ``weights`` (n,)."""
        errors = np.zeros(len(sums.own))
        for j, (grams, (position, column)) in enumerate(zip(sums.own, places, strict=True)):
            # Of all columns few are used: the whole product would read all of them. Not those of a law on its bound at
            # zero either: with it and without it the score is the same to the last digit, and the law is dropped.
            own = np.any(coordinates[:, position] != 0.0, axis=0)
            used = np.append(column[own], grams.shape[-1] - 1)
            v = np.column_stack([-coordinates[:, position[own]], np.ones(len(coordinates))])
            forms = np.sum((v[:, None, :] @ picked(grams, used))[:, 0] * v, axis=1)
            errors[j] = np.maximum(forms, 0.0).sum()
        return cls(tuple(places), coordinates, errors, float(errors @ weights))

    def vector(self, fold: int, joint: int, size: int) -> Array:
        """What turns the ``size`` columns of ``joint``, its target as the last one, into the residual of ``fold``."""
        return residual_vector(self.places[joint], self.coordinates[fold], size)


def change_by_block(left: Held, old: Held, new: Held, grams: Sequence[BlockGrams], folds: Folds) -> Array:
    """Block-wise sums (blocks, n) [N m]^2 of what ``left`` leaves times the change of the prediction from ``old`` to
    ``new``; all three of the linearisation of which ``grams`` are the products of every joint."""
    out = np.empty((len(folds.blocks), len(grams)))
    for f, parts in enumerate(folds.parts):
        for j, gram in enumerate(grams):
            own = left.vector(f, j, gram.size)
            change = old.vector(f, j, gram.size) - new.vector(f, j, gram.size)
            for part in parts:
                out[part, j] = gram.forms(own, change, part) if change.any() else 0.0
    return out


def residual_vector(place: tuple[Indices, Indices], x: Array, size: int) -> Array:
    """Vector (size,) that turns the columns of a joint, the target as the last, into what coordinates ``x`` leave."""
    position, column = place
    # Two terms may share a column: what they ask of it adds up.
    v = -np.bincount(column, x[position], minlength=size).astype(float)
    v[-1] = 1.0
    return v
