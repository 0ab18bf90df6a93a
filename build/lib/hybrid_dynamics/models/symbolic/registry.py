"""Engines by name. An engine imports its search program when it searches: PySR starts Julia at import."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from hybrid_dynamics.models.symbolic.engines import Engine
from hybrid_dynamics.models.symbolic.operon_engine import OperonEngine
from hybrid_dynamics.models.symbolic.pysr_engine import PySREngine
from hybrid_dynamics.models.symbolic.settings import SymbolicSettings

_ENGINES: Mapping[str, Callable[[], Engine]] = MappingProxyType({"operon": OperonEngine, "pysr": PySREngine})


def make_engine(settings: SymbolicSettings) -> Engine:
    """The engine ``settings.engine`` names; raises :class:`MissingDependencyError` where it cannot run."""
    return _ENGINES[settings.engine]()
