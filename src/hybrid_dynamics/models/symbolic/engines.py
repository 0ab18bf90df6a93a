"""What an engine that searches for expressions is: ``search(X, y, settings, seed) -> Pareto front``."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from hybrid_dynamics.models.symbolic.settings import Candidate, SymbolicSettings
from hybrid_dynamics.types import Array


class Engine(Protocol):
    """A search over expressions. Same arguments, same result."""

    #: Whether several searches may run in threads of one process.
    concurrent: bool

    def search(self, X: Array, y: Array, settings: SymbolicSettings, seed: int) -> list[Candidate]:
        """Candidates for ``y`` (N,) over the columns of ``X`` (N, m), as expressions over ``x0 .. x{m-1}`` (real)."""
        ...

    def versions(self) -> dict[str, str]:
        """Versions of the programs that search, for the record."""
        ...


def variable_names(count: int) -> list[str]:
    """``x0 x1 ...``: what the engines call the columns."""
    return [f"x{k}" for k in range(count)]


def batch_rows(samples: int, batch: int, seed: int) -> NDArray[np.intp]:
    """At most ``batch`` row numbers, without repetition, in order."""
    if samples <= batch:
        return np.arange(samples)
    return np.sort(np.random.default_rng(seed).choice(samples, batch, replace=False))


def pareto(candidates: list[Candidate]) -> list[Candidate]:
    """The candidates that no simpler or equally simple one beats, by rising complexity."""
    front: list[Candidate] = []
    for candidate in sorted(candidates, key=lambda c: (c.complexity, c.loss, str(c.expression))):
        if np.isfinite(candidate.loss) and (not front or candidate.loss < front[-1].loss):
            front.append(candidate)
    return front


def is_finite(expression: sp.Expr) -> bool:
    """Whether the expression holds neither infinity nor NaN."""
    return not expression.has(sp.nan, sp.zoo, sp.oo, -sp.oo, sp.I)
