"""Operon (pyoperon, C++): genetic programming with Levenberg-Marquardt on the constants of every tree."""

from __future__ import annotations

import warnings
from importlib import metadata

import numpy as np
import sympy as sp

from hybrid_dynamics.models.expressions import parse_expression
from hybrid_dynamics.models.symbolic.engines import batch_rows, is_finite, pareto, variable_names
from hybrid_dynamics.models.symbolic.settings import Candidate, SymbolicSettings
from hybrid_dynamics.types import Array

_DIGITS = 17


class OperonEngine:
    """Multi-objective search (mean squared error, length).

    Operon knows no ``sign``: it is offered as further inputs ``sign(x_k)``, so sign applies to features, not to
    sub-expressions. The search runs outside Python's lock, hence several at once in threads.
    """

    concurrent = True

    def versions(self) -> dict[str, str]:
        """See :class:`Engine`."""
        return {"pyoperon": metadata.version("pyoperon")}

    def search(self, X: Array, y: Array, settings: SymbolicSettings, seed: int) -> list[Candidate]:
        """See :class:`Engine`."""
        from pyoperon.sklearn import SymbolicRegressor

        rows = batch_rows(len(X), settings.batch, seed)
        names = variable_names(X.shape[1])
        inputs, target = X[rows], y[rows]
        meaning = [sp.Symbol(name, real=True) for name in names]
        if "sign" in settings.operators:
            inputs = np.column_stack([inputs, np.sign(inputs)])
            meaning += [sp.sign(symbol) for symbol in meaning]
        symbols = [name for name in settings.operators if name != "sign"]
        regressor = SymbolicRegressor(
            allowed_symbols=",".join([*symbols, "constant", "variable"]),
            objectives=["mse", "length"],
            optimizer_iterations=1 if settings.polynomial else 5,
            population_size=settings.population,
            max_evaluations=settings.evaluations,
            generations=settings.evaluations,
            max_length=settings.max_length,
            epsilon=1e-14,
            n_threads=1,
            random_state=seed,
        )
        with warnings.catch_warnings():
            # Trees that overflow are simply bad candidates.
            warnings.simplefilter("ignore", RuntimeWarning)
            regressor.fit(inputs, target)
        labels = list(regressor.variables_.values())
        replace = {sp.Symbol(label, real=True): value for label, value in zip(labels, meaning, strict=True)}
        found = []
        for member in regressor.pareto_front_:
            if not np.isfinite(member["mean_squared_error"]):
                continue
            text = regressor.get_model_string(member["tree"], _DIGITS)
            expression = parse_expression(text, labels, real=True).xreplace(replace)
            if is_finite(expression):
                found.append(Candidate(int(member["length"]), float(member["mean_squared_error"]), expression))
        return pareto(found)
