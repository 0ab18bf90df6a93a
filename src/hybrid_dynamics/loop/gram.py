"""Gram matrices of one joint, one for each block of time, packed: half the memory, and one product forms all blocks."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.types import Array

Indices = NDArray[np.int_]
#: What selects blocks.
Blocks = slice | Indices | NDArray[np.bool_]

#: Of all columns the share up to which picking the entries of a form costs less than reading all of them.
FEW = 0.5


@lru_cache(maxsize=64)
def _lower(size: int) -> tuple[Indices, Indices]:
    """Rows and columns of the lower triangle, row by row: rows that are appended leave the others where they are."""
    return np.tril_indices(size)


class BlockGrams:
    """``blocks`` symmetric matrices (``size``, ``size``); ``values`` (blocks, size (size + 1) / 2): lower triangles."""

    def __init__(self, blocks: int, size: int) -> None:
        self.size, self.values = size, np.zeros((blocks, size * (size + 1) // 2))

    @classmethod
    def of(cls, matrices: Array) -> BlockGrams:
        """Packed ``matrices`` (blocks, size, size)."""
        out = cls(len(matrices), matrices.shape[1])
        rows, columns = _lower(out.size)
        out.values[:] = matrices[:, rows, columns]
        return out

    def grown(self, size: int) -> BlockGrams:
        """The same with zeros for columns before the last one, up to ``size`` columns."""
        out, first = BlockGrams(len(self.values), size), self.size - 1
        kept = first * self.size // 2
        out.values[:, :kept] = self.values[:, :kept]
        out.last[:, :first], out.last[:, -1] = self.last[:, :first], self.last[:, -1]
        return out

    @property
    def last(self) -> Array:
        """(blocks, size) products with the last column; a view."""
        return self.values[:, self.values.shape[1] - self.size :]

    def put(self, columns: Indices, products: Array) -> None:
        """``products`` (blocks, c, size) of ``columns`` (c,) with all columns."""
        self.values[:, _places(columns[:, None], np.arange(self.size))] = products

    def pick(self, rows: Indices, columns: Indices, blocks: Blocks = slice(None)) -> Array:
        """Entries (blocks, rows, columns)."""
        places = _places(rows[:, None], columns[None, :])
        return np.asarray(self.values[blocks][:, places])

    def totals(self, weights: Array) -> Array:
        """(m, size, size) sums over blocks, each times its ``weights`` (m, blocks)."""
        sums = weights @ self.values
        out = np.empty((len(weights), self.size, self.size))
        for row in range(self.size):
            start = row * (row + 1) // 2
            out[:, row, : row + 1] = out[:, : row + 1, row] = sums[:, start : start + row + 1]
        return out

    def column_totals(self, columns: Indices, weights: Array) -> Array:
        """Rows ``columns`` (c,) of the same, (m, c, size)."""
        places = _places(columns[:, None], np.arange(self.size))
        sums = weights @ self.values[:, places.ravel()]
        return np.asarray(sums.reshape(len(weights), len(columns), self.size))

    def forms(self, v: Array, w: Array, blocks: Blocks = slice(None)) -> Array:
        """(blocks,) v' G w of ``v`` and ``w`` (size,); no copy where ``blocks`` is a slice."""
        used = np.flatnonzero((v != 0) | (w != 0))
        product = np.outer(v[used], w[used])
        rows, columns = _lower(len(used))
        weight = product[rows, columns] + product[columns, rows]
        weight[rows == columns] *= 0.5
        if len(used) == self.size:
            return np.asarray(self.values[blocks] @ weight)
        places = _places(used[rows], used[columns])
        if len(used) <= FEW * self.size:
            return np.asarray(self.values[blocks][:, places] @ weight)
        full = np.zeros(self.values.shape[1])
        full[places] = weight
        return np.asarray(self.values[blocks] @ full)


def _places(rows: Indices, columns: Indices) -> Indices:
    """Where entries stand among the packed ones."""
    high, low = np.maximum(rows, columns), np.minimum(rows, columns)
    return np.asarray(high * (high + 1) // 2 + low)
