"""Position -> velocity -> acceleration -> jerk by repeated use of one differentiator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_dynamics.differentiate.choice import MAX_ORDER, Choice
from hybrid_dynamics.differentiate.method import DerivativeMethod
from hybrid_dynamics.errors import ConfigError
from hybrid_dynamics.types import Array


@dataclass(frozen=True)
class Chain:
    """``values[k]`` (T, n) is the k-th derivative (0: the smoothed signal), ``parameters[k - 1]`` (n,) what gave it.

    ``noise_std`` (n,) [unit of the signal] and ``bandwidth`` (n,) [Hz] are estimates from the signal's spectrum.
    """

    values: list[Array]
    parameters: list[Array]
    noise_std: Array
    bandwidth: Array


def derivatives(x: Array, dt: float, method: DerivativeMethod, orders: int = 3, **options: Any) -> Chain:
    """Derivatives 1 to ``orders`` of ``x`` (T, n), each had by ``method`` from the one before.

    The option named after the method's parameter overrides the choice from the data: one number, or a list with one
    entry per derivative, each a number or a list of n.
    """
    if not 1 <= orders <= MAX_ORDER:
        raise ConfigError(f"orders is {orders}; expected 1 to {MAX_ORDER}")
    given = options.pop(method.parameter, None)
    per_order = list(given) if isinstance(given, list | tuple) else [given] * orders
    if len(per_order) < orders:
        raise ConfigError(
            f"{method.name}: {len(per_order)} values of {method.parameter}; expected {orders}, one per derivative"
        )
    columns, _, rest = method.prepare(x, dt, options)
    choices = [Choice(column, dt, **rest) for column in columns.T]
    values, parameters = [columns], []
    for order in range(orders):
        if per_order[order] is None:
            chosen = np.array([choice.next(method) for choice in choices])
        else:
            _, fixed, _ = method.prepare(columns, dt, {method.parameter: per_order[order]})
            chosen = np.array(fixed)
        pairs = [
            method.column(column, dt, float(value), **method.own(rest))
            for column, value in zip(values[-1].T, chosen, strict=True)
        ]
        if order == 0:
            values[0] = np.column_stack([pair[0] for pair in pairs])
        values.append(np.column_stack([pair[1] for pair in pairs]))
        parameters.append(chosen)
    spectra = [choice.spectrum for choice in choices]
    return Chain(values, parameters, np.array([s.noise_std for s in spectra]), np.array([s.bandwidth for s in spectra]))


def joined(chains: Sequence[Chain]) -> Chain:
    """The chain of several signals side by side."""
    return Chain(
        [np.hstack(parts) for parts in zip(*(c.values for c in chains), strict=True)],
        [np.concatenate(parts) for parts in zip(*(c.parameters for c in chains), strict=True)],
        np.concatenate([c.noise_std for c in chains]),
        np.concatenate([c.bandwidth for c in chains]),
    )
