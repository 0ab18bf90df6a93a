"""Search from nothing: add an effect, re-fit everything jointly, drop what is no longer needed, until nothing is left.

No combination of effects is visited twice and an effect that was dropped :data:`MOST_DROPS` times is not tried again,
so the search ends after at most ``MOST_DROPS * candidates`` drops, :data:`MOST_REPLACEMENTS` replacements and, since
every addition makes the model larger until a drop or a replacement, as many additions and ``max_effects`` more.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.base import ONLY_RUN
from hybrid_dynamics.loop.held import Held
from hybrid_dynamics.loop.likeness import LIKENESS_OF_PAIR, Likeness, pairs
from hybrid_dynamics.loop.pairs import pair_on_a_joint
from hybrid_dynamics.loop.trace import DECISIVE, Candidate, Judge, covers, elsewhere, joined, rank, same_place

#: An effect that was dropped this often is left alone.
MOST_DROPS = 2
#: Replacements in one search.
MOST_REPLACEMENTS = 5
#: A nonlinear effect whose re-fit ends worse by more than this share than before and than promised is not taken.
BROKEN_PROMISE = 1e-3
#: What takes the place of an effect must be able to make at least this share of its torque.
LIKENESS_OF_RIVAL = 0.3
#: So many of the likest are tried.
MOST_RIVALS = 10


@dataclass(frozen=True)
class Step:
    """One change of the model: ``action`` is add, drop, replace or stop; ``terms`` the model's after it."""

    action: str
    term: Term | None
    terms: tuple[Term, ...]
    table: tuple[Candidate, ...]
    held_out: tuple[float, ...]


def step_of(
    judge: Judge, action: str, term: Term | None, current: Sequence[Term], table: Sequence[Candidate] = ()
) -> Step:
    """The step after which the model has the terms ``current``, with its held-out rms per joint [N m]."""
    rms = np.sqrt(judge.mean_square(judge.evidence.held(current, physical=True)))
    return Step(action, term, tuple(current), tuple(table), tuple(float(v) for v in rms))


def search(
    judge: Judge,
    candidates: Sequence[Term],
    report: Callable[[Step], None],
    start: Sequence[Term] = (),
    replacing: bool = True,
) -> tuple[Judge, list[Step]]:
    """Stepwise search, forward and backward, from ``start``, with replacements unless told otherwise; returns the judge
    at its end and the steps taken."""
    settings = judge.settings
    current: list[Term] = list(start)
    steps: list[Step] = []
    seen: set[frozenset[Term]] = {frozenset(current)}
    dropped: Counter[Term] = Counter()
    replacements = 0 if replacing else MOST_REPLACEMENTS

    def record(action: str, term: Term | None, table: Sequence[Candidate] = ()) -> None:
        steps.append(step_of(judge, action, term, current, table))
        report(steps[-1])

    while True:
        before = judge.evidence.held(current, physical=True)
        open_to = [c for c in candidates if dropped[c] < MOST_DROPS]
        table = rank(judge, current, open_to, before)
        room = settings.max_effects - len(current)
        fresh = (c for c in table if room > 0 and c.accepted and frozenset(joined(current, c.term)) not in seen)
        choice = next(fresh, None)
        alone: list[Term] = []  # with the first of two that come in together
        if choice is not None:
            action, added = "add", choice.term
            trial = joined(current, added)
        elif room > 1 and (pair := pair_on_a_joint(judge, current, open_to, before, seen)) is not None:
            action, added = "add", pair[1]
            alone = joined(current, pair[0])
            trial = joined(alone, added)
        else:
            action, added = "replace", None
            replaced = None
            if replacements < MOST_REPLACEMENTS:
                replaced = _replace(judge, current, candidates, before, seen)
            if replaced is None and replacements < MOST_REPLACEMENTS:
                replaced = _lighter(judge, current, candidates, before, seen)
            replacements += 1
            if replaced is None:
                record("stop", None, table)
                break
            trial = replaced
        seen.add(frozenset(trial))
        taken = take(judge, current, trial)
        if taken is None:
            continue
        judge = taken
        if alone:
            current = alone
            record(action, alone[-1], table)
        current = list(trial)
        record(action, added, table)
        current = better_settings(judge, current, candidates)
        stays: set[Term] = set()
        while (useless := _useless(judge, current, stays)) is not None:
            rest = [s for s in current if s != useless]
            taken = without(judge, current, rest, useless)
            if taken is None:
                stays.add(useless)
                continue
            judge, current = taken, rest
            dropped[useless] += 1
            seen.add(frozenset(current))
            record("drop", useless)
    return judge, steps


def take(judge: Judge, current: Sequence[Term], trial: Sequence[Term]) -> Judge | None:
    """The judge at ``trial``; None where that does not keep what its tangent at ``current`` promised.

    Candidates are judged with every law linear where the model stands; the law as it is may end far from there.
    """
    limit = max(judge.evidence.held(terms, physical=True).score for terms in (current, trial))
    there = judge.at(trial)
    kept = there.evidence.held(trial, physical=True).score <= (1 + BROKEN_PROMISE) * limit
    return there if kept else None


def without(judge: Judge, current: Sequence[Term], rest: Sequence[Term], useless: Term) -> Judge | None:
    """The judge at ``rest``, which are ``current`` but for ``useless``; None where a re-fit of them needs it all the
    same.

    A drop may end far from where its tangent promised, too: a gain follows the torque of all that is named, and
    without the friction that it multiplies it ran away.
    """
    there = judge.at(rest)
    held = there.evidence.held
    loss = there.gain(held(current, physical=True), held(rest, physical=True))
    return None if there.needs(useless, loss, judge.settings.keep_share) else there


def better_settings(judge: Judge, current: Sequence[Term], candidates: Sequence[Term]) -> list[Term]:
    """Choose again among the settings of each effect (the width of a sign, say)."""
    best = list(current)
    score = judge.evidence.held(best).score
    for i, term in enumerate(current):
        if ONLY_RUN in dict(term.settings):
            continue
        for other in candidates:
            if other != term and same_place(other, term):
                trial = [*best[:i], other, *best[i + 1 :]]
                value = judge.evidence.held(trial).score
                if value < score:
                    best, score = trial, value
    return best


def _useless(judge: Judge, current: Sequence[Term], stays: Collection[Term]) -> Term | None:
    """The effect that others explain by now, if any: without it held-out error hardly grows. None of ``stays``."""
    if len(current) < 2:
        return None
    evidence, settings = judge.evidence, judge.settings
    active = evidence.constrained(current)
    full = evidence.held(current, active)
    worst: tuple[float, Term] | None = None
    for term in current:
        if term in stays:
            continue
        if active and judge.plainly_needed(current, term, DECISIVE, settings.keep_share):
            continue
        rest = [s for s in current if s != term]
        if term.family().beside:
            loss = judge.worth(current, term)
        else:
            both = active or evidence.constrained(rest)
            loss = judge.gain(evidence.held(current, both) if both else full, evidence.held(rest, both))
        if not judge.needs(term, loss, settings.keep_share) and (worst is None or loss.total < worst[0]):
            worst = (loss.total, term)
    return None if worst is None else worst[1]


def _replace(
    judge: Judge, current: Sequence[Term], candidates: Sequence[Term], before: Held, seen: set[frozenset[Term]]
) -> list[Term] | None:
    """One or two effects, or one family on several joints, replaced by another candidate: surely better, or as good and
    simpler.

    A wrong zero turns gravity on every joint behind it, and each joint's offset takes up its own part. A newcomer must
    surely explain something itself: by being simpler alone nothing gets in.
    Trials are screened without the constraints of bodies; what passes is judged with them.
    """
    evidence = judge.evidence
    free = evidence.held(current)
    layout, x = evidence.layout(current), evidence.fit(current)
    torque_of = {s: x[start : start + s.size] for s, start in zip(layout.terms, layout.starts, strict=True)}
    groups: list[tuple[Term, ...]] = [(s,) for s in current]
    if len(current) <= 8:
        groups += [(a, b) for i, a in enumerate(current) for b in current[i + 1 :]]
    alike = {name: tuple(s for s in current if s.effect == name) for name in sorted({s.effect for s in current})}
    groups += [group for group in alike.values() if len(group) > 2]
    likeness = {s: Likeness(evidence, s, own) for s, own in torque_of.items()}
    best: tuple[float, list[Term]] | None = None
    for group in groups:
        rest = [s for s in current if s not in group]
        many = len(group) > 2
        rivals = _one_for_many(judge, group, rest, candidates) if many else _rivals(likeness, group, rest, candidates)
        for term in rivals:
            trial = joined(rest, term)
            if frozenset(trial) in seen:
                continue
            # Of the whole model: the newcomer may hold others as special cases.
            simpler = judge.price(*trial) < judge.price(*current)
            screened = evidence.held(trial)
            # Most trials are far worse: that needs no uncertainty.
            if screened.score > 1.5 * free.score or not _better(judge, term, screened, free, simpler):
                continue
            held = evidence.held(trial, physical=True)
            gain = judge.gain(held, before)
            if not _better(judge, term, held, before, simpler) or (best is not None and -gain.total >= best[0]):
                continue
            if judge.worth(trial, term).surer_than(judge.settings.gain_in_errors):
                best = (-gain.total, trial)
    return None if best is None else best[1]


def _one_for_many(judge: Judge, group: Sequence[Term], rest: Sequence[Term], candidates: Sequence[Term]) -> list[Term]:
    """Of ``candidates`` that act on several joints and cost less than ``group``, those that predict best instead."""
    evidence, price = judge.evidence, judge.price(*group)
    found = [
        (evidence.held(joined(rest, term)).score, term)
        for term in candidates
        if evidence.acts(term).sum() > 1
        and judge.price(term) < price
        and not any(same_place(term, s) or covers(s, term) for s in rest)
    ]
    return [term for _, term in sorted(found, key=lambda item: (item[0], repr(item[1])))[:MOST_RIVALS]]


def _rivals(
    likeness: Mapping[Term, Likeness], group: Sequence[Term], rest: Sequence[Term], candidates: Sequence[Term]
) -> list[Term]:
    """Of ``candidates`` those that can make most of the torque of one of ``group``, the likest of each place.

    What the whole robot reads wrongly shows in every joint's torque, so it need not be like any one effect.
    """
    likest: dict[tuple[Any, ...], tuple[float, Term]] = {}
    for term in candidates:
        if any(same_place(term, s) for s in (*rest, *group)) or any(covers(s, term) for s in rest):
            continue
        reading = term.joint is None and term.family().changes_reading
        share = 1.0 if reading else max(likeness[s].share(term) for s in group)
        if share >= LIKENESS_OF_RIVAL and share > likest.get(term.place, (0.0, term))[0]:
            likest[term.place] = share, term
    order = sorted(likest.values(), key=lambda item: (-item[0], repr(item[1])))
    return [term for _, term in order[:MOST_RIVALS]]


def _lighter(
    judge: Judge, current: Sequence[Term], candidates: Sequence[Term], before: Held, seen: set[frozenset[Term]]
) -> list[Term] | None:
    """A body replaced by two effects of one coefficient each that explain as much.

    A body found first takes what several simple effects have in common; without this they would never be looked at,
    since each alone adds nothing beside it.
    """
    evidence = judge.evidence
    layout = evidence.layout(current)
    x = evidence.fit(current)
    free = elsewhere(candidates, current)
    best: tuple[float, list[Term]] | None = None
    for term, start in zip(layout.terms, layout.starts, strict=True):
        size = term.size
        if not term.family().is_body or size <= 2 or ONLY_RUN in dict(term.settings):
            continue
        rest = [s for s in current if s != term]
        likeness = Likeness(evidence, term, x[start : start + size])
        for pair in pairs(term, free):
            trial = [*rest, *pair]
            if frozenset(trial) in seen or likeness.share(*pair) < LIKENESS_OF_PAIR:
                continue
            held = evidence.held(trial, physical=True)
            good = judge.as_good(held, before) and judge.spares(held, before)
            if good and (best is None or held.score < best[0]):
                best = (held.score, trial)
    return None if best is None else best[1]


def _better(judge: Judge, term: Term, new: Held, old: Held, simpler: bool) -> bool:
    """Whether a ``new`` model, with the newcomer ``term``, is to be preferred to the ``old`` one.

    What is simpler may be as good, on every joint; what is not must be surely better, by something that matters.
    """
    gain = judge.gain(new, old)
    if simpler:
        return -gain.total <= gain.error and judge.spares(new, old)
    settings = judge.settings
    matters = judge.matters(term, gain.per_joint, settings.floor_share, gain.surer_than(DECISIVE))
    return matters and gain.surer_than(settings.gain_in_errors)
