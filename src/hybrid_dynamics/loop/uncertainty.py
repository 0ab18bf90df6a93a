"""How far a measured torque may lie from the prediction without anything being wrong.

Two parts: the parameters are known with an error (their covariance, as the fit gives it), and what the completed model
left on held-out runs, noise and whatever it does not explain. A collision threshold is a multiple of the sum.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.types import Array

#: Rows that the correlation is computed from, about; parameters it is computed for, at most: two arms of seven joints
#: with all their links. Without it what the runs leave open would count as if nothing else made up for it.
_ROWS, _MOST_PARAMETERS = 5_000, 300
#: How strongly a parameter is held at its value, in standard errors: what the runs leave open has its standard error
#: from a prior, so there one error is about what it may differ by; what they determine must hardly notice.
_PRIOR = 0.01
#: Halvings of a step that leads out of what a parameter may be; after them it is at the end of that, and stays.
_HALVINGS = 40


@dataclass(frozen=True)
class Uncertainty:
    """``residual`` (n,) [N m]: rms of what was left on held-out runs, at least the noise floor.

    ``correlation`` (P, P) of the uncertain parameters in the order of :func:`uncertain_parameters`; None where only
    their standard errors are known (they count as independent then).
    """

    residual: Array
    correlation: Array | None = None

    def standard_deviation(
        self, model: Model, q: Array, dq: Array, ddq: Array, time: Array | None, smooth: Callable[[Array], Array]
    ) -> Array:
        """(T, n) [N m] of measured minus predicted torque, both passed through ``smooth``."""
        variance = np.broadcast_to(self.residual**2, np.shape(q)).copy()
        changes = [smooth(change) for change in _changes(model, q, dq, ddq, time)]
        if not changes:
            return np.asarray(np.sqrt(variance))
        if self.correlation is None or len(self.correlation) != len(changes):
            variance += sum(change**2 for change in changes)
        else:
            # C = L L': the sum of squares of the columns of D L is diag(D C D') without a negative rounding.
            values, vectors = np.linalg.eigh(self.correlation)
            root = vectors * np.sqrt(np.maximum(values, 0.0))
            for column in root.T:
                variance += sum(w * change for w, change in zip(column, changes, strict=True)) ** 2
        return np.asarray(np.sqrt(variance))


def correlation_of(model: Model, runs: Sequence[Run], residual: Array) -> Array | None:
    """(P, P) correlation of the uncertain parameters as the training ``runs`` determine them together.

    From the normal equations of the prediction's sensitivities on moving rows, each joint weighed by its ``residual``
    (n,) [N m]. None where there is nothing to correlate, or more parameters than a file should hold.
    """
    count = len(uncertain_parameters(model.effects))
    if not 2 <= count <= _MOST_PARAMETERS:
        return None
    normal = np.zeros((count, count))
    stride = max(sum(len(run.time) for run in runs) // _ROWS, 1)
    for run in runs:
        rows = slice(None, None, stride)
        changes = np.array(_changes(model, run.q[rows], run.dq[rows], run.ddq[rows], run.time[rows]))
        weight = run.mask[rows] / np.where(residual > 0, residual, np.inf) ** 2
        normal += np.einsum("atj,tj,btj->ab", changes, weight, changes, optimize=True)
    inverse = np.linalg.inv(normal + _PRIOR * np.eye(count))
    spread = np.sqrt(np.diag(inverse))
    return np.asarray(np.clip(inverse / spread[:, None] / spread, -1.0, 1.0))


def uncertain_parameters(effects: tuple[Effect, ...]) -> list[tuple[int, str]]:
    """(index of the effect, name of the parameter) of all that have a standard error, in the model's order."""
    return [
        (k, name)
        for k, effect in enumerate(effects)
        for name in effect.parameters
        if effect.std_errors.get(name, 0) > 0
    ]


def _changes(model: Model, q: Array, dq: Array, ddq: Array, time: Array | None) -> list[Array]:
    """Change of the prediction (T, n) [N m] with one standard error of each uncertain parameter."""
    out = []
    for k, name in uncertain_parameters(model.effects):
        effect = model.effects[k]
        *moved, share = _moved(effect, name)
        sides = [
            Model(model.robot, (*model.effects[:k], other, *model.effects[k + 1 :])).predict(q, dq, ddq, time)
            for other in moved
        ]
        out.append((sides[0] - sides[1]) / (2 * share))
    return out


def _moved(effect: Effect, name: str) -> tuple[Effect, Effect, float]:
    """``effect`` with parameter ``name`` above and below its value, and by what share of its standard error.

    The share is less than one where the error is larger than what the parameter may differ by: a speed at which
    friction falls, known to half its size only, is no speed below zero.
    """
    value, error = effect.parameters[name], effect.std_errors[name]
    for halvings in range(_HALVINGS):
        share = 0.5**halvings
        try:
            above, below = (
                replace(effect, parameters={**effect.parameters, name: value + sign * share * error})
                for sign in (1.0, -1.0)
            )
        except InputError:
            continue
        return above, below, share
    return effect, effect, 1.0


def uncertainty_from(value: Mapping[str, Any]) -> Uncertainty:
    """From the block ``uncertainty`` of ``model.json``."""
    correlation = value.get("correlation")
    return Uncertainty(
        np.asarray(value["residual"], float), None if correlation is None else np.asarray(correlation, float)
    )
