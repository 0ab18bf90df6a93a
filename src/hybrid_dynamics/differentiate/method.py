"""What is known of a differentiator: one column differentiated, the parameter that smooths, its response."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_dynamics.differentiate.edges import transient_samples
from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.types import Array

#: Options that every method takes, and that concern the choice of its parameter only.
OPTIONS = ("criterion",)


@dataclass(frozen=True)
class DerivativeMethod:
    """A differentiator with one parameter that sets how much it smooths.

    ``column`` differentiates one signal with that ``parameter`` given. ``candidates(x, dt)`` are the values worth
    trying, from strong to weak smoothing. ``response(frequency, dt, value, **options)`` is, for a linear method, the
    response of its derivative over that of the exact derivative (1 = exact; real, as nothing is delayed); None for a
    nonlinear one. ``edge(value, dt)`` is the number of samples at each end that feel the end; ``weaker`` the factor on
    the parameter that makes for clearly less smoothing.
    """

    name: str
    parameter: str
    column: Callable[..., tuple[Array, Array]]
    candidates: Callable[[Array, float], Array]
    response: Callable[..., Array] | None
    options: tuple[str, ...] = ()
    edge: Callable[[float, float], int] = transient_samples
    weaker: float = 1.5

    def own(self, options: dict[str, Any]) -> dict[str, Any]:
        """Those of ``options`` that the method itself understands."""
        return {name: value for name, value in options.items() if name in self.options}

    def prepare(self, x: Array, dt: float, options: dict[str, Any]) -> tuple[Array, list[float] | None, dict[str, Any]]:
        """``x`` as columns (T, n), the parameter of each column where it is given, the other options."""
        known = (self.parameter, *self.options, *OPTIONS)
        for name in options:
            if name not in known:
                raise ConfigError(f"{self.name}: unknown option {name!r}; expected one of {', '.join(known)}")
        if not (np.isfinite(dt) and dt > 0):
            raise ConfigError(f"{self.name}: dt is {dt}; expected a positive number of seconds")
        x = np.asarray(x, float)
        if x.ndim not in (1, 2):
            raise InputError(f"{self.name}: the signal has {x.ndim} dimensions; expected (T,) or (T, n)")
        columns = x.reshape(len(x), -1)
        if not np.all(np.isfinite(columns)):
            row = int(np.argmax(~np.all(np.isfinite(columns), axis=1)))
            raise InputError(f"{self.name}: the signal is not finite at row {row + 1}; remove or repair the row")
        rest = {name: value for name, value in options.items() if name != self.parameter}
        given = options.get(self.parameter)
        if given is None:
            return columns, None, rest
        values = [float(v) for v in np.broadcast_to(np.atleast_1d(given), (columns.shape[1],))]
        for value in values:
            if not (np.isfinite(value) and value > 0):
                raise ConfigError(f"{self.name}: {self.parameter} is {value}; expected a positive number")
        return columns, values, rest


def cutoff_candidates(x: Array, dt: float) -> Array:
    """Cut-off frequencies [Hz] from four periods a run to 0.45 of the sampling rate, 30 a decade."""
    low, high = min(4 / (len(x) * dt), 0.1 / dt), 0.45 / dt
    return np.geomspace(low, high, max(int(30 * np.log10(high / low)), 2))
