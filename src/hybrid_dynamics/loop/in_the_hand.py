"""Asked what changed of an arm whose links are known: its links have not, what it carries may have.

Nobody makes a link of a calibrated arm heavier from one day to the next; a tool, a part in the gripper comes and goes.
A few seconds hardly tell a payload from the body of the link before the wrist, whose ten numbers are free to follow
what else those seconds lack. The burden of proof is then the link's: a payload takes its place unless it predicts
held-out rows better by as much as an effect must to come in. Found on an arm that the project had not seen (an AIRBOT
Play, four seconds under a load): the inertia of link 5 had been named, better by one standard error.
"""

from __future__ import annotations

from collections.abc import Sequence

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.prune import impossible
from hybrid_dynamics.loop.search import take
from hybrid_dynamics.loop.trace import ACCEPTED, Judge, joined
from hybrid_dynamics.loop.widen import as_likely, with_plain


def payload_for_links(judge: Judge, chosen: Sequence[Term], candidates: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with a payload in the place of all bodies of links, or else of one of them, where the starting model's
    links were identified, the payload itself gains what an effect must to come in and can be, and the links do not
    predict better by as much; and the judge there. What of the friction of ``candidates`` is missing stands beside."""
    links = [t for t in chosen if t.family().scope == "link" and t.family().changes_body]
    hand = [t for t in candidates if t.joint is None and t.family().is_body and not t.family().all_links]
    if not links or not hand or any(t in hand for t in chosen) or not judge.evidence.problem.links_identified:
        return judge, list(chosen)
    judge, payload = judge.adding(hand[:1]), hand[0]
    full = with_plain(judge, chosen, candidates)
    for own in (links, *([t] for t in links if len(links) > 1)):
        rest = [t for t in chosen if t not in own]
        trial = joined(rest, payload)
        held, without = (with_plain(judge, terms, candidates) for terms in (trial, rest))
        sure = judge.reason(payload, judge.news(held, without), held) == ACCEPTED
        there = take(judge, chosen, trial) if sure and as_likely(judge, held, full) else None
        if there is not None and payload not in impossible(there, trial):
            return there, trial
    return judge, list(chosen)
