"""Differentiators by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from hybrid_dynamics.differentiate import butterworth, kalman, savitzky_golay, spline, total_variation
from hybrid_dynamics.differentiate.differentiator import Differentiator
from hybrid_dynamics.errors import ConfigError

DIFFERENTIATORS: Mapping[str, Differentiator] = MappingProxyType(
    {
        module.METHOD.name: Differentiator.of(module.METHOD)
        for module in (butterworth, savitzky_golay, spline, kalman, total_variation)
    }
)


def get_differentiator(name: str) -> Differentiator:
    """The differentiator ``name``. Raises :class:`ConfigError` with the names there are."""
    try:
        return DIFFERENTIATORS[name]
    except KeyError:
        raise ConfigError(f"unknown differentiator {name!r}; expected one of {', '.join(DIFFERENTIATORS)}") from None
