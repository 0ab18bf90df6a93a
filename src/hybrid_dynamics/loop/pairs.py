"""Two effects of one joint that only show side by side.

Stribeck friction without the viscous friction beside it is hardly better than Coulomb friction, and viscous friction
without the Stribeck curve is nothing: a search that adds one at a time stops before both, with all of it left in the
residual. Where no single effect comes in, the likeliest effects of a joint are asked together with all others there.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.base import ONLY_RUN
from hybrid_dynamics.loop.held import Held
from hybrid_dynamics.loop.layout import term_order
from hybrid_dynamics.loop.trace import ACCEPTED, Judge, covers, joined, same_place

#: A joint is asked where its held-out mean square exceeds that of the floor by this share.
MUCH_LEFT = 1.0
#: So many places of a joint, those that predict best alone, are each asked with all others there.
LIKELIEST = 6
#: So many pairs of a joint, those that predict best, are judged with bodies and friction held physical.
JUDGED = 3


def pair_on_a_joint(
    judge: Judge, current: Sequence[Term], candidates: Sequence[Term], before: Held, seen: set[frozenset[Term]]
) -> tuple[Term, Term] | None:
    """The two of ``candidates`` on one joint that predict held-out runs best together, where each is needed beside the
    other; None where there are none.

    ``before``: held-out prediction of ``current``; ``seen``: combinations that have had their turn.
    """
    mean_square = judge.mean_square(before)
    best: tuple[float, tuple[Term, Term]] | None = None
    for joint in np.flatnonzero((judge.floor > 0) & (mean_square > (1.0 + MUCH_LEFT) * judge.floor**2)):
        for score, pair in _likely(judge, current, [c for c in candidates if c.joint == joint]):
            if best is not None and score >= best[0]:
                break
            one, other = pair
            fresh = frozenset(joined(joined(current, other), one)) not in seen
            if fresh and _needed(judge, current, one, other) and _needed(judge, current, other, one):
                best = score, pair
                break
    return None if best is None else best[1]


def _likely(judge: Judge, current: Sequence[Term], own: Sequence[Term]) -> list[tuple[float, tuple[Term, Term]]]:
    """Pairs of ``own``, effects of one joint, by their held-out score: the best few, the best first."""
    evidence = judge.evidence
    free = [c for c in own if _is_law(judge, c) and not any(same_place(c, o) or covers(o, c) for o in current)]
    alone = {c: evidence.held(joined(current, c)).score for c in free}
    order = sorted(free, key=lambda c: (alone[c], term_order(c)))
    places = list(dict.fromkeys(c.place for c in order))[:LIKELIEST]
    scored = []
    for one, other in combinations(order, 2):
        if same_place(one, other) or covers(one, other) or covers(other, one) or one.place not in places:
            continue
        scored.append((evidence.held(joined(joined(current, one), other)).score, (one, other)))
    scored.sort(key=lambda item: (item[0], term_order(item[1][0]), term_order(item[1][1])))
    return scored[:JUDGED]


def _is_law(judge: Judge, term: Term) -> bool:
    """True for a law of the joint's own motion. What a body or another joint does can stand for much: two at a time of
    these would stand for anything."""
    kind = term.family()
    return (
        not kind.is_body and kind.partner(judge.evidence.robot, term.options) is None and ONLY_RUN not in term.options
    )


def _needed(judge: Judge, current: Sequence[Term], term: Term, other: Term) -> bool:
    """True where ``term`` is worth its place beside ``current`` and ``other``: against what stood there, too."""
    trial = joined(joined(current, other), term)
    after = judge.evidence.held(trial, physical=True)
    without = judge.evidence.held(joined(current, other), physical=True)
    gain = min(judge.worth(trial, term), judge.gain(after, without), key=lambda g: g.total)
    return judge.reason(term, gain, after) == ACCEPTED
