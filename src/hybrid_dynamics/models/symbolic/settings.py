"""Settings and results of symbolic regression, whatever the engine."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import sympy as sp

from hybrid_dynamics.errors import require

#: Operators of two arguments and of one, by the names used in the settings.
BINARY = ("add", "sub", "mul", "div")
UNARY = ("sign", "abs", "sin", "cos", "exp", "tanh", "sqrt")
#: With these alone an expression is a polynomial: all its constants are linear once it is expanded.
POLYNOMIAL = ("add", "sub", "mul")
ENGINES = ("operon", "pysr")


@dataclass(frozen=True)
class SymbolicSettings:
    """One search per joint, in rounds on what is left.

    ``operators``      the paper's by default (no division); see :data:`BINARY` and :data:`UNARY`
    ``batch``          rows the search sees at a time (paper: 10^4)
    ``evaluations``    tree evaluations of one round (Operon)
    ``iterations``     iterations of one round (PySR)
    ``max_length``     nodes of one candidate
    ``max_rounds``     rounds at most
    ``min_gain``       rounds end when one gains less than this share of var(tau)
    ``min_residual_gain``  ... or less than this share of what is left (recorded data: the rest is noise)
    ``drop_share``     terms are dropped that contribute less than this share of var(tau) ...
    ``drop_residual_share``  ... plus this share of the variance that is left unexplained
    ``blocks``         contiguous blocks of samples held out in turn to judge what a term contributes
    ``workers``        joints at once; the result does not depend on it
    """

    engine: str = "operon"
    operators: tuple[str, ...] = POLYNOMIAL
    batch: int = 10_000
    evaluations: int = 20_000
    iterations: int = 40
    population: int = 500
    max_length: int = 30
    max_rounds: int = 6
    min_gain: float = 1e-6
    min_residual_gain: float = 0.05
    drop_share: float = 1e-6
    drop_residual_share: float = 0.05
    blocks: int = 5
    workers: int = 2
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "operators", tuple(self.operators))
        require(self.engine in ENGINES, f"sr.engine is {self.engine!r}; expected one of {', '.join(ENGINES)}")
        unknown = [name for name in self.operators if name not in (*BINARY, *UNARY)]
        require(not unknown, f"sr.operators holds {unknown[:1]}; expected some of {', '.join((*BINARY, *UNARY))}")
        require(
            any(name in BINARY for name in self.operators),
            f"sr.operators is {list(self.operators)}; expected at least one of {', '.join(BINARY)}",
        )
        for name in ("batch", "evaluations", "iterations", "population", "max_rounds", "workers"):
            value = getattr(self, name)
            require(value >= 1, f"sr.{name} is {value}; expected 1 or more")
        require(self.blocks >= 2, f"sr.blocks is {self.blocks}; expected 2 or more")
        require(self.max_length >= 3, f"sr.max_length is {self.max_length}; expected 3 or more")
        for name in ("min_gain", "min_residual_gain", "drop_share", "drop_residual_share"):
            value = getattr(self, name)
            require(0 <= value < 1, f"sr.{name} is {value}; expected a share from 0 to below 1")
        require(0 <= self.seed < 2**32, f"sr.seed is {self.seed}; expected 0 to 2^32 - 1")

    @property
    def polynomial(self) -> bool:
        """True where the operators make polynomials only."""
        return all(name in POLYNOMIAL for name in self.operators)


@dataclass(frozen=True)
class Candidate:
    """A member of a Pareto front: ``expression`` over the given variables, ``complexity`` in nodes, ``loss`` = MSE."""

    complexity: int
    loss: float
    expression: sp.Expr


@dataclass(frozen=True)
class FrontRow:
    """A line of the kept front.

    ``kind`` is ``search`` (a candidate for what round ``round`` found left; ``loss`` is its mean squared error there)
    or ``refit`` (the whole expression after that round, constants re-fitted, on all samples). Loss in N^2 m^2.
    ``selected`` marks the candidate with the best trade of loss against complexity, and the last re-fit.
    """

    joint: int
    round: int
    kind: str
    complexity: int
    loss: float
    expression: str
    selected: bool

    def as_dict(self) -> dict[str, Any]:
        """Settings as they stand in a model.json."""
        return asdict(self)


@dataclass(frozen=True)
class SymbolicResult:
    """``expression`` for y, the ``front`` it came from, and the share of y's variance it explains (1 = all)."""

    expression: sp.Expr
    front: tuple[FrontRow, ...]
    share_explained: float


def best_candidate(front: list[Candidate]) -> Candidate:
    """The best trade: among losses within 1.5 of the best, the steepest fall of log loss per node (PySR's "best")."""
    ordered = sorted(front, key=lambda c: (c.complexity, c.loss))
    bound = 1.5 * min(c.loss for c in ordered) + np.finfo(float).tiny
    scores: list[tuple[float, int]] = []
    previous: Candidate | None = None
    for k, candidate in enumerate(ordered):
        fall = 0.0
        if previous is not None and candidate.complexity > previous.complexity:
            ratio = max(candidate.loss, 1e-300) / max(previous.loss, 1e-300)
            fall = -float(np.log(ratio)) / (candidate.complexity - previous.complexity)
        previous = candidate
        if candidate.loss <= bound:
            scores.append((fall, -k))
    return ordered[-max(scores)[1]]
