"""Symbolic regression as a torque estimator: an independent expression for each joint."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from typing import Any, ClassVar, Self

import numpy as np
import sympy as sp
from sklearn.base import BaseEstimator, RegressorMixin
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from hybrid_dynamics.features import feature_names
from hybrid_dynamics.models.base import Weights, check_data, check_features
from hybrid_dynamics.models.expressions import (
    CompiledExpressions,
    canonical,
    format_expression,
    parse_expression,
)
from hybrid_dynamics.models.symbolic.registry import make_engine
from hybrid_dynamics.models.symbolic.search import symbolic_regression
from hybrid_dynamics.models.symbolic.settings import FrontRow, SymbolicResult, SymbolicSettings
from hybrid_dynamics.types import Array, Progress


class SymbolicEstimator(RegressorMixin, BaseEstimator):
    """One expression a joint. Learned: ``expressions_``, ``shares_explained_`` (n each), ``front_`` (all joints).

    ``versions_`` are those of the programs that searched.
    """

    settings_type: ClassVar[type] = SymbolicSettings

    def __init__(self, settings: SymbolicSettings | None = None, progress: Progress | None = None) -> None:
        self.settings = settings
        self.progress = progress

    def fit(self, X: Array, y: Array, variance: Array | None = None) -> Self:
        """Search for ``y`` (N, n) over ``X`` (N, 7n); ``variance`` (n,) of the whole torque sets what is worth a term.

        ``settings.workers`` joints at once; each joint's result depends on its own seed only. ``progress``
        counts rounds; a joint that needs fewer than allowed counts as if it had taken them all.
        """
        X, y = check_data(X, y)
        settings = self.settings or SymbolicSettings()
        self.n_joints_ = y.shape[1]
        names = feature_names(self.n_joints_)
        total = np.var(y, axis=0) if variance is None else np.asarray(variance, float)
        engine = make_engine(settings)

        rounds = [0] * self.n_joints_

        def note(j: int, number: int) -> None:
            rounds[j] = number
            if self.progress is not None:
                whole = settings.max_rounds * self.n_joints_
                self.progress(sum(rounds) / whole, f"round {sum(rounds)} of {whole}")

        def search(j: int) -> SymbolicResult:
            result = symbolic_regression(
                X,
                y[:, j],
                names,
                settings,
                variance=float(total[j]),
                joint=j + 1,
                engine=engine,
                report=partial(note, j),
            )
            note(j, settings.max_rounds)
            return result

        workers = min(settings.workers, self.n_joints_) if engine.concurrent else 1
        with threadpool_limits(1), ExitStack() as stack:
            found: Iterator[SymbolicResult] = map(search, range(self.n_joints_))
            if workers > 1:
                # The searches and the linear algebra release Python's lock, so threads do. One worker stays in the
                # main thread, where Julia wants to be.
                pool = stack.enter_context(ThreadPoolExecutor(workers))
                found = pool.map(search, range(self.n_joints_))
            results = list(found)
        self.versions_ = engine.versions()
        self.shares_explained_ = tuple(result.share_explained for result in results)
        self.front_: tuple[FrontRow, ...] = tuple(row for result in results for row in result.front)
        self.set_expressions([result.expression for result in results])
        return self

    def set_expressions(self, expressions: list[sp.Expr]) -> None:
        """Take ``expressions`` (one per joint, over the features) as what was learned."""
        self.n_joints_ = len(expressions)
        self.expressions_ = list(expressions)
        self._compiled = CompiledExpressions(self.expressions_, feature_names(self.n_joints_))

    def expressions(self) -> list[sp.Expr]:
        """One a joint."""
        return list(self.expressions_)

    def front(self) -> list[dict[str, Any]]:
        """The kept Pareto front of every joint and round."""
        return [row.as_dict() for row in self.front_]

    @property
    def engine(self) -> str:
        """As the settings name it."""
        return (self.settings or SymbolicSettings()).engine

    def document(self, weights: Weights, path: str) -> dict[str, Any]:
        """See :class:`LayerEstimator`."""
        return {
            "kind": "symbolic",
            "joints": self.n_joints_,
            "settings": asdict(self.settings or SymbolicSettings()),
            "versions": dict(getattr(self, "versions_", {})),
            "expressions": [format_expression(expression) for expression in self.expressions_],
            "shares_explained": list(self.shares_explained_),
            "front": self.front(),
        }

    @classmethod
    def from_document(cls, document: dict[str, Any], weights: Weights) -> Self:
        """See :class:`LayerEstimator`; an expression is parsed, never evaluated."""
        estimator = cls(SymbolicSettings(**document["settings"]))
        names = feature_names(int(document["joints"]))
        texts = [str(text) for text in document["expressions"]]
        estimator.set_expressions([canonical(parse_expression(text, names), names) for text in texts])
        estimator.shares_explained_ = tuple(float(share) for share in document["shares_explained"])
        estimator.versions_ = {str(k): str(v) for k, v in document.get("versions", {}).items()}
        estimator.front_ = tuple(FrontRow(**row) for row in document["front"])
        return estimator

    def predict(self, X: Array) -> Array:
        """(N, n) [N m]."""
        return self._compiled(check_features(X, self.n_joints_))
