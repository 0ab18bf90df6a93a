"""Symbolic regression of one quantity, in rounds on what is left.

One search misses small terms; a search on what it leaves finds them. After each round the terms found so far are fitted
together on all samples, so a stand-in that an early round took for the true term is dropped once that one is found.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import sympy as sp

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.models.expressions import (
    CompiledExpressions,
    canonical,
    complexity,
    format_expression,
    plain_symbols,
)
from hybrid_dynamics.models.symbolic.engines import Engine, variable_names
from hybrid_dynamics.models.symbolic.refit import Fit, Pruning, bases_of, fit_constants, fit_terms
from hybrid_dynamics.models.symbolic.registry import make_engine
from hybrid_dynamics.models.symbolic.settings import (
    Candidate,
    FrontRow,
    SymbolicResult,
    SymbolicSettings,
    best_candidate,
)
from hybrid_dynamics.types import Array

#: Columns that vary less than this are no variables.
_SMALLEST_STD = 1e-9
#: A candidate that multiplies out to more terms than this is used only if it is the selected one.
_MAX_TERMS = 100


def symbolic_regression(
    X: Array,
    y: Array,
    names: Sequence[str],
    settings: SymbolicSettings | None = None,
    *,
    variance: float | None = None,
    joint: int = 1,
    engine: Engine | None = None,
    report: Callable[[int], None] | None = None,
) -> SymbolicResult:
    """An expression for ``y`` (N,) over the columns of ``X`` (N, m), named ``names``, in their units.

    ``variance`` is var(tau), of which the settings' shares are taken (default: the variance of ``y``); ``joint`` is
    noted in the front and varies the seed; ``report`` is told the number of each round
    that is done. Raises :class:`InputError` for shapes that do not match.
    """
    settings = settings or SymbolicSettings()
    X, y = np.asarray(X, float), np.asarray(y, float)
    if X.ndim != 2 or y.shape != (len(X),) or X.shape[1] != len(names) or len(y) < 2:
        raise InputError(
            f"symbolic regression: X {X.shape}, y {y.shape} and {len(names)} names; expected (N, m), (N,), m names"
        )
    total = float(np.var(y)) if variance is None else float(variance)
    search = _Search(X, y, list(names), settings, total, joint, engine or make_engine(settings))
    fit = search.run(report or (lambda number: None))
    expression = canonical(plain_symbols(fit.expression), names)
    spread = float(np.var(y))
    left = y - CompiledExpressions([expression], names)(X)[:, 0]
    share = 1.0 - float(np.mean(left**2)) / spread if spread > 0 else 1.0
    return SymbolicResult(expression, tuple(search.front), share)


class _Search:
    def __init__(
        self, X: Array, y: Array, names: list[str], settings: SymbolicSettings, total: float, joint: int, engine: Engine
    ) -> None:
        self.X, self.y, self.names, self.settings = X, y, names, settings
        self.total, self.joint, self.engine = total, joint, engine
        self.front: list[FrontRow] = []
        spread = np.std(X, axis=0)
        self.used = np.flatnonzero(spread > _SMALLEST_STD)
        self.scale = spread[self.used]
        # What the engine calls x_k is the feature divided by its standard deviation.
        engine_names = variable_names(len(self.used))
        self.physical = {
            sp.Symbol(x, real=True): sp.Symbol(names[k], real=True) / sp.Float(s)
            for x, k, s in zip(engine_names, self.used, self.scale, strict=True)
        }

    def run(self, report: Callable[[int], None]) -> Fit:
        settings = self.settings
        size = float(np.mean(self.y**2))
        fit = Fit((), (), size, size)
        for number in range(1, settings.max_rounds + 1):
            # A round cannot gain more than what is left.
            if fit.held_out <= settings.min_gain * self.total or not len(self.used):
                break
            better = self._round(number, fit)
            report(number)
            before = fit.held_out
            gain = before - better.held_out
            if gain > 0:
                fit = better
                self._note_refit(number, fit)
            if gain < max(settings.min_gain * self.total, settings.min_residual_gain * before):
                break
        self._select_last_refit()
        return fit

    def _round(self, number: int, fit: Fit) -> Fit:
        left = self.y - CompiledExpressions([fit.expression], self.names)(self.X)[:, 0]
        scale = float(np.std(left)) or 1.0
        seed = int(np.random.SeedSequence([self.settings.seed, self.joint, number]).generate_state(1)[0])
        found = self.engine.search(self.X[:, self.used] / self.scale, left / scale, self.settings, seed)
        if not found:
            return fit
        found = [
            Candidate(c.complexity, c.loss * scale**2, scale * c.expression.xreplace(self.physical)) for c in found
        ]
        chosen = best_candidate(found)
        self._note_search(number, found, chosen)
        return self._polynomial(fit, found, chosen) if self.settings.polynomial else self._general(fit, chosen)

    def _polynomial(self, fit: Fit, found: list[Candidate], chosen: Candidate) -> Fit:
        """Every term of the whole front stands for election; elimination keeps what contributes."""
        bases = list(fit.bases)
        for candidate in found:
            terms = bases_of(candidate.expression)
            if len(terms) <= _MAX_TERMS or candidate is chosen:
                bases += terms
        return self._fit(bases)

    def _general(self, fit: Fit, chosen: Candidate) -> Fit:
        """The chosen candidate joins; inner constants by Gauss-Newton, then terms dropped, then once more."""
        best = fit
        bases = [*fit.bases, *bases_of(chosen.expression)]
        for _ in range(2):
            tried = self._fit(bases)
            refined = fit_constants(tried.expression, self.X, self.y, self.names)
            tried = min(tried, self._fit(bases_of(refined)), key=lambda f: f.held_out)
            if tried.held_out < best.held_out:
                best = tried
            bases = list(best.bases)
        return best

    def _fit(self, bases: list[sp.Expr]) -> Fit:
        settings = self.settings
        pruning = Pruning(settings.drop_share * self.total, settings.drop_residual_share, settings.blocks)
        return fit_terms(bases, self.X, self.y, self.names, pruning)

    def _note_search(self, number: int, found: list[Candidate], chosen: Candidate) -> None:
        for candidate in found:
            text = format_expression(plain_symbols(candidate.expression))
            self.front.append(
                FrontRow(self.joint, number, "search", candidate.complexity, candidate.loss, text, candidate is chosen)
            )

    def _note_refit(self, number: int, fit: Fit) -> None:
        text = format_expression(plain_symbols(fit.expression))
        self.front.append(
            FrontRow(self.joint, number, "refit", complexity(fit.expression), fit.mse, text, selected=False)
        )

    def _select_last_refit(self) -> None:
        last = [k for k, row in enumerate(self.front) if row.kind == "refit"][-1:]
        for k in last:
            row = self.front[k]
            self.front[k] = FrontRow(
                row.joint, row.round, row.kind, row.complexity, row.loss, row.expression, selected=True
            )
