"""Uncertainty of nonlinear parameters: the torque's derivative with respect to them stands beside the columns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.base import ONLY_RUN
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.types import Array


def covariance_with_settings(evidence: Evidence, terms: Sequence[Term], x: Array) -> Array:
    """Covariance (p + m, p + m) of the coordinates ``x`` (p,) and, behind them in the order of ``terms``, of their m
    nonlinear parameters: the block sandwich of :meth:`Evidence.covariance` for the linearisation in both.

    A nonlinear parameter that was refined is as uncertain as if it had been fitted with all others, and makes them as
    uncertain as it must. Without nonlinear parameters the same as :meth:`Evidence.covariance`.
    """
    if not any(s.family().nonlinear_settings for s in terms):
        return evidence.covariance(terms, x)
    layout = evidence.layout(terms)
    tangents = _tangents(evidence, terms, x)
    p, m = layout.total, tangents[0].shape[2]
    a, scores = np.zeros((p + m, p + m)), np.zeros((len(evidence.blocks.rows), p + m))
    a[:p, :p], _ = evidence.normal(layout, evidence.full_gram)
    residuals = evidence.residuals(terms, x)
    for j, (position, column) in enumerate(evidence.indices(layout)):
        where = np.concatenate([position, np.arange(p, p + m)])
        for b, (low, high) in enumerate(evidence.blocks.rows):
            r = evidence.blocks.run[b]
            counted = evidence.mask[r][low:high, j]
            own = evidence.columns.rows[r][j][low:high][counted][:, column]
            rows = np.hstack([own, tangents[r][low:high, j][counted]])
            scores[b, where] += evidence.weights[j] * rows.T @ residuals[r][low:high, j][counted]
            cross = evidence.weights[j] * rows.T @ rows[:, len(position) :]
            a[np.ix_(where, np.arange(p, p + m))] += cross
    a[p:, :p] = a[:p, p:].T
    scale = 1.0 / np.sqrt(np.maximum(np.diag(a), 1e-300))
    scale[np.diag(a) <= 0] = 0.0
    bread = np.linalg.pinv(a * scale[:, None] * scale[None, :], rcond=1e-14, hermitian=True)
    bread = bread * scale[:, None] * scale[None, :]
    blocks = len(scores)
    return np.asarray(bread @ (scores.T @ scores) @ bread * blocks / max(blocks - 1, 1))


def _tangents(evidence: Evidence, terms: Sequence[Term], x: Array) -> list[Array]:
    """Per run, the smoothed derivative (K, n, m) [N m per unit] of the torque with respect to every nonlinear one."""
    layout = evidence.layout(terms)
    out = []
    for run in evidence.runs:
        parts = []
        for term, start in zip(layout.terms, layout.starts, strict=True):
            kind = term.family()
            count = len(kind.nonlinear_settings)
            if not count:
                continue
            full = np.zeros((len(run.time), evidence.n, count))
            if term.options.get(ONLY_RUN) in (None, run.name):
                columns = run.smooth(kind.setting_columns(run.motion, term, x[start : start + term.size]))
                if columns.ndim == 3:
                    full[:] = columns
                else:
                    full[:, term.index] = columns
            parts.append(full)
        out.append(np.concatenate(parts, axis=2))
    return out
