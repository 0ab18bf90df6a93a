"""The order in which terms stand in a vector of coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hybrid_dynamics.effects import Term

#: Combinations of terms whose places, constraints and predictions are kept.
KEPT_LAYOUTS = 1000


@dataclass(frozen=True)
class Layout:
    """Where the coordinates of a combination of terms stand: ``positions[term]`` in x, size ``total``."""

    terms: tuple[Term, ...]
    starts: tuple[int, ...]
    total: int

    @cached_property
    def on_surfaces(self) -> tuple[tuple[Term, int], ...]:
        """Terms, and where they begin, whose coordinates lie on a surface."""
        pairs = zip(self.terms, self.starts, strict=True)
        return tuple((term, start) for term, start in pairs if term.family().on_surface)

    @cached_property
    def following(self) -> frozenset[Term]:
        """Terms whose columns follow a model."""
        return frozenset(term for term in self.terms if follows(term))

    @classmethod
    def of(cls, terms: Sequence[Term]) -> Layout:
        """``terms`` one behind the other."""
        starts = np.concatenate([[0], np.cumsum([term.size for term in terms])]).astype(int)
        return cls(tuple(terms), tuple(int(v) for v in starts[:-1]), int(starts[-1]))


def follows(term: Term) -> bool:
    """True where the columns depend on the model that is being fitted."""
    return term.family().uses_load or term.family().uses_torque or term.family().uses_body


def term_order(term: Term) -> tuple[str, int, str]:
    """Key that sorts terms the same way every time."""
    return term.effect, -1 if term.joint is None else term.joint, repr(term.settings)


def make_room(cache: dict[Any, Any]) -> None:
    """Drop the oldest half where ``cache`` is full."""
    if len(cache) >= KEPT_LAYOUTS:
        for asked in list(cache)[: KEPT_LAYOUTS // 2]:
            del cache[asked]
