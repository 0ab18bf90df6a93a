"""How the report names the methods and in which order. A method not in the table comes last, under its name."""

from __future__ import annotations

from collections.abc import Iterable

from hybrid_dynamics.models.methods import METHODS

_ORDER = {name: place for place, name in enumerate(METHODS)}

#: What is no learned model: the start, and the truth of a simulated twin.
REFERENCES = tuple(name for name, method in METHODS.items() if method.kind == "reference")

#: Methods whose expression is the torque itself; those of kind ``residual`` give the residual.
TORQUE_EXPRESSIONS = tuple(name for name, method in METHODS.items() if method.kind == "torque")


def label(method: str) -> str:
    """The method's label in table heads."""
    return METHODS[method].label if method in METHODS else method


def what(method: str) -> str:
    """One sentence on the method; empty for a method not listed."""
    return METHODS[method].what if method in METHODS else ""


def in_order(methods: Iterable[str]) -> list[str]:
    """``methods`` without repetition, in the report's order."""
    return sorted(set(methods), key=lambda name: (_ORDER.get(name, len(_ORDER)), name))
