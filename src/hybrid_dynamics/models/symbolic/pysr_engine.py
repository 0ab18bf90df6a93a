"""PySR, the paper's engine. It runs in Julia; importing it starts Julia, so Julia is looked for first."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import Any

from hybrid_dynamics.errors import MissingDependencyError, needs_extra
from hybrid_dynamics.models.expressions import parse_expression
from hybrid_dynamics.models.symbolic.engines import is_finite, pareto, variable_names
from hybrid_dynamics.models.symbolic.julia import VARIABLES, check_julia, overheard, unusable
from hybrid_dynamics.models.symbolic.settings import BINARY, Candidate, SymbolicSettings
from hybrid_dynamics.types import Array

_JULIA_PACKAGE = "using SymbolicRegression; string(pkgversion(SymbolicRegression))"
_SYMBOLS = {"add": "+", "sub": "-", "mul": "*", "div": "/"}


class PySREngine:
    """PySR in its batching mode, one thread, deterministic; only options that PySR 1.5 and 2.x share."""

    concurrent = False

    def __init__(self) -> None:
        self._julia = check_julia()
        # Without this PythonCall would download a Julia of its own where it does not like the one on the PATH.
        os.environ.setdefault(VARIABLES[0], self._julia)
        self._pysr: Any = None

    def search(self, X: Array, y: Array, settings: SymbolicSettings, seed: int) -> list[Candidate]:
        """See :class:`Engine`. ``KeyboardInterrupt`` where the search was interrupted: half of one is no model."""
        regressor = self._started().PySRRegressor(**regressor_options(settings, len(X), seed))
        names = variable_names(X.shape[1])
        try:
            regressor.fit(X, y, variable_names=names)
        except Exception as error:
            if type(error).__name__ != "JuliaError":
                raise
            raise unusable(self._julia, error) from None
        # PySR ends an interrupted search as if it had been finished, and returns what it has.
        if getattr(regressor, "interrupted_", False):
            raise KeyboardInterrupt
        return read_equations(regressor.equations_.to_dict("records"), names)

    def versions(self) -> dict[str, str]:
        """Versions of PySR, SymbolicRegression and Julia, for the record."""
        pysr = self._started()
        found = {"pysr": str(pysr.__version__)}
        for name, code in (("julia", "string(VERSION)"), ("symbolic_regression", _JULIA_PACKAGE)):
            found[name] = str(pysr.jl.seval(code))
        return found

    def _started(self) -> Any:
        """The module ``pysr``; importing it starts Julia, which takes seconds, and minutes the first time."""
        if self._pysr is None:
            print("pysr: starting Julia (the first time it downloads and compiles its packages: minutes)", flush=True)
            said: list[str] = []
            try:
                with overheard(said), needs_extra("pysr", "sr=pysr"):
                    import pysr
            except (KeyboardInterrupt, MemoryError, MissingDependencyError):
                raise
            except BaseException as error:  # noqa: BLE001 (whatever Julia, juliapkg or PythonCall come up with)
                raise unusable(self._julia, error, "".join(said)) from None
            self._pysr = pysr
        return self._pysr


def regressor_options(settings: SymbolicSettings, samples: int, seed: int) -> dict[str, Any]:
    """Arguments of ``PySRRegressor``: those that 1.5 and 2.x have in common."""
    return {
        "binary_operators": [_SYMBOLS[name] for name in settings.operators if name in BINARY],
        "unary_operators": [name for name in settings.operators if name not in BINARY],
        "niterations": settings.iterations,
        "maxsize": max(settings.max_length, 7),
        "batching": samples > settings.batch,
        "batch_size": settings.batch,
        "precision": 64,
        "random_state": seed,
        "deterministic": True,
        "parallelism": "serial",
        "verbosity": 0,
        "progress": False,
        "temp_equation_file": True,
    }


def read_equations(table: Iterable[Mapping[str, Any]], names: list[str]) -> list[Candidate]:
    """Translate PySR's table (``complexity``, ``loss``, ``equation``) over the variables ``names`` into candidates."""
    found = []
    for row in table:
        expression = parse_expression(str(row["equation"]), names, real=True)
        if is_finite(expression):
            found.append(Candidate(int(row["complexity"]), float(row["loss"]), expression))
    return pareto(found)
