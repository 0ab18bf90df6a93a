"""PySR, the paper's engine. It runs in Julia; importing it starts Julia, so Julia is looked for first."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from hybrid_dynamics.errors import MissingDependencyError, needs_extra
from hybrid_dynamics.models.expressions import parse_expression
from hybrid_dynamics.models.symbolic.engines import is_finite, pareto, variable_names
from hybrid_dynamics.models.symbolic.settings import BINARY, Candidate, SymbolicSettings
from hybrid_dynamics.types import Array

_SYMBOLS = {"add": "+", "sub": "-", "mul": "*", "div": "/"}


def find_julia() -> str | None:
    """Path of a Julia program: the one PythonCall is told to use, on the PATH, in juliaup or installed by juliapkg."""
    for variable in ("PYTHON_JULIAPKG_EXE", "PYTHON_JULIACALL_EXE"):
        if os.environ.get(variable):
            return shutil.which(os.environ[variable])
    places = [
        Path(sys.prefix) / "julia_env" / "pyjuliapkg" / "install" / "bin",
        Path.home() / ".juliaup" / "bin",
    ]
    return shutil.which("julia") or shutil.which("julia", path=os.pathsep.join(str(place) for place in places))


class PySREngine:
    """PySR in its batching mode, one thread, deterministic; only options that PySR 1.5 and 2.x share."""

    concurrent = False

    def __init__(self) -> None:
        julia = find_julia()
        if julia is None:
            raise MissingDependencyError(
                "sr=pysr needs Julia, and none was found; install Julia 1.10 or later from "
                "https://julialang.org/downloads and put it on the PATH, or choose sr=operon, which needs nothing more"
            )
        # Without this PythonCall would download a Julia of its own where it does not like the one on the PATH.
        os.environ.setdefault("PYTHON_JULIAPKG_EXE", julia)

    def search(self, X: Array, y: Array, settings: SymbolicSettings, seed: int) -> list[Candidate]:
        """See :class:`Engine`."""
        with needs_extra("pysr", "sr=pysr"):
            from pysr import PySRRegressor

        regressor = PySRRegressor(**regressor_options(settings, len(X), seed))
        names = variable_names(X.shape[1])
        regressor.fit(X, y, variable_names=names)
        return read_equations(regressor.equations_.to_dict("records"), names)


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
