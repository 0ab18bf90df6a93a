"""Heavier links everywhere, or a torque that is recorded too large? The data cannot tell; the links of the URDF can.

All links' parameters together can make any multiple of the rigid-body torque, so a gain of the whole recording ends as
links that are all heavier by the same factor. Where one factor is most of what the links would have to change by, the
gain is the simpler cause: it leaves the links near what the URDF says. Links that are off as links are off each in its
own way: they ask every joint for another factor, and a factor that they have in common by chance is no larger than
their scatter makes it (:mod:`.factor`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import norm

from hybrid_dynamics.effects import Family, Term, family
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.factor import common_factor
from hybrid_dynamics.loop.search import take
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.loop.trace import Judge, joined
from hybrid_dynamics.types import Array

#: One factor must be at least this share of what the links' torque changes by, and differ from one by this much.
SHARE, LEAST = 0.75, 0.05
#: Joints whose own factor lies within this share of the common one, and how many of those that change must.
NEAR, AGREEING = 0.5, 0.75


def gain_for_links(judge: Judge, chosen: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with one gain for all joints beside all links' parameters, where those change mostly by one factor.

    The links keep what the factor leaves of their change, gains of single joints what makes them differ. Nothing
    changes where held-out samples are predicted worse.
    """
    gain, links = _gain_beside_links(judge, chosen)
    if gain is None or not _surely_one_factor(judge, chosen, links):
        return judge, list(chosen)
    return _where_as_good(judge.adding([gain]).at(chosen), chosen, [*chosen, gain])


def links_for_gain(judge: Judge, chosen: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with all links' parameters in the place of a gain of all joints that is no more than what links that
    are off each in its own way have in common.

    One number for all joints is cheap, so a search takes it for a few heavier links. Nothing changes where the links
    predict held-out samples worse, or may not be named.
    """
    gain = _gain(judge)
    links = [t for t in judge.evidence.terms if t.family().all_links]
    if gain not in chosen or not links or any(t in chosen for t in links):
        return judge, list(chosen)
    trial = joined([t for t in chosen if t != gain], links[0])
    if _surely_one_factor(judge, trial, links[:1]):
        return judge, list(chosen)
    return _where_as_good(judge.at(chosen), chosen, trial)


def _where_as_good(judge: Judge, chosen: Sequence[Term], trial: list[Term]) -> tuple[Judge, list[Term]]:
    """``trial`` in the place of ``chosen``, where ``judge`` stands, if it predicts held-out samples as well."""
    held = judge.evidence.held
    if judge.as_good(held(trial, physical=True), held(chosen, physical=True)):
        there = take(judge, chosen, trial)
        if there is not None:
            return there, trial
    return judge, list(chosen)


def gain_instead(judge: Judge, chosen: Sequence[Term], x: Array) -> Term | None:
    """The gain of all joints, where all links in ``chosen`` change at ``x`` mostly by one factor and no gain is named:
    links that are off each its own way may have it in common by chance, or not."""
    gain, links = _gain_beside_links(judge, chosen)
    return gain if gain is not None and _one_factor(judge, chosen, links, x) is not None else None


def _gain_beside_links(judge: Judge, chosen: Sequence[Term]) -> tuple[Term | None, list[Term]]:
    """The gain of all joints that could stand beside all links' parameters in ``chosen``, and these; None where it may
    not be named, is named already, or no such parameters are there."""
    links = [t for t in chosen if t.family().all_links]
    gain = _gain(judge)
    return (None if not links or gain in chosen else gain), links


def _surely_one_factor(judge: Judge, chosen: Sequence[Term], links: Sequence[Term]) -> bool:
    """Whether ``links`` change by one factor, and by more than the scatter of links makes it by chance."""
    fitted = refit(judge.evidence, chosen)
    evidence, x = fitted.evidence, fitted.x
    multiple = _one_factor(judge.over(evidence), chosen, links, x)
    if multiple is None:
        return False
    factor = common_factor(evidence, chosen, x, evidence.covariance(chosen, x))
    assert factor is not None
    # The error knows already how little so few links say of their spread: no Student's t on top of it.
    level = float(norm.ppf(1.0 - judge.settings.significance))
    return bool(min(factor.value * np.sign(multiple), abs(multiple)) > level * factor.error)


def _gain(judge: Judge) -> Term | None:
    """The gain of all joints, where it may be named."""
    return next((Term(kind.name, None) for kind in gain_families(judge.settings) if kind.shared), None)


def gain_families(settings: LoopSettings) -> list[Family]:
    """The families that may be named by which a torque is read too large or too small."""
    kinds = [family(name) for name in (*settings.families, *settings.further)]
    return [kind for kind in kinds if kind.changes_reading and kind.uses_torque]


def _one_factor(judge: Judge, chosen: Sequence[Term], links: Sequence[Term], x: Array) -> float | None:
    """The multiple of the starting model's torque that ``links`` make, where on most joints it is about the same."""
    evidence = judge.evidence
    layout = evidence.layout(chosen)
    only = np.zeros_like(x)
    for term, start in zip(layout.terms, layout.starts, strict=True):
        if term in links:
            only[start : start + term.size] = x[start : start + term.size]
    product, own, whole = (np.zeros(evidence.n) for _ in range(3))
    torques = evidence.problem.base_torque
    for mask, torque, change in zip(evidence.mask, torques, evidence.linear(chosen, only), strict=True):
        product += np.sum(mask * change * torque, axis=0)
        own += np.sum(mask * torque**2, axis=0)
        whole += np.sum(mask * change**2, axis=0)
    weights = evidence.weights
    factor = float(product @ weights) / max(float(own @ weights), 1e-300)
    share = factor**2 * float(own @ weights) / max(float(whole @ weights), 1e-300)
    changed = (judge.floor > 0) & (whole > evidence.samples * judge.floor**2)
    near = np.abs(product / np.maximum(own, 1e-300) - factor) <= NEAR * abs(factor)
    alike = changed.sum() > 1 and float(np.mean(near[changed])) >= AGREEING
    return factor if abs(factor) >= LEAST and share >= SHARE and alike else None
