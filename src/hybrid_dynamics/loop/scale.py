"""Heavier links everywhere, or a torque that is recorded too large? The data cannot tell; the links of the URDF can.

All links' parameters together can make any multiple of the rigid-body torque, so a gain of the whole recording ends as
links that are all heavier by the same factor. Where one factor is most of what the links would have to change by, the
gain is the simpler cause: it leaves the links near what the URDF says.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.effects import Term, family
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.search import take
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.types import Array

#: One factor must be at least this share of what the links' torque changes by, and differ from one by this much.
SHARE, LEAST = 0.75, 0.05


def gain_for_links(judge: Judge, chosen: Sequence[Term]) -> list[Term]:
    """``chosen`` with one gain for all joints beside all links' parameters, where those change mostly by one factor.

    The links keep what the factor leaves of their change, gains of single joints what makes them differ. Nothing
    changes where held-out samples are predicted worse.
    """
    evidence = judge.evidence
    links = [t for t in chosen if t.family().all_links]
    gain = _gain(judge)
    if not links or gain is None or gain in chosen:
        return list(chosen)
    factor, share = _factor(judge, chosen, links, refit(evidence, chosen))
    if abs(factor) < LEAST or share < SHARE:
        return list(chosen)
    evidence.add_terms([gain])
    refit(evidence, chosen, everything=True)
    trial = [*chosen, gain]
    good = judge.as_good(evidence.held(trial, physical=True), evidence.held(chosen, physical=True))
    return trial if good and take(judge, chosen, trial) else list(chosen)


def _gain(judge: Judge) -> Term | None:
    """The gain of all joints, where it may be named."""
    for name in (*judge.settings.families, *judge.settings.further):
        kind = family(name)
        if kind.shared and kind.changes_reading and kind.uses_torque:
            return Term(name, None)
    return None


def _factor(judge: Judge, chosen: Sequence[Term], links: Sequence[Term], x: Array) -> tuple[float, float]:
    """Multiple of the starting model's torque that is nearest to the torque of ``links``, and its share of that."""
    evidence = judge.evidence
    layout = evidence.layout(chosen)
    only = np.zeros_like(x)
    for term, start in zip(layout.terms, layout.starts, strict=True):
        if term in links:
            only[start : start + term.size] = x[start : start + term.size]
    product = own = whole = 0.0
    for r, change in enumerate(evidence.linear(chosen, only)):
        start_torque = evidence.runs[r].tau - evidence.base_target[r]
        weight = evidence.mask[r] * evidence.weights
        product += float(np.sum(weight * change * start_torque))
        own += float(np.sum(weight * start_torque**2))
        whole += float(np.sum(weight * change**2))
    return (product / own, product**2 / own / whole) if own and whole else (0.0, 0.0)
