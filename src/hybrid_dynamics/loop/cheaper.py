"""The likelier cause where both do as well: a wrong reading, or what every joint has.

What is read wrongly, a zero or a gain, comes in the place of an effect of more numbers that is said to be alike to it.

A search takes what predicts best, and a law of three numbers predicts a little better than the one of one number that
is there: a link's centre of mass where its joint's zero is wrong. What holds another as a special case is given back
to it elsewhere (:func:`.further.simplify`); these do not hold each other. A spring is not asked here: a link's inertia
is no rarer than a spring.

Friction and a rotor are in every real arm, an offset in many; a coupling, a spring or a gain of one joint has to be
told apart from them. A few seconds of slow moves, most joints one way, leave that open, and the search takes what
predicts best by a hair.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from hybrid_dynamics.effects import Family, Term, family
from hybrid_dynamics.loop.further import first_as_good
from hybrid_dynamics.loop.likeness import Likeness
from hybrid_dynamics.loop.search import LIKENESS_OF_RIVAL
from hybrid_dynamics.loop.trace import Judge, covers, elsewhere, same_place

#: A reading of another joint is re-fitted where it leaves at most this multiple of what the body leaves.
FAR = 1.5


def cheaper(judge: Judge, chosen: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with every effect of a joint as a wrong reading that it is alike to, where that costs less and
    predicts held-out rows as well where its own re-fit stands; and the judge there. The cheapest first.

    A body loads every joint that carries it, and may stand for a wrong reading of any of them.

    What the starting model has stays as it is: what is found then is its change.
    """
    out = list(chosen)
    judge = judge.at(out)
    for term in chosen:
        if term.joint is None or judge.evidence.in_base(term):
            continue
        rest = [t for t in out if t != term]
        offered = elsewhere(_alike(judge, term), rest)
        offered = [c for c in offered if judge.price(c) < judge.price(term)]
        if not offered:
            continue
        judge = judge.adding(offered)
        held = judge.evidence.held
        limit, trials = FAR * held(out, physical=True).score, []
        for c in offered:
            trial = [c if t == term else t for t in out]
            score = held(trial, physical=True).score
            # Of its own joint a wrong zero may look far worse from where the other law stands.
            if score <= limit or c.joint == term.joint:
                trials.append((judge.price(*trial), score, repr(trial), trial))
        trials.sort(key=lambda entry: entry[:3])
        judge, out = first_as_good(judge, out, [trial for *_, trial in trials])
    return judge, out


def plain_instead(judge: Judge, chosen: Sequence[Term], candidates: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with what every joint has, of ``candidates``, in the place of a rarer effect of a joint where that
    costs no more and predicts held-out rows as well where its own re-fit stands; and the judge there.

    Links are asked for less elsewhere (:func:`.further.simplify_bodies`), what holds a plain law as a special case for
    that (:func:`.further.simplify`). What the starting model has stays, and no change of it comes in.
    """
    out = list(chosen)
    judge = judge.at(out)
    for term in chosen:
        kind = term.family()
        if term.joint is None or kind.everywhere or kind.changes_body or judge.evidence.in_base(term):
            continue
        evidence, rest = judge.evidence, [t for t in out if t != term]
        acts, price = evidence.acts(term), judge.price(term)
        plain = [c for c in candidates if c.family().everywhere and c.effect not in kind.contains]
        offered = [
            c
            for c in plain
            if c.joint is not None
            and acts[c.joint]
            and judge.price(c) <= price
            and not evidence.in_base(c)
            and not any(same_place(c, o) or covers(o, c) for o in rest)
        ]
        if not offered:
            continue
        x, layout = evidence.fit(out), evidence.layout(out)
        start = layout.starts[layout.terms.index(term)]
        likeness = Likeness(evidence, term, x[start : start + term.size])
        best: dict[tuple[Any, ...], tuple[float, str, list[Term]]] = {}
        for c in offered:
            if likeness.share(c) < LIKENESS_OF_RIVAL:
                continue
            trial = [c if t == term else t for t in out]
            entry = evidence.held(trial, physical=True).score, repr(c), trial
            best[c.place] = min(best.get(c.place, entry), entry)
        judge, out = first_as_good(judge, out, [trial for _, _, trial in sorted(best.values())], certain=True)
    return judge, out


def _alike(judge: Judge, term: Term) -> Iterator[Term]:
    """Wrong readings of the joint of ``term`` that are said to make its torque, by their family or by its own; of a
    body also those of its mass or centre alone.

    None with parameters to refine: on a coarse grid they are not what they could be.
    """
    own = term.family()
    parts = [own, *(family(name) for name in own.contains if own.is_body)]
    joints = np.arange(judge.evidence.n)
    here = joints <= term.index if own.is_body else joints == term.index
    for name in (*judge.settings.families, *judge.settings.further):
        kind = family(name)
        if not kind.changes_reading or kind.nonlinear_settings:
            continue
        if not any(_says(kind, part.name) or _says(part, name) for part in parts):
            continue
        listed = kind.terms(judge.evidence.robot, here, judge.settings.options)
        yield from (c for c in listed if c.joint is not None and here[c.joint])


def _says(kind: Family, name: str) -> bool:
    return any(known.effects == (name,) for known in kind.equivalent_to)
