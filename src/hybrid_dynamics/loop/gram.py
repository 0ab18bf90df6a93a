"""Gram matrices of one joint, one for each block of time, packed: half the memory, and one product forms all blocks.

A value. Products of columns that follow no model never change, so all values that have them share them; those of what
does change (columns that follow a model, the target) are a small part of the whole and stand by themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
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
    """Symmetric matrices (``size``, ``size``); of each the ``moving`` columns and the last one may be replaced.

    ``packed``: of the other columns lower triangles (blocks, entries) row by row, the first rows and those that came
    later; ``strip`` (blocks, m + 1, size): products of the moving columns and, behind them, the last one with all.
    """

    def __init__(self, moving: Indices, packed: tuple[Array, Array], strip: Array) -> None:
        self.size = strip.shape[2]
        self._packed, self._strip = packed, strip
        for array in (*packed, strip):
            array.flags.writeable = False
        #: Columns of the rows of the strip, and the other ones.
        self._of_strip = np.append(moving, self.size - 1)
        still = np.ones(self.size, bool)
        still[self._of_strip] = False
        self._still = np.flatnonzero(still)
        #: Where a column stands among those of its kind.
        self._at = np.empty(self.size, int)
        self._at[self._still], self._at[self._of_strip] = np.arange(len(self._still)), np.arange(len(self._of_strip))

    @classmethod
    def of(cls, matrices: Array, moving: Sequence[int] | Indices = ()) -> BlockGrams:
        """Packed ``matrices`` (blocks, size, size)."""
        which = np.asarray(moving, int)
        still = np.setdiff1d(np.arange(matrices.shape[1] - 1), which)
        rows, columns = _lower(len(still))
        packed = matrices[:, still[rows], still[columns]], np.empty((len(matrices), 0))
        return cls(which, packed, matrices[:, np.append(which, matrices.shape[1] - 1)])

    @property
    def last(self) -> Array:
        """(blocks, size) products with the last column; a view."""
        return self._strip[:, -1]

    def grown(self, products: Array, moving: Sequence[int] | Indices = ()) -> BlockGrams:
        """The same with c new columns before the last one, of which some may be ``moving``; ``products`` (blocks, c,
        size + c) with all."""
        blocks, count, size = products.shape
        first = self.size - 1
        which, others = np.asarray(moving, int), self._of_strip[:-1]
        strip = np.empty((blocks, len(others) + len(which) + 1, size))
        old = np.r_[: len(others), strip.shape[1] - 1]
        strip[:, old, :first], strip[:, old, -1] = self._strip[:, :, :first], self._strip[:, :, -1]
        strip[:, old, first:-1] = products[:, :, np.append(others, size - 1)].swapaxes(1, 2)
        strip[:, len(others) : -1] = products[:, which - first]
        new = np.setdiff1d(np.arange(first, first + count), which)
        columns = np.concatenate([self._still, new])
        rows = [products[:, k - first, columns[: len(self._still) + i + 1]] for i, k in enumerate(new)]
        base, later = self._packed
        later = np.hstack([later, *rows])
        if later.shape[1] > base.shape[1]:
            base, later = np.hstack([base, later]), np.empty((blocks, 0))
        return BlockGrams(np.append(others, which), (base, later), strip)

    def replaced(self, columns: Indices, products: Array) -> BlockGrams:
        """The same with other ``products`` (blocks, c, size) of ``columns`` (c,), moving ones or the last."""
        assert np.isin(columns, self._of_strip).all()
        strip = self._strip.copy()
        strip[:, self._at[columns]] = products
        strip[:, :, columns] = products[:, :, self._of_strip].swapaxes(1, 2)
        return BlockGrams(self._of_strip[:-1], self._packed, strip)

    def pick(self, rows: Indices, columns: Indices, blocks: Blocks = slice(None)) -> Array:
        """Entries (blocks, rows, columns)."""
        strip = self._strip[blocks]
        out = np.empty((len(strip), len(rows), len(columns)))
        moving, still = ([np.isin(which, own) for which in (rows, columns)] for own in (self._of_strip, self._still))
        places = _places(self._at[rows[still[0]]][:, None], self._at[columns[still[1]]][None, :])
        out[:, still[0][:, None] & still[1]] = self._entries(places.ravel(), blocks)
        out[:, moving[0]] = strip[:, self._at[rows[moving[0]]][:, None], columns]
        out[:, :, moving[1]] = strip[:, self._at[columns[moving[1]]], rows[:, None]]
        return out

    def _entries(self, places: Indices, blocks: Blocks) -> Array:
        """(blocks, e) of the packed ones."""
        cut = self._packed[0].shape[1]
        if not self._packed[1].shape[1]:
            return np.asarray(self._packed[0][blocks][:, places])
        out = np.empty((len(self._strip[blocks]), len(places)))
        for part, mine, start in zip(self._packed, (places < cut, places >= cut), (0, cut), strict=True):
            out[:, mine] = part[blocks][:, places[mine] - start]
        return out

    def totals(self, weights: Array) -> Array:
        """(m, size, size) sums over blocks, each times its ``weights`` (m, blocks)."""
        sums = np.hstack([weights @ part for part in self._packed])
        rows, columns = (self._still[which] for which in _lower(len(self._still)))
        out = np.empty((len(weights), self.size, self.size))
        out[:, rows, columns] = out[:, columns, rows] = sums
        moving = self._of_strip
        out[:, moving] = np.tensordot(weights, self._strip, 1)
        out[:, :, moving] = out[:, moving].swapaxes(1, 2)
        return out

    def column_totals(self, columns: Indices, weights: Array) -> Array:
        """Rows ``columns`` (c,) of the same, (m, c, size)."""
        return np.asarray(np.tensordot(weights, self.pick(columns, np.arange(self.size)), 1))

    def forms(self, v: Array, w: Array, blocks: Blocks = slice(None)) -> Array:
        """(blocks,) v' G w of ``v`` and ``w`` (size,); no copy where ``blocks`` is a slice."""
        out = self._still_forms(v[self._still], w[self._still], blocks)
        for row, column in enumerate(self._of_strip):
            if v[column] or w[column]:
                weight = v[column] * w + w[column] * v
                weight[self._of_strip] = v[column] * w[self._of_strip]
                out += self._strip[blocks, row] @ weight
        return out

    def _still_forms(self, v: Array, w: Array, blocks: Blocks) -> Array:
        """The part of the columns that never change, ``v`` and ``w`` (p,) of these."""
        used = np.flatnonzero((v != 0) | (w != 0))
        product = np.outer(v[used], w[used])
        rows, columns = _lower(len(used))
        weight = product[rows, columns] + product[columns, rows]
        weight[rows == columns] *= 0.5
        if len(used) < len(v):
            places = _places(used[rows], used[columns])
            if len(used) <= FEW * len(v):
                return np.asarray(self._entries(places, blocks) @ weight)
            some, weight = weight, np.zeros(sum(part.shape[1] for part in self._packed))
            weight[places] = some
        base, later = self._packed
        out = np.asarray(base[blocks] @ weight[: base.shape[1]])
        return out + later[blocks] @ weight[base.shape[1] :] if later.shape[1] else out


def _places(rows: Indices, columns: Indices) -> Indices:
    """Where entries stand among the packed ones."""
    high, low = np.maximum(rows, columns), np.minimum(rows, columns)
    return np.asarray(high * (high + 1) // 2 + low)
