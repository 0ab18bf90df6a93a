"""Interpretable hybrid robot dynamics: torque = rigid body + residual, and the physical effect behind the residual.

The names below are what others may rely on; everything else may move. They are imported when they are first used, so
that ``import hybrid_dynamics`` costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hybrid_dynamics.effects.base import Family
    from hybrid_dynamics.loop.close import LoopResult, close_loop
    from hybrid_dynamics.loop.model import Model, load_model
    from hybrid_dynamics.loop.settings import LoopSettings
    from hybrid_dynamics.readers.log import read_log
    from hybrid_dynamics.robots.robot import Robot

_HOMES = {
    "Family": "effects.base",
    "LoopResult": "loop.close",
    "LoopSettings": "loop.settings",
    "Model": "loop.model",
    "Robot": "robots.robot",
    "close_loop": "loop.close",
    "load_model": "loop.model",
    "read_log": "readers.log",
}

__all__ = ["Family", "LoopResult", "LoopSettings", "Model", "Robot", "close_loop", "load_model", "read_log"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
