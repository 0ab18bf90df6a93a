"""Differentiators by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from hybrid_dynamics.differentiate import butterworth, kalman, savitzky_golay, spline, total_variation
from hybrid_dynamics.differentiate.method import Method
from hybrid_dynamics.errors import ConfigError

METHODS: Mapping[str, Method] = MappingProxyType(
    {module.METHOD.name: module.METHOD for module in (butterworth, savitzky_golay, spline, kalman, total_variation)}
)


def get_method(name: str) -> Method:
    """The differentiator ``name``. Raises :class:`ConfigError` with the names there are."""
    try:
        return METHODS[name]
    except KeyError:
        raise ConfigError(f"unknown differentiator {name!r}; expected one of {', '.join(METHODS)}") from None
