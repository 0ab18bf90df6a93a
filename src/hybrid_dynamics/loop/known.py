"""What stands in the model in the end, and of which numbers something is known.

Held-out rows may miss an effect whose parameters nobody knows: friction and an offset along one way make one torque,
and so do a fall of friction with speed and viscous friction. The torque is there and stays in the model; but a
parameter below its own standard error is no result, and a name without one is none. Plain friction, offset and armature
are estimated beside the names then (:mod:`.beside`), and a law of whose own form nothing is known is given back to the
plain one that it holds. Found on two arms that the project had not seen (a slow KUKA Med7, a Rokae AR5).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from hybrid_dynamics.effects import Effect, Term, family
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.beside import (
    LINKS_WITHIN,
    all_beside,
    held_near,
    links_near,
    links_too,
    plain_beside,
    speaks_against,
)
from hybrid_dynamics.loop.further import plainer_forms
from hybrid_dynamics.loop.held import Held
from hybrid_dynamics.loop.nearer import links_nearer
from hybrid_dynamics.loop.one_for_two import two_for_one
from hybrid_dynamics.loop.trace import Judge, covers, elsewhere, same_place
from hybrid_dynamics.loop.weighing import as_left
from hybrid_dynamics.robots import Robot

#: Standard errors from which on something is known of what every real joint has, and of the surest parameter of
#: anything else (:func:`_least`): within two of nothing that may well be nothing.
EXPECTED, RARE = 1.0, 2.0
#: A joint of which so many times as much is left (mean square) without a cause is wrong by what that had balanced.
WRONG = 2.0


def known_and_beside(
    judge: Judge, chosen: Sequence[Term], candidates: Sequence[Term], unsure: Sequence[Term], fixed: Collection[Term]
) -> tuple[Judge, list[Term], list[Term]]:
    """The judge at the model as it is in the end, names of ``chosen`` of which something is known, and what is
    estimated beside them; ``fixed`` are names whatever is known of them."""
    names, unsure, found = list(chosen), list(unsure), dict[tuple[Any, ...], float]()
    while True:
        judge = as_left(judge.at(names), names)
        judge, beside = all_beside(judge, names, candidates, unsure, found)
        judge = as_left(judge, [*names, *beside])
        judge, effects = _published(judge, names, beside)
        judge, plainer = _plainer(judge, names, effects, candidates, fixed)
        if plainer != names:
            names = plainer
            continue
        least = _least_known(judge, names, effects, fixed)
        if least is None:
            settled = with_links(judge, names, beside, candidates, fixed)
            judge, apart = two_for_one(*settled, fixed)
            if apart == settled[1]:
                return settled
            # What lost its name to the links is asked once more, beside the two.
            names = [t for t in names if t in apart or t not in settled[1]]
            names += [t for t in apart if not any(same_place(t, o) for o in names)]
            continue
        found |= _size(least, effects[names.index(least)])
        names.remove(least)
        if least.family().everywhere:
            unsure = [*elsewhere(unsure, [least]), least]


def _size(term: Term, effect: Effect) -> dict[tuple[Any, ...], float]:
    """At the place of ``term`` the size of the ``effect`` that was found there, where that is one coefficient."""
    values = list(effect.parameters.values())
    return {term.place: abs(values[0])} if term.family().everywhere and len(values) == 1 else {}


def known_nearer(
    judge: Judge, names: Sequence[Term], beside: Sequence[Term], fixed: Collection[Term]
) -> tuple[Judge, list[Term], list[Term], list[str]]:
    """``names`` of which something is known where all links, one of them, are held as near as predicts held-out rows
    best (:mod:`.nearer`); what stands beside them, the judge there, and what is to be said.

    With nearer links others take up what these had made: a name may then be as little as its standard error, which does
    not become less by what is held. Friction, an offset or a rotor stands beside the names then. Where another name
    would be lost, or the links are not held nearer without what went, all stays as it was found.
    """
    there, kept, plain = judge, list(names), list(beside)
    while True:
        near, notes = links_nearer(there, kept, plain)
        if near is there:
            break
        _, effects = _published(near, kept, plain)
        least = _least_known(near, kept, effects, fixed)
        if least is None:
            return near, kept, plain, notes
        if not least.family().everywhere:
            break
        size = _size(least, effects[kept.index(least)])
        kept.remove(least)
        there, held = held_near(there, [least], size)
        plain += held
    return judge, list(names), list(beside), []


def taken_back(chosen: Sequence[Term], names: Sequence[Term]) -> list[Term]:
    """Of ``chosen`` what neither stands among ``names``, nor in a plainer form, nor is what every joint has."""
    rare = [t for t in chosen if not t.family().everywhere]
    return [t for t in rare if not any(same_place(t, n) or covers(t, n) for n in names)]


def notes_on(gone: Sequence[Term], joints: Sequence[str]) -> list[str]:
    """One sentence for each of what was ``gone`` in the end: the search had found it, on ``joints`` by name."""
    return [
        f"{t.effect}{'' if t.joint is None else f' of {joints[t.joint]}'}: held-out samples ask for it, but beside all "
        "that is not known better (links off by a quarter among it) nothing is known of its size: no finding; record "
        "longer runs through more poses"
        for t in gone
    ]


def with_links(
    judge: Judge, names: Sequence[Term], beside: Sequence[Term], candidates: Sequence[Term], fixed: Collection[Term]
) -> tuple[Judge, list[Term], list[Term]]:
    """:func:`known_and_beside` of settled ``names``, with the links beside them where these are off (:mod:`.beside`).

    However near held-out rows hold them for the prediction, a name must be known beside links that are off by a quarter
    (the widest of :data:`LINKS_WITHIN`). Friction, an offset and a rotor of which nothing is known then are estimated
    beside the names, too. Another name was as sure as it was by taking the links for exactly as described: it goes, and
    what is plain of its joint comes in its place. (Found on four seconds of a Panda: a gain of 1.02 known to eleven
    standard errors, and to one of them beside links.) Where other runs surely miss what went, where it is missed so
    much that links cannot stand for it (:func:`much_worse`, on parts of a single run, too), or nothing would stay
    named, the links stay away, and all names stay. Names are asked once more beside the links as they are held in the
    end, where others may make what a name had made; by the same rules, and with what stays the links do.
    """
    settled = judge, list(names), list(beside)
    there, links = links_too(judge, [*names, *beside], candidates) if names else (judge, [])
    if not links:
        return settled
    kept, plain = list(names), list(beside)
    while True:
        while kept:
            there, doubted, effects, least = least_beside_links(there, kept, plain, candidates, fixed)
            if least is None:
                break
            there, plain = _set_beside(there, kept, plain, doubted, least, effects, candidates)
        if len(kept) < len(names):
            # How near, without what went: that had been beside them when it was asked.
            there, links = links_too(there, [*kept, *plain], candidates)
        if not links or not kept:
            return settled
        asked = judge.adding([*kept, *plain, *links])
        before = asked.evidence.held([*names, *beside], physical=True)
        after = asked.evidence.held([*kept, *plain, *links], physical=True)
        if speaks_against(asked, after, before) or (len(kept) < len(names) and much_worse(asked, after, before)):
            return settled
        there, effects = _published(as_left(there, [*kept, *plain, *links]), kept, [*plain, *links])
        settled = there, list(kept), [*plain, *links]
        # Where the links are held otherwise in the end, others make what a name had made.
        least = _least_known(there, kept, effects, fixed)
        if least is None:
            return settled
        there, plain = _set_beside(there, kept, plain, links, least, effects, candidates)


def least_beside_links(
    judge: Judge, names: Sequence[Term], beside: Sequence[Term], candidates: Sequence[Term], fixed: Collection[Term]
) -> tuple[Judge, list[Term], list[Effect], Term | None]:
    """The judge beside links that are off by a quarter (the widest of :data:`LINKS_WITHIN`), these, the effects of
    ``names`` there, and the least sure of the names of which nothing is known then."""
    doubted = links_near(judge, [*names, *beside], candidates, max(LINKS_WITHIN))
    judge = as_left(judge.adding(doubted), [*names, *beside, *doubted])
    judge, effects = _published(judge, names, [*beside, *doubted])
    return judge, doubted, effects, _least_known(judge, names, effects, fixed)


def _set_beside(
    judge: Judge,
    kept: list[Term],
    plain: list[Term],
    links: Sequence[Term],
    least: Term,
    effects: Sequence[Effect],
    candidates: Sequence[Term],
) -> tuple[Judge, list[Term]]:
    """``plain`` with ``least`` itself, or what is plain of its joint; it leaves ``kept``, which have ``effects`` beside
    ``links``. With the judge who has the columns."""
    size = _size(least, effects[kept.index(least)])
    kept.remove(least)
    if least.family().everywhere:
        judge, held = held_near(judge, [least], size)
    else:
        judge, held = plain_beside(judge, [*kept, *plain, *links], candidates)
        held = [t for t in held if t.joint == least.joint]
    return judge, [*plain, *held]


def much_worse(judge: Judge, new: Held, old: Held) -> bool:
    """True where ``new`` predicts held-out rows worse than ``old`` beyond uncertainty, one joint :data:`WRONG` times
    so: no link stands for what went then."""
    much = np.any(judge.mean_square(new) > WRONG * judge.mean_square(old))
    return bool(much) and not judge.as_good(new, old)


def _least_known(
    judge: Judge, names: Sequence[Term], effects: Sequence[Effect], fixed: Collection[Term]
) -> Term | None:
    """:func:`unknown` of ``names`` and their ``effects``, without what is ``fixed``."""
    own = zip(names, effects, strict=True)
    return unknown({t: e for t, e in own if t not in fixed}, judge.evidence.robot)


def unknown(effects: Mapping[Term, Effect], robot: Robot) -> Term | None:
    """The least sure of the terms of ``effects``, found on ``robot``, of which nothing is known: every parameter that
    makes torque lies within its standard error of what it is without, of what is rarer within two of them.
    No body of ten: in few poses only sums of its numbers are known."""
    asked = {t: (e, _amounts(e)) for t, e in effects.items() if not t.family().is_body}
    sizes = {t: published_in_errors(t, e, robot, own) / _least(t, own) for t, (e, own) in asked.items()}
    nothing = [t for t, size in sizes.items() if size < 1.0]
    return min(nothing, key=lambda t: (sizes[t], repr(t)), default=None)


def _least(term: Term, amounts: Sequence[str]) -> float:
    """Standard errors of the surest of ``amounts`` of ``term`` from which on something is known of it. Friction and
    rotors every real joint has, an offset not every torque sensor; friction of several numbers may be surely there with
    none of them sure."""
    kind = term.family()
    every = kind.everywhere and not kind.like_weight
    return EXPECTED if every or (kind.is_friction and len(amounts) > 1) else RARE


def _amounts(effect: Effect) -> list[str]:
    """The parameters of ``effect`` that say how much there is: a ripple whose length is known to a thousandth may be
    none, and a spring rests somewhere."""
    kind = family(effect.effect)
    where = {*kind.says_where, *(r.name for r in kind.nonlinear_settings)}
    return [name for name in effect.parameters if name not in where] or list(effect.parameters)


def published_in_errors(term: Term, effect: Effect, robot: Robot, names: Collection[str] | None = None) -> float:
    """By how much the surest of the parameters ``names`` (default: all) of ``effect``, found as ``term`` on ``robot``,
    differs from what it is without the effect, in its own standard errors; of one without an error, no limit.

    Some families publish what there is in all: a gain of one, the mass of the link, the angles of a base that the
    starting model has tilted.
    """
    without = _without(term, robot)
    errors = effect.std_errors
    sizes = [
        abs(effect.parameters[n] - without.get(n, 0.0)) / errors[n] if errors.get(n) else np.inf
        for n in (effect.parameters if names is None else names)
    ]
    return max(sizes, default=0.0)


def _without(term: Term, robot: Robot) -> dict[str, float]:
    """What the parameters of ``term`` are where nothing is found; a speed or a place that is none there is zero."""
    refined = {r.name for r in term.family().nonlinear_settings}
    with np.errstate(all="ignore"):
        try:
            values = term.family().parameters_of(np.zeros(term.size), robot, term)
        except ZeroDivisionError:
            return {}
    return {name: value for name, value in values.items() if name not in refined and np.isfinite(value)}


def _all_alike(effect: Effect, names: Sequence[str]) -> bool:
    """True where the parameters ``names`` of ``effect`` differ by no more than their errors: of a law of like sizes
    that is the plain one, and where the data is silent of one of them the others say what it is."""
    values = [effect.parameters[name] for name in names]
    return bool(np.ptp(values) < np.linalg.norm([effect.std_errors.get(name, 0.0) for name in names]))


def _published(judge: Judge, names: Sequence[Term], beside: Sequence[Term]) -> tuple[Judge, list[Effect]]:
    """The judge where all stands re-fitted, and the effects of ``names`` with their standard errors."""
    fitted = refit(judge.evidence, [*names, *beside])
    judge = judge.over(fitted.evidence)
    first = len(judge.evidence.base.effects)
    return judge, list(fitted.model().effects[first : first + len(names)])


def _plainer(
    judge: Judge, names: Sequence[Term], effects: Sequence[Effect], candidates: Sequence[Term], fixed: Collection[Term]
) -> tuple[Judge, list[Term]]:
    """``names`` with the plain form in the place of a law of whose own form nothing is known, where held-out rows do
    not miss that law as surely as a name must be; and the judge who has its columns."""
    out = list(names)
    for i, (term, effect) in enumerate(zip(names, effects, strict=True)):
        kind = term.family()
        if term in fixed or kind.is_body or not kind.contains:
            continue
        plain = {p.name for name in kind.contains for p in family(name).parameters}
        own = [name for name in effect.parameters if name not in plain]
        # A speed at which friction falls by nothing has no error, and is not known either.
        robot, errors = judge.evidence.robot, effect.std_errors
        sized = [
            name for name in own if errors.get(name) and published_in_errors(term, effect, robot, [name]) >= EXPECTED
        ]
        if len(sized) == len(own) and not (kind.of_like_size and _all_alike(effect, own)):
            continue
        judge, trials = plainer_forms(judge, out, i, candidates)
        if (law := kind.plainer(term)) is not None and not any(same_place(law, t) for t in out if t != term):
            judge = judge.adding([law])
            trials.append([*out[:i], law, *out[i + 1 :]])
        if not trials:
            continue
        held = judge.evidence.held
        best = min(trials, key=lambda t: (held(t, physical=True).score, repr(t[i])))
        gain = judge.gain(held(out, physical=True), held(best, physical=True))
        if not gain.surer_than(judge.level(judge.evidence.n, gain.blocks)):
            out = best
    return judge, out
