"""Rows of a recording: which stamps are in order, and how to name rows in a message."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.types import Array


def longest_increasing(stamps: Array) -> NDArray[np.int64]:
    """Indices of the longest strictly increasing subsequence (patience sorting)."""
    if (np.diff(stamps) > 0).all():
        return np.arange(len(stamps))
    tails: list[float] = []
    tail_index: list[int] = []
    previous = np.full(len(stamps), -1)
    for k, value in enumerate(stamps):
        place = int(np.searchsorted(tails, value))
        previous[k] = tail_index[place - 1] if place else -1
        tails[place : place + 1] = [float(value)]
        tail_index[place : place + 1] = [k]
    chain = [tail_index[-1]]
    while previous[chain[-1]] >= 0:
        chain.append(int(previous[chain[-1]]))
    return np.array(chain[::-1])


def row_ranges(rows: NDArray[np.int64]) -> str:
    """``2-10, 6107`` for the row numbers ``rows``; the first ten ranges."""
    groups = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    text = [str(g[0]) if len(g) == 1 else f"{g[0]}-{g[-1]}" for g in groups[:10]]
    return ", ".join(text) + (", ..." if len(groups) > 10 else "")
