"""Covariance of what is published: nonlinear parameters beside the linear ones, and what is no noise of these runs.

The torque's derivative with respect to a nonlinear parameter stands beside the columns.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.base import acts_in
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.factor import common_factor, links_of, own_parameters, shared_gain
from hybrid_dynamics.loop.floor import difference_floor
from hybrid_dynamics.loop.jackknife import covariance_of
from hybrid_dynamics.loop.layout import Layout
from hybrid_dynamics.types import Array

#: What a model is off by on another run has few shapes: friction, viscous or dry, is nearly one, and so are a weight
#: and an offset where a joint does not turn far.
SHAPES = 2.0
#: Columns of unit length that differ by less than the root of this are one to any noise.
ONE_DIRECTION = 1e-12


def published_covariance(evidence: Evidence, terms: Sequence[Term], x: Array) -> Array:
    """:func:`covariance_with_settings`, what the starting model is known to be off by on other runs, and beside all
    links' parameters what makes a gain of all joints uncertain.

    The two can make the same torque; where one ends and the other begins only the links of the starting model say
    (:mod:`.factor`). A larger gain goes with lighter links and less friction, so those are as uncertain.
    """
    noise, normal = _covariance(evidence, terms, x)
    layout = evidence.layout(terms)
    covariance = noise + misfit_covariance(evidence, terms, x, normal) + prior_covariance(evidence, layout, normal)
    place, found = shared_gain(layout), links_of(layout)
    if place is None or found is None:
        return covariance
    free = evidence.holding_links(1.0)
    if free is evidence:
        factor = common_factor(evidence, terms, x, covariance[: layout.total, : layout.total])
    else:
        # Links that are held near say too little of how much they scatter.
        loose = free.fit(terms)
        factor = common_factor(free, terms, loose, covariance_with_settings(free, terms, loose)[: len(x), : len(x)])
    assert factor is not None
    links, own = found
    along = np.zeros(len(covariance))
    for term, start in zip(layout.terms, layout.starts, strict=True):
        if term.family().everywhere:
            along[start : start + term.size] = -x[start : start + term.size] / (1.0 + x[place])
    along[own] = -(own_parameters(evidence, links) + x[own]) / (1.0 + x[place])
    along[place] = 1.0
    return np.asarray(covariance + factor.error**2 * np.outer(along, along))


def misfit_covariance(evidence: Evidence, terms: Sequence[Term], x: Array, normal: Array) -> Array:
    """What the starting model is off by on runs in which nothing has changed, as covariance (p + m, p + m) of what
    ``normal`` (p + m, p + m) is the normal matrix of.

    A change is counted from a model that was calibrated on other runs, and that was off by ``misfit`` where it was
    tested. What of it is no noise follows the motion: it does not average out over a run, whatever its length, and no
    scatter between blocks shows it. Per joint it counts as that torque along :data:`SHAPES` independent shapes. At
    least a share ``floor_share`` of it is taken for such: that much is not looked for in a calibration. 0 where the
    start was never tested.
    """
    if evidence.base.misfit is None:
        return np.zeros((1, 1))
    misfit = np.asarray(evidence.base.misfit, float) ** 2
    noise = difference_floor(evidence.runs, evidence.problem.base_target, evidence.mask) ** 2
    off = np.maximum(misfit - noise, evidence.settings.floor_share * misfit)
    spread, _ = _by_block(evidence, terms, x, evidence.weights**2 * off * evidence.samples / SHAPES)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = scale[:, None] * np.linalg.pinv(normal * scale[:, None] * scale, hermitian=True) * scale
    return np.asarray(inverse @ spread.sum(axis=0) @ inverse)


def prior_covariance(evidence: Evidence, layout: Layout, normal: Array) -> Array:
    """What the pull of the weak prior towards the start makes uncertain, covariance (p + m, p + m).

    The estimate is off by ``inverse(normal) @ precision @ (x - start)``, and the prior says how large that difference
    may be. Nothing where the data tells; where it does not, the prior's own spread: a parameter that was left where
    it stood is unknown, not exact. Links that are held nearer for the prediction (:mod:`.nearer`) are no better known
    for that: they differ by what is plausible of any.
    """
    own, held_near = slice(layout.total), evidence.prior(layout)
    nearer = held_near / evidence.holding_links(1.0).prior(layout)

    def pulled(precision: Array) -> Array:
        whole = np.zeros(normal.shape)
        whole[own, own] = np.diag(precision) + evidence.problem.alike(layout)
        return np.asarray(vectors.T @ (scale[:, None] * whole * scale) @ vectors)

    scale, values, vectors = directions(normal)
    pull = pulled(held_near)
    # A direction that no sample knows at all lies below rounding in the normal matrix: the prior alone holds it. A
    # nonlinear parameter has none: of a law that makes no torque nothing is known, and nothing is said.
    held = np.where(np.diag(pull) > 0, np.diag(pull), np.inf)
    size = np.where(values > ONE_DIRECTION, values, held)
    inverse = scale[:, None] * vectors / size
    return np.asarray(inverse @ pulled(held_near * nearer) @ inverse.T)


def directions(normal: Array) -> tuple[Array, Array, Array]:
    """``scale`` (p,) that gives the ``normal`` matrix (p, p) unit diagonal; eigenvalues (p,) and vectors (p, p) then.

    No sample knows a direction whose eigenvalue is :data:`ONE_DIRECTION` or less.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    values, vectors = np.linalg.eigh(normal * scale[:, None] * scale)
    return scale, values, vectors


def covariance_with_settings(evidence: Evidence, terms: Sequence[Term], x: Array) -> Array:
    """Covariance (p + m, p + m) of the coordinates ``x`` (p,) and, behind them in the order of ``terms``, of their m
    nonlinear parameters: :meth:`Evidence.covariance` for the linearisation in both.

    A nonlinear parameter that was refined is as uncertain as if it had been fitted with all others, and makes them as
    uncertain as it must. Without nonlinear parameters the same as :meth:`Evidence.covariance`.
    """
    return _covariance(evidence, terms, x)[0]


def _covariance(evidence: Evidence, terms: Sequence[Term], x: Array) -> tuple[Array, Array]:
    """:func:`covariance_with_settings`, and the normal matrix behind it with the weak prior of the coordinates."""
    layout = evidence.layout(terms)
    parts, scores = _by_block(evidence, terms, x, evidence.weights)
    normal = parts.sum(axis=0)
    normal[: layout.total, : layout.total] = evidence.normal(layout)[0]
    rest = np.zeros_like(normal)
    rest[: layout.total, : layout.total] = evidence.rest_normal(layout)
    return covariance_of(normal, parts, scores, evidence.blocks.run, rest), normal


def _by_block(evidence: Evidence, terms: Sequence[Term], x: Array, weights: Array) -> tuple[Array, Array]:
    """:meth:`Evidence.by_block` with the nonlinear parameters behind the coordinates."""
    layout = evidence.layout(terms)
    if not any(s.family().refined_at(s) for s in terms):
        return evidence.by_block(layout, x, weights)
    tangents = _tangents(evidence, terms, x)
    p, m, blocks = layout.total, tangents[0].shape[2], len(evidence.blocks)
    parts, scores = np.zeros((blocks, p + m, p + m)), np.zeros((blocks, p + m))
    parts[:, :p, :p], scores[:, :p] = evidence.by_block(layout, x, weights)
    residuals = evidence.residuals(terms, x)
    new = np.arange(p, p + m)
    for j, (position, column) in enumerate(evidence.indices(layout)):
        columns = evidence.columns_of(j, column)
        for b, (low, high) in enumerate(evidence.blocks.rows):
            r = evidence.blocks.run[b]
            counted = evidence.mask[r][low:high, j]
            own = tangents[r][low:high, j][counted]
            known = columns[r][low:high][counted]
            cross = weights[j] * known.T @ own
            parts[b][np.ix_(position, new)] += cross
            parts[b][np.ix_(new, position)] += cross.T
            parts[b][p:, p:] += weights[j] * own.T @ own
            scores[b, p:] += weights[j] * own.T @ residuals[r][low:high, j][counted]
    return parts, scores


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
            if acts_in(term.options, run.name):
                columns = run.smooth(kind.setting_columns(run.motion, term, x[start : start + term.size]))
                if columns.ndim == 3:
                    full[:] = columns
                else:
                    full[:, term.index] = columns
            parts.append(full)
        out.append(np.concatenate(parts, axis=2))
    return out
