"""The effect catalogue: one module a family, registered by name. A new file in this folder is a new effect."""

from __future__ import annotations

import importlib
import pkgutil

from hybrid_dynamics.effects.base import (
    Effect,
    Family,
    StateTorque,
    Term,
    catalogue,
    family,
    register,
)
from hybrid_dynamics.effects.keys import split_key
from hybrid_dynamics.effects.state import Equivalence, Motion, Parameter, Refined, State

for _module in sorted(module.name for module in pkgutil.iter_modules(__path__)):
    importlib.import_module(f"{__name__}.{_module}")

from hybrid_dynamics.effects.acting import (  # noqa: E402  (needs the filled registry)
    Readings,
    predict,
    readings,
    with_effects,
)
from hybrid_dynamics.effects.gravity_tilt import mounted  # noqa: E402

__all__ = [
    "Effect",
    "Equivalence",
    "Family",
    "Motion",
    "Parameter",
    "Readings",
    "Refined",
    "State",
    "StateTorque",
    "Term",
    "catalogue",
    "family",
    "mounted",
    "predict",
    "readings",
    "register",
    "split_key",
    "with_effects",
]
