"""The factor that all links of the robot have in common, and how surely: a random-effects model of the links.

All links' parameters together can make any multiple of the rigid-body torque, so no row of the data tells a gain of the
whole recording from links that are all heavier. What tells them is how links are off: each in its own way, by masses
and centres of mass. The change of the links is g times the links themselves, plus a factor of each link's own, plus
deviations of each parameter, plus the error of the fit. How far the links' own factors and the parameters spread is
estimated from the same change (restricted likelihood; Patterson and Thompson 1971), and g is as uncertain as such links
make it. With few links that is a lot.
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
#: Spreads that are tried: of the links' own factors, up to where two spreads are the plausible change of a link (half
#: its mass), and of parameters as shares of their plausible change.
_OWN, _SPREADS = np.geomspace(1e-3, 0.25, 16), np.geomspace(1e-3, 2.0, 24)


@dataclass(frozen=True)
class Factor:
    """``value``: all links by this share heavier, ``error`` its standard error."""

    value: float
    error: float


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
    whiten = np.sqrt(values[seen])[:, None] * (vectors[:, seen].T / scale)
    noise = np.einsum("ki,ij,kj->k", whiten, covariance[own, own], whiten)
    # A covariance from few blocks is silent in most directions: none is taken as surer than they are on the whole.
    noise = np.maximum(noise, max(float(np.mean(noise)), 1.0))
    # One direction, one noise: then it is of size one everywhere.
    unit = whiten / np.sqrt(noise)[:, None]
    return Factor(*_random_effects(unit @ change, unit @ bodies, unit @ _each(bodies), unit * scale))


def _each(bodies: Array) -> Array:
    """The links (10 L,), one a column (10 L, L): one that weighs more does so in all its ten parameters, and ten that
    agree are one witness."""
    count = len(bodies) // 10
    return np.repeat(np.eye(count), 10, axis=0) * bodies[:, None]


def _random_effects(shown: Array, one: Array, links: Array, parameters: Array) -> tuple[float, float]:
    """Coefficient of ``one`` (K,) in ``shown`` (K,) and its standard error, beside noise of size one and random effects
    of unknown spread along the columns of ``links`` (K, L) and of ``parameters`` (K, 10 L).

    Averaged over what the restricted likelihood says of the two spreads: from few links it says little, and the most
    likely value alone would pass for known. Beforehand the links' spread is neither uniform, which leaves few of them
    no power, nor uniform in its logarithm, which lets few pass for links without any (Gelman, Bayesian Analysis 2006):
    it is uniform in its root.
    """
    by_link, by_parameter = links @ links.T, parameters @ parameters.T
    both = np.broadcast_to(np.column_stack([one, shown]), (len(_SPREADS), len(one), 2))
    likelihoods, means, variances = [], [], []
    for spread in _OWN:
        covariance = np.eye(len(one)) + spread**2 * by_link + _SPREADS[:, None, None] ** 2 * by_parameter
        root = np.linalg.cholesky(covariance)
        white_one, white = np.moveaxis(np.linalg.solve(root, both), 2, 0)
        information = np.sum(white_one**2, axis=1)
        mean = np.sum(white_one * white, axis=1) / information
        left = np.sum((white - mean[:, None] * white_one) ** 2, axis=1)
        size = 2.0 * np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
        likelihoods.append(0.5 * (np.log(spread) - size - left - np.log(information)))
        means.append(mean)
        variances.append(1.0 / information)
    likelihood, mean, variance = np.concatenate(likelihoods), np.concatenate(means), np.concatenate(variances)
    share = np.exp(likelihood - likelihood.max())
    share /= share.sum()
    value = float(share @ mean)
    return value, float(np.sqrt(share @ (variance + (mean - value) ** 2)))


def own_parameters(evidence: Evidence, links: Term) -> Array:
    """Dynamic parameters (10 a link) of the starting model for ``links``, an effect of all links' parameters."""
    bodies = links.family().inertial_bodies(evidence.robot, links)
    return np.concatenate([own for _, own in bodies])


def _gram(evidence: Evidence, layout: Layout, own: slice) -> Array:
    """Weighted products (K, K) of the columns of the coordinates ``own`` over all rows that count."""
    out = np.zeros((layout.total, layout.total))
    for j, (position, column) in enumerate(evidence.indices(layout)):
        out[np.ix_(position, position)] += evidence.weights[j] * evidence.sums.full[j][np.ix_(column, column)]
    return out[own, own]
