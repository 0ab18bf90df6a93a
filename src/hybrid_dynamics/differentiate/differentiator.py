"""The uniform call of all differentiators: ``method(x, dt, **options) -> (x_hat, dx_hat)``."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from hybrid_dynamics.differentiate.choice import Choice
from hybrid_dynamics.differentiate.method import DerivativeMethod
from hybrid_dynamics.types import Array


@dataclasses.dataclass(frozen=True)
class Differentiator(DerivativeMethod):
    """A :class:`DerivativeMethod` that can be called: its parameter is chosen from the data where it is not given."""

    @classmethod
    def of(cls, method: DerivativeMethod) -> Differentiator:
        """The callable form of ``method``."""
        return cls(**{f.name: getattr(method, f.name) for f in dataclasses.fields(method)})

    def __call__(self, x: Array, dt: float, **options: Any) -> tuple[Array, Array]:
        """Smoothed ``x`` and dx/dt, each of the shape of ``x``: (T,) or (T, n), sampled every ``dt`` seconds.

        The option named :attr:`parameter` (a number, or one per column) overrides the choice from the data.
        """
        columns, values, rest = self.prepare(x, dt, options)
        pairs = []
        for j, column in enumerate(columns.T):
            value = values[j] if values is not None else Choice(column, dt, **rest).next(self)
            pairs.append(self.column(column, dt, value, **self.own(rest)))
        shape = np.shape(x)
        return (
            np.column_stack([p[0] for p in pairs]).reshape(shape),
            np.column_stack([p[1] for p in pairs]).reshape(shape),
        )
