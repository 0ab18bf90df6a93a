"""Gram matrices summed over the blocks of every fold, and over those that a fold is predicted from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_dynamics.loop.blocks import Folds, Indices
from hybrid_dynamics.loop.gram import BlockGrams
from hybrid_dynamics.types import Array


@dataclass(frozen=True)
class FoldSums:
    """Per joint j: ``full[j]`` (size, size), the sum of all blocks; ``own[j]`` (folds, size, size), of each fold's;
    ``others[j]`` (folds, size, size), of those that the fold is predicted from.

    Where a fold ends inside a run, the block next to it is left out of its fit: neighbours are not independent.
    """

    full: tuple[Array, ...]
    own: tuple[Array, ...]
    others: tuple[Array, ...]
    #: Folds, and what each is predicted from, times blocks (2 folds, blocks): one product sums them all.
    _chosen: Array

    @classmethod
    def of(cls, grams: Sequence[BlockGrams], folds: Folds) -> FoldSums:
        """Those of ``grams``, one a joint."""
        chosen = np.zeros((2 * folds.number, len(folds.blocks)))
        for f, (own, edge) in enumerate(zip(folds.own, folds.edges, strict=True)):
            chosen[f, own] = 1.0
            # Summed, not what is left of all blocks: of a column that is elsewhere nothing that may be below zero.
            chosen[folds.number + f] = 1.0
            chosen[folds.number + f, [*own, *edge]] = 0.0
        none = (np.empty(0),) * len(grams)
        return cls(none, none, none, chosen).renewed(grams, dict.fromkeys(range(len(grams))))

    def renewed(self, grams: Sequence[BlockGrams], changed: Mapping[int, Indices | None]) -> FoldSums:
        """The same for ``grams``, of which those of the joints ``changed`` are others: in these columns, or in all."""
        parts = list(zip(self.full, self.own, self.others, strict=True))
        for j, columns in changed.items():
            if columns is None:
                parts[j] = self._parts(grams[j].totals(self._chosen))
                continue
            copies = tuple(part.copy() for part in parts[j])
            for sums, new in zip(copies, self._parts(grams[j].column_totals(columns, self._chosen)), strict=True):
                sums[..., columns, :], sums[..., columns] = new, new.swapaxes(-1, -2)
            parts[j] = (copies[0], copies[1], copies[2])
        full, own, others = zip(*parts, strict=True)
        return FoldSums(full, own, others, self._chosen)

    def _parts(self, sums: Array) -> tuple[Array, Array, Array]:
        """All blocks, those of each fold, and those that it is predicted from; ``sums`` of what is chosen."""
        own, others = np.split(sums, 2)
        return own.sum(axis=0), own, others


def picked(grams: Array, columns: Indices) -> Array:
    """(m, c, c) entries of ``grams`` (m, size, size) in rows and ``columns`` (c,)."""
    many, size = len(grams), grams.shape[-1]
    # Flat places: picking by rows and columns takes several times as long.
    flat = grams.reshape(many, -1).take((columns[:, None] * size + columns).ravel(), axis=1)
    return np.asarray(flat.reshape(many, len(columns), len(columns)))
