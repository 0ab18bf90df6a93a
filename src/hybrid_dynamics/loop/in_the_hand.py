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
from hybrid_dynamics.loop.search import take
from hybrid_dynamics.loop.trace import Judge, joined
from hybrid_dynamics.loop.widen import as_likely, with_plain


def payload_for_links(judge: Judge, chosen: Sequence[Term], candidates: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with a payload in the place of bodies of links, where the starting model's links were identified, the
    payload itself gains what an effect must to come in, and the links do not predict better by as much; and the judge
    there. What of the friction of ``candidates`` is missing stands beside both."""
    links = [t for t in chosen if t.family().scope == "link" and t.family().changes_body]
    hand = [t for t in candidates if t.joint is None and t.family().is_body and not t.family().all_links]
    if not links or not hand or any(t in hand for t in chosen) or not judge.evidence.problem.links_identified:
        return judge, list(chosen)
    rest = [t for t in chosen if t not in links]
    judge, trial = judge.adding(hand[:1]), joined(rest, hand[0])
    own, without, full = (with_plain(judge, terms, candidates) for terms in (trial, rest, chosen))
    sure = judge.news(own, without).surer_than(judge.settings.gain_in_errors)
    there = take(judge, chosen, trial) if sure and as_likely(judge, own, full) else None
    return (judge, list(chosen)) if there is None else (there, trial)
