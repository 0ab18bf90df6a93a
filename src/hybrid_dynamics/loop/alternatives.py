"""Explanations that do as well as the one named: in the place of one name, or one cause in the place of several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_dynamics.effects import Term, family
from hybrid_dynamics.effects.state import Equivalence
from hybrid_dynamics.loop.all_gains import as_good_as
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.floor import FEWEST_ROWS
from hybrid_dynamics.loop.forms import forms_as_good
from hybrid_dynamics.loop.further import further_beside
from hybrid_dynamics.loop.held import Held
from hybrid_dynamics.loop.likeness import LIKENESS_OF_PAIR, SAME, Likeness, Place, pairs
from hybrid_dynamics.loop.prune import impossible
from hybrid_dynamics.loop.scale import gain_families, gain_instead
from hybrid_dynamics.loop.trace import Judge, covers, same_place
from hybrid_dynamics.loop.unseen import MATTERS, unseen_beside
from hybrid_dynamics.types import Array

#: A rival must be able to make at least this share of the effect's torque by itself.
LIKENESS = 0.3
#: How the reason begins where one cause stands for several names: it is listed with each of them, and told once.
INSTEAD = "in the place of "
#: Held-out mean squares may grow by so many times ``alike_share`` where the total is within its uncertainty.
MORE = 5.0


@dataclass(frozen=True)
class _Named:
    """What is named, at its linearisation: ``terms``, what is estimated ``beside`` them, how much others can make of
    each name, and the held-out prediction of all."""

    judge: Judge
    terms: Sequence[Term]
    beside: Sequence[Term]
    likeness: dict[Term, Likeness]
    full: Held

    def without(self, *terms: Term, put: Sequence[Term] = ()) -> list[Term]:
        """All but these, and but what stood beside at a place of what is ``put`` in their place."""
        beside = [t for t in self.beside if not any(same_place(t.as_finding, c) for c in put)]
        return [t for t in (*self.terms, *beside) if t not in terms]

    def as_good(self, held: Held) -> Array | None:
        """Growth of the held-out mean square of each joint (n,), as a share, where ``held`` is as good; else None.

        A growth below what the starting model was known to be off by is no news, and counts as none.
        """
        judge = self.judge
        gain, before = judge.gain(held, self.full), judge.mean_square(self.full)
        growth = judge.mean_square(held) - before
        counted = np.where((growth > 0) & (growth <= judge.misfit**2), 0.0, growth) / np.maximum(before, 1e-300)
        seen = judge.evidence.samples >= FEWEST_ROWS
        share = judge.settings.alike_share
        close = bool(np.all(counted[seen] < share))
        # A whole body in place of one coefficient is no rival unless it predicts held-out runs as well.
        if not close and not (-gain.total <= gain.error and bool(np.all(counted[seen] < MORE * share))):
            return None
        return np.asarray((growth / np.maximum(before, 1e-300))[seen])


def indistinguishable(
    judge: Judge,
    terms: Sequence[Term],
    candidates: Sequence[Term],
    instead: Sequence[Term] = (),
    beside: Sequence[Term] = (),
) -> dict[Term, list[dict[str, Any]]]:
    """What would explain as much in the place of each term (one candidate, or two together), or one cause in the place
    of several terms: why, and the remedy.

    Also asked are the further families on the same joints, which the search asks only where something is left: a gain
    of a joint that carries little is its friction but for a remainder. One that has more numbers than the term must
    predict better by a standard error, or every offset would be a spring, too. ``instead``: another end of the search,
    with gains of single joints, which all links may stand for. ``beside``: what is estimated beside the names, and
    beside what would stand in their place; without it a name may predict parts of a run so badly that anything does
    as well.
    """
    model = [*terms, *beside]
    forms = {term: _other_forms(judge, model, term) for term in terms}
    asked = judge
    judge, further = further_beside(judge, terms, beside)
    evidence = judge.evidence
    x, layout = evidence.fit(model), evidence.layout(model)
    likeness = {
        term: Likeness(evidence, term, x[start : start + term.size])
        for term, start in zip(layout.terms, layout.starts, strict=True)
        if term in terms
    }
    named = _Named(judge, terms, beside, likeness, evidence.held(model, evidence.constrained(model)))
    free, rarer = (
        [c for c in offered if not any(same_place(c, s) or covers(s, c) for s in terms)]
        for offered in (candidates, further)
    )
    together = _one_cause(named, free, rarer)
    out: dict[Term, list[dict[str, Any]]] = {}
    for term in terms:
        declared = [*_one_for_several(named, term), *_several_for_one(named, term)]
        # What stands for several names says more than that it stands for this one.
        told = {_key(entry) for entry in (*declared, *together[term])}
        alone = [entry for entry in _in_place_of(named, term, free, rarer) if _key(entry) not in told]
        listed = [*forms[term], *declared, *together[term], *alone]
        if (twin := term.family().twin(term, evidence.robot)) is not None:
            own = _declared(term, twin.effect)
            why = f"structurally the same: {own.why}"
            same = _as_declared(evidence, twin.effect, twin.joint, why, own)
            listed = [same, *(entry for entry in listed if _key(entry) != _key(same))]
        listed += [e for e in _with_unseen_rest(judge, model, term) if all(_key(e) != _key(other) for other in listed)]
        gain = gain_instead(judge, model, x) if term.family().all_links else None
        # A gain that stands for these and others together is told already.
        if gain is not None and not any(_key(entry) == {(gain.effect,)} for entry in listed):
            known = _declared(gain, term.effect)
            listed.insert(0, _as_declared(evidence, gain.effect, None, known.why, known))
        if term.family().all_links and instead and as_good_as(asked, instead, terms, candidates):
            listed.insert(0, _with_gains(judge, instead, term))
        out[term] = listed
    return out


def _key(entry: dict[str, Any]) -> frozenset[tuple[str, ...]]:
    return frozenset((e["effect"], *e["joints"]) for e in entry["effects"])


def _in_place_of(named: _Named, term: Term, free: Sequence[Term], rarer: Sequence[Term]) -> list[dict[str, Any]]:
    """One of ``free`` or of the further families ``rarer``, or two of ``free`` together, in the place of ``term``."""
    judge = named.judge
    evidence, likeness = judge.evidence, named.likeness[term]
    rest = named.without(term)
    active = evidence.constrained(rest)
    found: dict[frozenset[Place], tuple[float, dict[str, Any]]] = {}
    tried: set[frozenset[Place]] = set()
    singles: list[Term] = []
    for group in [*((c,) for c in (*free, *_best_settings(evidence, rest, likeness, rarer))), *pairs(term, free)]:
        key = frozenset((c.effect, c.joint) for c in group)
        if (active and key in tried) or any(smaller < key for smaller in found):
            continue
        tried.add(key)
        rare = group[0] in rarer
        # The special case of one that is listed says nothing new; but that of ten numbers one or three do as well does.
        special = rare and any(covers(general, group[0]) for general in singles)
        part = special and group[0].family().changes_body and group[0].joint == term.joint
        if special and not part:
            continue
        share = likeness.share(*group)
        alike = share >= (LIKENESS if len(group) == 1 else LIKENESS_OF_PAIR)
        # What is not alike can be the better cause all the same: of those that are rarely looked at that counts.
        if not alike and not (rare and group[0].joint == term.joint):
            continue
        there = [*named.without(term, put=group), *group]
        held = evidence.held(there, active)
        growth = named.as_good(held)
        bodily = not active and any(c.family().changes_body for c in group)
        if growth is None and bodily and evidence.constrained(there):
            # A body that is fitted freely may be none and predict badly, where one that can exist does as well.
            held = evidence.held(there, True)
            growth = named.as_good(held)
        gain = judge.gain(held, named.full)
        dearer = judge.price(*group) > judge.price(term)
        if rare and not part and (dearer or not alike) and gain.total <= (gain.error if dearer else 0.0):
            continue
        # What cannot be is no explanation, however well it fits.
        if growth is not None and set(impossible(judge, [*rest, *group])) & set(group):
            continue
        if growth is not None and (key not in found or -gain.total < found[key][0]):
            same = share > 1 - SAME
            motion = motion_that_would_tell(term, group, same)
            found[key] = -gain.total, _entry(evidence, group, _why(growth, same), motion)
            singles += group if len(group) == 1 else ()
    return [entry for _, entry in sorted(found.values(), key=lambda item: (len(item[1]["effects"]), item[0]))]


def _one_cause(named: _Named, free: Sequence[Term], rarer: Sequence[Term]) -> dict[Term, list[dict[str, Any]]]:
    """For each term, causes that act on several joints and do as well as it and others together that they are like.

    A payload that a few seconds show in the wrist alone is friction and an offset of two joints of the wrist. What the
    whole robot reads wrongly shows in every torque, so it need not be like any one effect.
    """
    judge = named.judge
    evidence = judge.evidence
    found: dict[tuple[Any, ...], tuple[tuple[int, float], Term, list[Term], Array]] = {}
    for cause in (*free, *rarer):
        special = cause in rarer and any(covers(general, cause) for _, general, _, _ in found.values())
        if special or evidence.acts(cause).sum() < 2:
            continue
        reading = cause.joint is None and cause.family().changes_reading
        own = [t for t in named.terms if reading or named.likeness[t].share(cause) >= LIKENESS]
        if len(own) < 2:
            continue
        rest = named.without(*own, put=[cause])
        held = evidence.held([*rest, cause], evidence.constrained([*rest, cause]))
        growth = named.as_good(held)
        if growth is None or cause in impossible(judge, [*rest, cause]):
            continue
        # Of one cause in several settings the one that stands for most is told, and of these what predicts best.
        rank = -len(own), held.score
        if cause.place not in found or rank < found[cause.place][0]:
            found[cause.place] = rank, cause, own, growth
    out: dict[Term, list[dict[str, Any]]] = {term: [] for term in named.terms}
    for _, cause, own, growth in found.values():
        places = " and ".join(t.effect + _of_joint(evidence, t) for t in own)
        why = f"{INSTEAD}{places}: {_why(growth, same=False)}"
        for term in own:
            out[term].append(_entry(evidence, (cause,), why, motion_that_would_tell(term, (cause,), same=False)))
    return out


def _of_joint(evidence: Evidence, term: Term) -> str:
    return "" if term.joint is None else f" of {evidence.robot.joint_names[term.joint]}"


def _entry(evidence: Evidence, group: Sequence[Term], why: str, motion: str) -> dict[str, Any]:
    names = evidence.robot.joint_names
    effects = [{"effect": c.effect, "joints": [] if c.joint is None else [names[c.joint]]} for c in group]
    return {"effects": effects, "why": why, "motion_that_would_tell": motion}


def _best_settings(evidence: Evidence, rest: Sequence[Term], likeness: Likeness, terms: Sequence[Term]) -> list[Term]:
    """Of the settings of each place that are alike the one that predicts best beside ``rest``; where none is, the
    likest."""
    share = {term: likeness.share(term) for term in terms}
    places: dict[tuple[Any, ...], list[Term]] = {}
    for term in terms:
        if share[term] > 0:
            places.setdefault(term.place, []).append(term)
    out = []
    for own in places.values():
        alike = [c for c in own if share[c] >= LIKENESS] or [max(own, key=lambda c: (share[c], repr(c)))]
        out.append(min(alike, key=lambda c: (evidence.held([*rest, c]).score, repr(c))) if len(alike) > 1 else alike[0])
    return out


def _why(growth: Array, same: bool) -> str:
    """One clause; ``growth``: held-out mean square of each joint with the alternative, as a share, less one."""
    if same:
        return "the same torque in every sample of these runs"
    worst, best = 100 * float(np.max(growth)), -100 * float(np.min(growth))
    if worst <= 0.05 < best:
        return f"held-out error is smaller by up to {best:.1f} % (mean square) and larger on no joint"
    return f"held-out error grows by at most {max(worst, 0.0):.1f} % (mean square, worst joint)"


def _other_forms(judge: Judge, terms: Sequence[Term], term: Term) -> list[dict[str, Any]]:
    """Other laws of the same family that leave no surely larger error."""
    out = []
    for form in forms_as_good(judge, terms, term):
        known = _declared(term, form.effect)
        settings = ", ".join(f"{k}: {v}" for k, v in form.settings) or "as it is without settings"
        why = f"the same effect with another law ({settings}) leaves as little: {known.why}"
        out.append(_as_declared(judge.evidence, form.effect, form.joint, why, known))
    return out


def _with_unseen_rest(judge: Judge, terms: Sequence[Term], term: Term) -> list[dict[str, Any]]:
    """Laws that have ``term`` and more, where these runs would not show the rest."""
    out = []
    for general in unseen_beside(judge, terms, term):
        known = _declared(general, term.effect)
        settings = ", ".join(f"{k}: {v:g}" for k, v in general.family().rest_hides_at)
        why = f"{100 * MATTERS:g} % more than {term.effect} would not show in these runs ({settings}): {known.why}"
        out.append(_as_declared(judge.evidence, general.effect, general.joint, why, known))
    return out


def _one_for_several(named: _Named, term: Term) -> list[dict[str, Any]]:
    """Families that say of themselves that ``term`` and others of its joint make their torque, where those do."""
    judge, terms = named.judge, named.terms
    settings = judge.settings
    out = []
    here = np.arange(judge.evidence.n) == term.joint
    for name in (*settings.families, *settings.further):
        kind = family(name)
        for known in kind.equivalent_to:
            together = [t for t in terms if t.joint is not None and t.joint == term.joint and t.effect in known.effects]
            if term not in together or len(together) < 2 or {t.effect for t in together} != set(known.effects):
                continue
            offered = kind.terms(judge.evidence.robot, here, settings.options)
            judge = judge.adding(offered)
            evidence = judge.evidence
            full, rest = evidence.held(named.without(), physical=True), named.without(*together)
            if any(judge.as_good(evidence.held([*rest, c], physical=True), full) for c in offered):
                why = f"{INSTEAD}{' and '.join(known.effects)}: {known.why}"
                out.append(_as_declared(evidence, name, term.joint, why, known))
    return out


def _several_for_one(named: _Named, term: Term) -> list[dict[str, Any]]:
    """Plain effects of its joint that the family of ``term`` says make its torque together, where those do."""
    judge = named.judge
    out: list[dict[str, Any]] = []
    if term.joint is None or judge.evidence.acts(term).sum() != 1:
        return out
    full = named.without()
    for known in term.family().equivalent_to:
        # Others have parameters to refine, or further joints.
        if len(known.effects) < 2 or not all(family(name).everywhere for name in known.effects):
            continue
        # With the settings that they share: a sign that turns over as that of ``term`` does.
        shared = [tuple(s for s in term.settings if s[0] in family(name).known_settings) for name in known.effects]
        group = [Term(name, term.joint, own) for name, own in zip(known.effects, shared, strict=True)]
        if any(same_place(c, t) for c in group for t in named.terms if t != term):
            continue
        offered = judge.adding(group)
        held = offered.evidence.held
        trial = [*named.without(term, put=group), *group]
        if offered.as_good(held(trial, physical=True), held(full, physical=True)):
            out.append(_entry(offered.evidence, group, known.why, _remedy(known)))
    return out


def _with_gains(judge: Judge, instead: Sequence[Term], links: Term) -> dict[str, Any]:
    """The entry of the gains of single joints among ``instead``, which do as well as ``links``."""
    names = [kind.name for kind in gain_families(judge.settings)]
    gains = [t for t in instead if t.effect in names]
    known = _declared(gains[0], links.effect)
    why = f"{INSTEAD}{links.effect}: drives whose torque is read wrongly, each by its own factor, do as well"
    return _entry(judge.evidence, gains, why, _remedy(known))


def _declared(term: Term, effect: str) -> Equivalence:
    """What the family of ``term`` says of its likeness to ``effect`` alone."""
    return next(e for e in term.family().equivalent_to if e.effects == (effect,))


def _as_declared(evidence: Evidence, name: str, joint: int | None, why: str, known: Equivalence) -> dict[str, Any]:
    """The entry of an alternative that a family declares itself, with the remedy that it gives."""
    return {
        "effects": [{"effect": name, "joints": [] if joint is None else [evidence.robot.joint_names[joint]]}],
        "why": why,
        "motion_that_would_tell": _remedy(known),
    }


def _remedy(known: Equivalence) -> str:
    """The remedy that a family gives, as a sentence."""
    return f"{known.remedy[0].upper()}{known.remedy[1:]}."


def motion_that_would_tell(term: Term, others: Sequence[Term], same: bool) -> str:
    """One sentence: which motion separates ``term`` from ``others``."""
    first, last = term.family().shown_by, others[-1]
    why = term.family().inseparable(term, last) or last.family().inseparable(last, term)
    if same and why:
        return why
    rest = list(dict.fromkeys(o.family().shown_by for o in others if o.family().shown_by != first))
    if not rest:
        return f"A motion in which {first}, one joint at a time."
    return f"A motion in which {first}; " + "; ".join(f"then one in which {clause}" for clause in rest) + "."
