"""A law of more numbers than are asked for unnamed, where the search has put together several plainer ones for it.

A search is offered friction whose sign turns over a distance and whose level is one number (Dahl's), and one whose
level falls with the speed and that turns over at once (Stribeck's). Of a joint that has both (LuGre's) it makes either,
with plain friction or whatever follows the reversals in the place of the rest.
"""

from __future__ import annotations

from collections.abc import Sequence

from hybrid_dynamics.effects import Term, family
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.further import at_the_end, first_as_good, refine
from hybrid_dynamics.loop.search import take
from hybrid_dynamics.loop.trace import ACCEPTED, Judge, covers, joined, same_place


def richer_laws(judge: Judge, chosen: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with the richer laws of the further families (:meth:`.Family.richer`) in the place of what stands for
    them, joint by joint, and without those of which a plainer one does as well; and the judge there.

    A richer law comes in where it is surely better by something that matters, as any name, or costs less and is as
    good, and its further numbers are known. What the starting model has stays as it is: what is found is its change.
    """
    out = list(chosen)
    for kind in map(family, judge.settings.further):
        for joint in sorted({t.joint for t in out if t.joint is not None}):
            own = [t for t in out if t.joint == joint]
            laws = kind.richer(own)
            if laws and not any(
                judge.evidence.in_base(t) for t in own if t.place == laws[0].place or covers(laws[0], t)
            ):
                judge, out = _with_richer(judge, out, laws)
    return plainer_laws(judge, out)


def plainer_laws(judge: Judge, chosen: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with a plainer law in the place of each richer one of which that does as well, or of whose further
    numbers nothing is known; and the judge there."""
    out = list(chosen)
    for asked in chosen:
        term, plain = asked, None if judge.evidence.in_base(asked) else asked.family().plainer(asked)
        while plain is not None:
            known = _is_known(judge, out, term)
            if known and plain.effect != term.effect:
                # Another effect's law has been asked for in its place by the search.
                break
            there, trial = refine(judge.at(out).adding([plain]), _instead(out, term, plain), [plain.place])
            if known:
                judge, left = first_as_good(there.adding(out), out, [trial])
            else:
                judge, left = there, trial
            if left == out:
                break
            out, term = left, next(t for t in left if t.place == plain.place)
            plain = term.family().plainer(term)
    return judge.at(out), out


def _plainer_law(term: Term) -> Term | None:
    """The next plainer law of the same effect."""
    plain = term.family().plainer(term)
    return plain if plain is not None and plain.effect == term.effect else None


def _instead(terms: Sequence[Term], term: Term, plain: Term) -> list[Term]:
    """``terms`` with ``plain`` in the place of ``term``, and of what else takes its place."""
    return [plain if t == term else t for t in terms if t == term or not same_place(t, plain)]


def _with_richer(judge: Judge, out: list[Term], laws: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``out`` with one of ``laws`` of one place, refined from the best of them, where that is better, or else with a
    plainer one that is still richer than the plainest; the judge there."""
    place = laws[0].place
    judge = judge.at(out).adding(laws)
    trials = [joined([t for t in out if t.place != place], law) for law in laws]
    start = min(trials, key=lambda t: (judge.evidence.held(t).score, repr(t)))
    there, trial = refine(judge, start, [place])
    while True:
        law = next(t for t in trial if t.place == place)
        kind = law.family()
        if any(t.place == place and kind.published(t.options) == kind.published(law.options) for t in out):
            return judge, out
        taken = None if at_the_end([law]) else _taken(there.adding(out), out, trial, law)
        if taken is not None:
            return taken, trial
        plain = _plainer_law(law)
        # The plainest one the search has asked for itself.
        if plain is None or _plainer_law(plain) is None:
            return judge, out
        there, trial = refine(there.at(trial).adding([plain]), _instead(trial, law, plain), [place])


def _taken(judge: Judge, out: list[Term], trial: list[Term], law: Term) -> Judge | None:
    """The judge at ``trial``, which has ``law`` for what ``out`` has, where that is better; else None."""
    new, old = (judge.evidence.held(terms, physical=True) for terms in (trial, out))
    plainer = judge.price(*trial) <= judge.price(*out) and judge.as_good(new, old) and judge.spares(new, old)
    if not plainer and judge.reason(law, judge.gain(new, old), new) != ACCEPTED:
        return None
    taken = take(judge, out, trial)
    return taken if taken is not None and _is_known(taken, trial, law) else None


def within_bounds(judge: Judge, chosen: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with a plainer law in the place of each richer one that has come to the end of what is plausible; and
    the judge there."""
    out = list(chosen)
    for term in at_the_end(out):
        plain = _plainer_law(term)
        if plain is not None and not judge.evidence.in_base(term):
            judge, out = refine(judge.at(out).adding([plain]), _instead(out, term, plain), [plain.place])
    return judge, out


def _is_known(judge: Judge, terms: Sequence[Term], term: Term) -> bool:
    """Whether the further numbers of ``term``, one of ``terms``, are known in a re-fit of all."""
    effects = refit(judge.at(terms).evidence, terms).model().effects[-len(terms) :]
    return term.family().is_known(effects[list(terms).index(term)])
