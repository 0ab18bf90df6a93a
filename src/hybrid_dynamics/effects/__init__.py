"""The effect catalogue: one module a family, registered by name. A new file in this folder is a new effect."""

from __future__ import annotations

import importlib
import pkgutil

from hybrid_dynamics.effects.base import (
    Effect,
    Family,
    Motion,
    Parameter,
    Slot,
    StateTorque,
    catalogue,
    family,
    register,
)

for _module in sorted(module.name for module in pkgutil.iter_modules(__path__)):
    importlib.import_module(f"{__name__}.{_module}")

from hybrid_dynamics.effects.plant import plant  # noqa: E402  (needs the filled registry)

__all__ = [
    "Effect",
    "Family",
    "Motion",
    "Parameter",
    "Slot",
    "StateTorque",
    "catalogue",
    "family",
    "plant",
    "register",
]
