"""Gram matrices summed over the blocks of every fold, and over those that a fold is predicted from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.loop.blocks import Folds, Indices
from hybrid_dynamics.loop.gram import BlockGrams
from hybrid_dynamics.types import Array


class FoldSums:
    """Per joint j: ``full[j]`` (size, size), the sum of all blocks; ``own[j]`` (folds, size, size), of each fold's;
    ``others[j]`` (folds, size, size), of those that the fold is predicted from.

    Where a fold ends inside a run, the block next to it is left out of its fit: neighbours are not independent.
    """

    def __init__(self, grams: Sequence[BlockGrams], folds: Folds) -> None:
        self._folds = folds.number
        #: Folds, and what borders on them, times blocks: one product sums them all.
        self._chosen = np.zeros((2 * folds.number, len(folds.blocks)))
        for f, (own, edge) in enumerate(zip(folds.own, folds.edges, strict=True)):
            self._chosen[f, own] = 1.0
            self._chosen[folds.number + f, edge] = 1.0
        self.full: list[Array] = [np.empty(0)] * len(grams)
        self.own, self.others = self.full.copy(), self.full.copy()
        for j, gram in enumerate(grams):
            self.renew(j, gram)

    def renew(self, joint: int, gram: BlockGrams) -> None:
        """Sum all of ``gram``, that of ``joint``, anew."""
        self.full[joint], self.own[joint], self.others[joint] = self._parts(gram.totals(self._chosen))

    def renew_columns(self, joint: int, gram: BlockGrams, columns: Indices) -> None:
        """The same where only the products of ``columns`` with the others have changed."""
        old = self.full[joint], self.own[joint], self.others[joint]
        for sums, new in zip(old, self._parts(gram.column_totals(columns, self._chosen)), strict=True):
            sums[..., columns, :], sums[..., columns] = new, new.swapaxes(-1, -2)

    def _parts(self, sums: Array) -> tuple[Array, Array, Array]:
        """All blocks, those of each fold, and those that it is predicted from; ``sums`` of what is chosen."""
        own, edge = sums[: self._folds], sums[self._folds :]
        full = own.sum(axis=0)
        return full, own, full - own - edge
