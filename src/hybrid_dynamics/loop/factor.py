"""The factor that all links of the robot have in common, and how surely: a random-effects model of the links.

All links' parameters together can make any multiple of the rigid-body torque, so no row of the data tells a gain of the
whole recording from links that are all heavier. What tells them is how links are off: each in its own way, by masses
and centres of mass. The change of the links is g times the links themselves, plus deviations of each parameter, plus
the error of the fit; the spread of the deviations is estimated from the same change (REML; Patterson and Thompson
1971), and g is as uncertain as deviations of that spread make it. With few links that is a lot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.layout import Layout
from hybrid_dynamics.types import Array

#: Directions of the links' parameters that show this much less than the clearest are not determined at all.
_UNSEEN = 1e-10
#: Spreads that are tried, as shares of the plausible change of a link.
_SPREADS = np.geomspace(1e-3, 3.0, 120)


@dataclass(frozen=True)
class Factor:
    """``value``: all links by this share heavier, ``error`` its standard error; ``links``: how many say so."""

    value: float
    error: float
    links: int


def shared_gain(layout: Layout) -> int | None:
    """Place of the coordinate of a gain of all joints, where ``layout`` has one."""
    for term, start in zip(layout.terms, layout.starts, strict=True):
        if term.joint is None and term.family().shared:
            return start
    return None


def links_of(layout: Layout) -> tuple[Term, slice] | None:
    """The effect of all links' parameters and its coordinates, where ``layout`` has one."""
    for term, start in zip(layout.terms, layout.starts, strict=True):
        if term.family().all_links:
            return term, slice(start, start + term.size)
    return None


def common_factor(evidence: Evidence, terms: Sequence[Term], x: Array, covariance: Array) -> Factor | None:
    """The common factor in what ``terms`` at ``x`` (p,) change of the links; None where they change no links.

    A gain of all joints among ``terms`` counts as part of it. ``covariance`` (p, p): how the data alone determines
    ``x``.
    """
    layout = evidence.layout(terms)
    found = links_of(layout)
    if found is None:
        return None
    links, own = found
    bodies = own_parameters(evidence, links)
    place = shared_gain(layout)
    gain = 0.0 if place is None else float(x[place])
    change = gain * bodies + (1.0 + gain) * x[own]
    # Whitened: in direction k the change shows root_k times its size in plausible changes, noise as it is.
    scale = links.family().prior_scale(evidence.robot, links)
    values, vectors = np.linalg.eigh(_gram(evidence, layout, own) * scale[:, None] * scale)
    seen = values > _UNSEEN * values[-1]
    values = values[seen]
    whiten = np.sqrt(values)[:, None] * (vectors[:, seen].T / scale)
    shown, one = whiten @ change, whiten @ bodies
    noise = np.einsum("ki,ij,kj->k", whiten, covariance[own, own], whiten)
    # A covariance from few blocks is silent in most directions: none is taken as surer than they are on the whole.
    noise = np.maximum(noise, max(float(np.mean(noise)), 1.0))
    best, factor = -np.inf, Factor(0.0, np.inf, len(bodies) // 10)
    for spread in _SPREADS:
        variance = spread**2 * values + noise
        information = float(np.sum(one**2 / variance))
        g = float(np.sum(one * shown / variance)) / information
        left = float(np.sum((shown - g * one) ** 2 / variance))
        likelihood = -0.5 * (float(np.sum(np.log(variance))) + left + float(np.log(information)))
        if likelihood > best:
            best, factor = likelihood, Factor(g, information**-0.5, factor.links)
    return factor


def own_parameters(evidence: Evidence, links: Term) -> Array:
    """Dynamic parameters (10 a link) of the starting model for ``links``, an effect of all links' parameters."""
    bodies = links.family().inertial_bodies(evidence.robot, links)
    return np.concatenate([own for _, own in bodies])


def _gram(evidence: Evidence, layout: Layout, own: slice) -> Array:
    """Weighted products (K, K) of the columns of the coordinates ``own`` over all rows that count."""
    out = np.zeros((layout.total, layout.total))
    for j, (position, column) in enumerate(evidence.indices(layout)):
        out[np.ix_(position, position)] += evidence.weights[j] * evidence.full_gram[j][np.ix_(column, column)]
    return out[own, own]
