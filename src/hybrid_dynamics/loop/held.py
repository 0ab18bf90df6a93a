"""Held-out predictions, scored from sums over blocks."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Protocol

import numpy as np

from hybrid_dynamics.loop.blocks import Blocks, Folds, Indices
from hybrid_dynamics.loop.gram import BlockGrams
from hybrid_dynamics.loop.sums import FoldSums
from hybrid_dynamics.types import Array


class Products(Protocol):
    """What scores follow from: products ``gram`` of columns and target per joint, and their ``sums`` per fold."""

    n: int
    weights: Array
    blocks: Blocks
    folds: Folds
    gram: list[BlockGrams]
    sums: FoldSums


class Held:
    """Held-out prediction of one combination of terms: every fold predicted by a fit on the others.

    ``folds[f]`` are the coordinates that the other folds gave, ``places`` where those stand among the columns of each
    joint. With the vector v of :meth:`_vector` the residual of a fold is columns @ v, so scores and block-wise products
    of residuals follow from the Gram matrices; nothing is predicted sample by sample.
    """

    def __init__(self, products: Products, places: Sequence[tuple[Indices, Indices]], folds: Sequence[Array]) -> None:
        self._products, self._places, self._folds = products, places, folds
        self.joint_errors = self._errors()

    def _vector(self, fold: int, joint: int) -> Array:
        """What turns the columns of ``joint``, its target as the last one, into the residual of ``fold``."""
        return residual_vector(self._places[joint], self._folds[fold], self._products.gram[joint].size)

    def _errors(self) -> Array:
        """(n,) squared held-out residual sums [N m]^2."""
        out = np.zeros(self._products.n)
        for j, grams in enumerate(self._products.sums.own):
            for f, gram in enumerate(grams):
                v = self._vector(f, j)
                out[j] += max(float(v @ gram @ v), 0.0)
        return out

    @cached_property
    def score(self) -> float:
        """Weighted sum of :attr:`joint_errors`."""
        return float(self.joint_errors @ self._products.weights)

    def change(self, old: Held, new: Held) -> Array:
        """Block-wise sums (blocks, n) [N m]^2 of this residual times the change of the prediction from ``old`` to
        ``new``."""
        products = self._products
        out = np.empty((len(products.blocks), products.n))
        for f, parts in enumerate(products.folds.parts):
            for j, gram in enumerate(products.gram):
                own, change = self._vector(f, j), old._vector(f, j) - new._vector(f, j)
                for part in parts:
                    out[part, j] = gram.forms(own, change, part)
        return out


def residual_vector(place: tuple[Indices, Indices], x: Array, size: int) -> Array:
    """Vector (size,) that turns the columns of a joint, the target as the last, into what coordinates ``x`` leave."""
    position, column = place
    # Two terms may share a column: what they ask of it adds up.
    v = -np.bincount(column, x[position], minlength=size).astype(float)
    v[-1] = 1.0
    return v
