"""Uncertainty of nonlinear parameters: the torque's derivative with respect to them stands beside the columns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.base import ONLY_RUN
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.factor import common_factor, links_of, own_parameters, shared_gain
from hybrid_dynamics.loop.jackknife import covariance_of
from hybrid_dynamics.types import Array


def published_covariance(evidence: Evidence, terms: Sequence[Term], x: Array) -> Array:
    """:func:`covariance_with_settings`, and beside all links' parameters what makes a gain of all joints uncertain.

    The two can make the same torque; where one ends and the other begins only the links of the starting model say
    (:mod:`.factor`). A larger gain goes with lighter links and less friction, so those are as uncertain.
    """
    covariance = covariance_with_settings(evidence, terms, x)
    layout = evidence.layout(terms)
    place, found = shared_gain(layout), links_of(layout)
    if place is None or found is None:
        return covariance
    factor = common_factor(evidence, terms, x, covariance[: layout.total, : layout.total])
    assert factor is not None
    links, own = found
    along = np.zeros(len(covariance))
    for term, start in zip(layout.terms, layout.starts, strict=True):
        if term.family().everywhere:
            along[start : start + term.size] = -x[start : start + term.size] / (1.0 + x[place])
    along[own] = -(own_parameters(evidence, links) + x[own]) / (1.0 + x[place])
    along[place] = 1.0
    return np.asarray(covariance + factor.error**2 * np.outer(along, along))


def covariance_with_settings(evidence: Evidence, terms: Sequence[Term], x: Array) -> Array:
    """Covariance (p + m, p + m) of the coordinates ``x`` (p,) and, behind them in the order of ``terms``, of their m
    nonlinear parameters: :meth:`Evidence.covariance` for the linearisation in both.

    A nonlinear parameter that was refined is as uncertain as if it had been fitted with all others, and makes them as
    uncertain as it must. Without nonlinear parameters the same as :meth:`Evidence.covariance`.
    """
    if not any(s.family().refined_at(s) for s in terms):
        return evidence.covariance(terms, x)
    layout = evidence.layout(terms)
    tangents = _tangents(evidence, terms, x)
    p, m, blocks = layout.total, tangents[0].shape[2], len(evidence.blocks)
    normal, parts, scores = np.zeros((p + m, p + m)), np.zeros((blocks, p + m, p + m)), np.zeros((blocks, p + m))
    normal[:p, :p], parts[:, :p, :p], scores[:, :p] = evidence.by_block(layout, x)
    residuals = evidence.residuals(terms, x)
    new = np.arange(p, p + m)
    for j, (position, column) in enumerate(evidence.indices(layout)):
        for b, (low, high) in enumerate(evidence.blocks.rows):
            r = evidence.blocks.run[b]
            counted = evidence.mask[r][low:high, j]
            own = tangents[r][low:high, j][counted]
            known = evidence.columns.rows[r][j][low:high][counted][:, column]
            cross = evidence.weights[j] * known.T @ own
            parts[b][np.ix_(position, new)] += cross
            parts[b][np.ix_(new, position)] += cross.T
            parts[b][p:, p:] += evidence.weights[j] * own.T @ own
            scores[b, p:] += evidence.weights[j] * own.T @ residuals[r][low:high, j][counted]
    summed = parts.sum(axis=0)
    normal[:, p:], normal[p:, :p] = summed[:, p:], summed[p:, :p]
    return covariance_of(normal, parts, scores, evidence.blocks.run)


def _tangents(evidence: Evidence, terms: Sequence[Term], x: Array) -> list[Array]:
    """Per run, the smoothed derivative (K, n, m) [N m per unit] of the torque with respect to every nonlinear one."""
    layout = evidence.layout(terms)
    out = []
    for run in evidence.runs:
        parts = []
        for term, start in zip(layout.terms, layout.starts, strict=True):
            kind = term.family()
            count = len(kind.refined_at(term))
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
