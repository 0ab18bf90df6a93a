"""The rest of the catalogue, asked where something is left that the plainer families do not explain.

Springs, ripples, couplings, gains, wrong zeros, delays and friction with more parameters are offered on the joints
whose held-out error exceeds what second differences call noise. Nonlinear parameters stand on a coarse grid during the
search and are refined afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import reduce
from itertools import combinations
from typing import Any

import numpy as np

from hybrid_dynamics.effects import Family, Motion, Term, family
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.floor import FEWEST_ROWS, difference_floor
from hybrid_dynamics.loop.one_setting import best_setting, stands_at_end
from hybrid_dynamics.loop.partner import seen_together
from hybrid_dynamics.loop.prune import impossible
from hybrid_dynamics.loop.search import better_settings, take
from hybrid_dynamics.loop.trace import Judge, covers, joined, same_place
from hybrid_dynamics.loop.widen import too_few

#: Of the squared noise by second differences, the share by which a joint must exceed it to be asked further.
EXCESS = 0.1
#: A law with more free numbers than this is named only where it is asked for.
MOST_NUMBERS = 3
#: Runs of less than so much in all [s] are not asked what changes while they last.
TIMED = 25.0
#: Places that are offered at most.
MOST_PLACES = 24
#: Two laws of a joint count together where they lower the held-out error by so many times what either does alone.
TOGETHER = 2.0
#: And so many in the place of bodies.
MOST_INSTEAD = 6
#: Rows that proposals are made from, at most, per run.
_ROWS = 4000


def further_candidates(judge: Judge, chosen: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """The judge at ``chosen``, who has their columns, and terms of the further families on joints where something is
    left."""
    settings, fitted = judge.settings, refit(judge.evidence, chosen)
    evidence, judge = fitted.evidence, judge.over(fitted.evidence)
    residual = evidence.residuals(chosen, fitted.x)
    low = np.minimum(difference_floor(evidence.runs, residual, evidence.mask), judge.low)
    held = judge.mean_square(evidence.held(chosen, physical=True))
    left = (judge.floor > 0) & (held > (1 + EXCESS) * low**2)
    # A body of one link has many numbers: it may stand for a wrong zero or a spring of its joint, and leave nothing.
    bodies = [s for s in chosen if s.family().is_body and s.joint is not None]
    bodily = np.isin(np.arange(evidence.n), [s.index for s in bodies]) & (judge.floor > 0)
    # So may a law of one joint with several numbers for the one that its family says it is like.
    flexible = [s for s in chosen if s.joint is not None and s.size > 1 and s not in bodies and s.family().searched]
    curved = np.isin(np.arange(evidence.n), [s.index for s in flexible]) & (judge.floor > 0)
    hidden = (judge.floor > 0) & any(family(name).like_noise for name in settings.further)
    if not np.any(left | bodily | curved | hidden):
        return judge, []
    motions, rest = [], []
    for run, r in zip(evidence.runs, residual, strict=True):
        thin = slice(None, None, max(len(run.time) // _ROWS, 1))
        states = run.time[thin], run.q[thin], run.dq[thin], run.ddq[thin]
        motions.append(Motion(evidence.robot, *states, began=run.motion.began))
        rest.append(r[thin])
    terms = []
    for name in settings.further:
        kind = family(name)
        where = left | bodily if like_a_body(kind) else left
        where = where | np.isin(np.arange(evidence.n), [s.index for s in flexible if _alike(s, name)])
        if where.any():
            terms += kind.terms(evidence.robot, where, settings.options)
        if (where := where | hidden if kind.like_noise else where).any():
            terms += kind.propose([run.name for run in evidence.runs], motions, rest, where)
    # What the starting model has of them may have become less, in its own form alone.
    given = evidence.problem.base_places
    terms += [t for t in given if t.effect in settings.further and t.joint is not None and left[t.joint]]
    terms = [s for s in _askable(evidence, terms) if not evidence.has(s)]
    judge = judge.adding(terms)
    found = _promising(judge, chosen, terms, MOST_PLACES)
    if bodies:
        alike = [s for s in terms if like_a_body(s.family())]
        instead = _promising(judge, [s for s in chosen if s not in bodies], alike, MOST_INSTEAD)
        found += [s for s in instead if s not in found]
    for own in flexible:
        without = [s for s in chosen if s != own]
        alike = [s for s in terms if s.joint == own.joint and _alike(own, s.effect)]
        for best in _promising(judge, without, alike, 1):
            # Judged against a law whose numbers are all fitted: on the coarse grid it would not have a chance.
            _, refined = refine(judge, joined(without, best), [best.place])
            found += [s for s in refined if s.place == best.place and s not in found]
    return judge.adding(found), found


def _askable(evidence: Evidence, terms: Sequence[Term]) -> list[Term]:
    """Those of ``terms`` that may be asked unnamed: of few numbers, of joints that move together, and of the time only
    where runs show it.

    A short run begins anywhere: what changes in its first seconds can stand for any law of the motion made in them.
    """
    timed = sum(float(run.time[-1] - run.time[0]) for run in evidence.runs) >= TIMED
    few = [
        s for s in dict.fromkeys(terms) if len(s.family().published(s.options)) <= MOST_NUMBERS or evidence.in_base(s)
    ]
    seen = seen_together(evidence.runs, evidence.robot, few)
    return [s for s in seen if timed or not s.family().follows_time]


def further_beside(judge: Judge, terms: Sequence[Term], beside: Sequence[Term] = ()) -> tuple[Judge, list[Term]]:
    """The judge at ``terms`` and what stands ``beside`` them, who has their columns, and terms of the further families
    on the joints that ``terms`` name, and of all joints together.

    Also where nothing is left: what is named may stand for one of them and leave little.
    """
    if not terms:
        return judge, []
    evidence, settings = judge.evidence, judge.settings
    moving = evidence.samples >= FEWEST_ROWS
    named = {j for s in terms if not s.family().all_links for j in s.family().joints_of(evidence.robot, s)}
    asked = [t for name in settings.further for t in family(name).terms(evidence.robot, moving, settings.options)]
    # What all joints have together may stand behind a body and one joint's name, too.
    asked = [t for t in asked if t.joint is None or t.joint in named]
    own = _askable(evidence, asked)
    return judge.adding(own).at([*terms, *beside]), own


def _alike(term: Term, name: str) -> bool:
    """True where the family of ``term`` says that ``name`` can make its torque."""
    return any(name in known.effects for known in term.family().equivalent_to)


def like_a_body(kind: Family) -> bool:
    """True for a wrong zero, a spring, a gain: what a link's body can make the torque of."""
    return any(family(name).changes_body for alike in kind.equivalent_to for name in alike.effects)


def _promising(judge: Judge, chosen: Sequence[Term], terms: Sequence[Term], most: int) -> list[Term]:
    """The best settings of every place, and of the places the ``most`` that lower the held-out error best.

    Of a family that may sit on a joint more than once two count together, too: a wave without its double may predict
    positions that it has not seen worse than none. So do two laws of a joint that lower it by :data:`TOGETHER` times
    what either does alone: a gain of a torque that lacks a spring is nothing.
    """
    evidence = judge.evidence
    now = evidence.held(chosen).score
    best: dict[tuple[Any, ...], tuple[float, Term]] = {}

    def asked(*some: Term) -> float:
        score = evidence.held(reduce(joined, some, list(chosen))).score
        return score if score < now else np.inf

    def noted(score: float, *some: Term) -> None:
        for term in some:
            if score < best.get(term.place, (np.inf, term))[0]:
                best[term.place] = score, term

    alone = {term: asked(term) for term in terms}
    for term, score in alone.items():
        noted(score, term)
    for one, other in combinations([t for t in terms if t.joint is not None and t.size < MOST_NUMBERS], 2):
        if one.joint != other.joint or one.place == other.place:
            continue
        waves = one.effect == other.effect and one.family().several
        laws = one.effect != other.effect and not (one.family().several or other.family().several)
        if not waves and not (laws and one.family().scope == other.family().scope == "joint"):
            continue
        score = asked(one, other)
        least = now - min(alone[one], alone[other], now)
        if np.isfinite(score) and (waves or now - score > TOGETHER * least):
            noted(score, one, other)
    return [term for _, term in sorted(best.values(), key=lambda item: (item[0], repr(item[1])))[:most]]


def simplify(judge: Judge, chosen: Sequence[Term], candidates: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with every effect that holds another as a special case given back to that one where it is as good; and
    the judge there. Bodies are not asked yet: runs may disagree on them."""
    out = list(chosen)
    judge = judge.at(out)
    for i in [i for i, term in enumerate(out) if term.family().contains and not term.family().is_body]:
        judge, trials = plainer_forms(judge, out, i, candidates)
        if not trials:
            continue
        evidence = judge.evidence
        best = min(trials, key=lambda t: (evidence.held(t, physical=True).score, repr(t[i])))
        good = judge.as_good(evidence.held(best, physical=True), evidence.held(out, physical=True))
        if good and (there := take(judge, out, best)) is not None:
            judge, out = there, best
    return judge, out


def reshaped(judge: Judge, chosen: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with every law of the further families in that of its forms that predicts held-out rows best; and the
    judge there.

    A search is offered the form alone that was best when the law was proposed, beside what was still missing then.
    """
    out = list(chosen)
    forms: list[Term] = []
    for term in out:
        kind = term.family()
        if term.joint is None or kind.searched or kind.nonlinear_settings or judge.evidence.in_base(term):
            continue
        forms += [c for c in _listed(judge, term) if c != term]
    if not forms:
        return judge, out
    judge = judge.at(out).adding(forms)
    best = better_settings(judge, out, forms)
    there = take(judge, out, best) if best != out else None
    return (judge, out) if there is None else (there, best)


def _listed(judge: Judge, term: Term) -> list[Term]:
    """The forms of ``term``, of one joint, that its family lists; its own among them unless a parameter was refined."""
    here = np.arange(judge.evidence.n) == term.joint
    listed = term.family().terms(judge.evidence.robot, here, judge.settings.options)
    return [c for c in listed if same_place(c, term)]


def merge_forms(judge: Judge, chosen: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with an effect in another form that holds others of its joint, in their place, where that is as good;
    and the judge there.

    An offset found first makes of a linear spring that comes later one on a crank: of both together the linear one
    alone is left over, and elsewhere they part.
    """
    out = list(chosen)
    judge = judge.at(out)
    for term in chosen:
        if term not in out or term.joint is None:
            continue
        rest = [t for t in out if t != term]
        forms = [c for c in _listed(judge, term) if any(covers(c, t) for t in rest)]
        trials = [joined(rest, c) for c in forms]
        judge = judge.adding(forms)
        trials = sorted(trials, key=lambda t: (judge.evidence.held(t).score, repr(t[-1])))
        judge, out = first_as_good(judge, out, trials)
    return judge, out


def simplify_bodies(judge: Judge, chosen: Sequence[Term], candidates: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with the mass or the centre of a link in the place of a body that holds it, and a mass in the place of
    a centre, the cheapest first, where that is as good; and the judge there.

    Each is judged where its own re-fit stands: the law of a centre of mass that lies far away is not linear.
    """
    out = list(chosen)
    judge = judge.at(out)
    for i, term in enumerate(chosen):
        kind = term.family()
        if not (_cheaper_parts(judge, term) or (kind.contains and kind.is_body)):
            continue
        judge, trials = plainer_forms(judge, out, i, candidates)
        asked = candidates if kind.all_links else None
        judge, out = first_as_good(judge, out, _best_of_each(judge, trials, i), asked)
    return judge, out


def first_as_good(
    judge: Judge,
    chosen: list[Term],
    trials: Sequence[list[Term]],
    candidates: Sequence[Term] | None = None,
    certain: bool = False,
) -> tuple[Judge, list[Term]]:
    """The first of ``trials`` that is as good as ``chosen`` where its own re-fit stands, else ``chosen``; and the judge
    there. Of the friction in ``candidates``: that are not too few for it, either (:func:`.widen.too_few`). ``certain``:
    also a loss that is too small to matter counts where it is surely there."""
    for trial in trials:
        there = take(judge, chosen, trial)
        if there is None:
            continue
        there = there.adding(chosen)
        own, full = (there.evidence.held(terms, physical=True) for terms in (trial, chosen))
        good = there.as_good(own, full) and there.spares(own, full)
        if certain:
            loss = there.gain(own, full, full)
            good = good and -loss.total <= loss.error
        good = good and (candidates is None or not too_few(there, trial, chosen, candidates))
        if good and not any(t not in chosen for t in impossible(there, trial)):
            return there, trial
    return judge, chosen


def plainer_forms(
    judge: Judge, chosen: Sequence[Term], i: int, candidates: Sequence[Term]
) -> tuple[Judge, list[list[Term]]]:
    """``chosen`` with each special case of its ``i``-th term in its place; and the judge who has the columns."""
    plainer = _special_cases(judge, chosen, chosen[i], candidates)
    return judge.adding(plainer), [[*chosen[:i], c, *chosen[i + 1 :]] for c in plainer]


def _special_cases(judge: Judge, chosen: Sequence[Term], term: Term, candidates: Sequence[Term]) -> list[Term]:
    """What ``term`` of ``chosen`` holds as a special case: of ``candidates``, or as the families list it.

    Of a single body also the mass or the centre of any other link: the ten numbers of one stand for its neighbour's
    mass, and cost as much as ten of those.
    """
    robot, parts = judge.evidence.robot, _cheaper_parts(judge, term)
    contained = parts or term.family().contains
    single = bool(parts) or (term.family().is_body and not term.family().all_links)
    joints = range(robot.n_joints) if single else term.family().joints_of(robot, term)
    here = np.isin(np.arange(judge.evidence.n), joints)
    plainer = [c for c in candidates if c.effect in contained and c.joint in joints]
    for name in sorted(contained if single else set(contained) - {c.effect for c in plainer}):
        listed = family(name).terms(robot, here, judge.settings.options)
        plainer += [c for c in listed if c.joint in joints and not any(same_place(c, p) for p in plainer)]
    # Whether one link's ten numbers or all links' is asked elsewhere, with another burden of proof (loop/widen.py).
    bodies = term.family().all_links
    return [c for c in plainer if not any(same_place(c, s) for s in chosen) and not (bodies and c.family().is_body)]


def _cheaper_parts(judge: Judge, term: Term) -> tuple[str, ...]:
    """Families of one link's body that cost less than ``term``, where that is such a part itself: a centre of mass that
    came in the place of ten numbers could be a mass, which those before it had no need to ask for."""
    if term.family().scope != "link" or term.family().is_body or not term.family().changes_body:
        return ()
    kinds = [family(name) for name in (*judge.settings.families, *judge.settings.further)]
    alike = [kind for kind in kinds if kind.scope == "link" and kind.changes_body and not kind.is_body]
    return tuple(kind.name for kind in alike if kind.price({}) < term.family().price(term.options))


def _best_of_each(judge: Judge, trials: Sequence[list[Term]], i: int) -> list[list[Term]]:
    """Of ``trials``, that differ in their ``i``-th term, the one of each family that predicts best under bounds
    alone, cheapest first."""
    best: dict[str, tuple[float, list[Term]]] = {}
    for trial in sorted(trials, key=lambda t: repr(t[i])):
        score = judge.evidence.held(trial).score
        if score < best.get(trial[i].effect, (np.inf, trial))[0]:
            best[trial[i].effect] = score, trial
    return [t for _, t in sorted(best.values(), key=lambda item: (judge.price(item[1][i]), item[0], repr(item[1][i])))]


def _span(judge: Judge, term: Term) -> float:
    """Range [rad] of positions that the joint of ``term`` has in the training runs."""
    q = [run.q[:, term.index] for run in judge.evidence.runs]
    return float(max(map(np.max, q)) - min(map(np.min, q)))


def at_the_end(terms: Sequence[Term]) -> list[Term]:
    """Those of ``terms`` with a nonlinear parameter at the end of what is plausible: they stand for something else."""
    return [
        term
        for term in terms
        if any(
            stands_at_end(float(term.options[r.name]), r.low, r.high, r.log)
            for r in term.family().nonlinear_of(term.options)
        )
    ]


def _with(terms: Sequence[Term], i: int, name: str) -> Callable[[float], list[Term]]:
    """What makes of a value ``terms`` with it as the setting ``name`` of the ``i``-th."""
    return lambda value: [*terms[:i], terms[i].refined(**{name: float(f"{value:.6g}")}), *terms[i + 1 :]]


def refine(
    judge: Judge, chosen: Sequence[Term], places: Collection[tuple[Any, ...]] | None = None
) -> tuple[Judge, list[Term]]:
    """``chosen`` with nonlinear parameters at the best value between their bounds, one after the other, twice; and the
    judge there.

    ``places``: only of the terms there.
    """
    out = list(chosen)
    if not any(s.family().nonlinear_settings for s in out):
        return judge, out
    for _ in range(2):
        for i, term in enumerate(out):
            if (places is not None and term.place not in places) or judge.evidence.in_base(out[i]):
                continue
            for r in term.family().nonlinear_of(term.options):
                start = float(out[i].options[r.name])
                # A grid value is right to a factor of two or so; a harmonic to a quarter period over the range seen.
                reach = max(0.5, np.pi / 2 / max(_span(judge, term), 1e-3))
                low, high = (start / 2.5, start * 2.5) if r.log else (start - reach, start + reach)
                low, high = max(low, r.low), min(high, r.high)
                if not low < high:
                    continue

                model = _with(out, i, r.name)
                value, score = best_setting(judge.evidence, low, high, r.log, model)
                if score < judge.evidence.held(out).score:
                    out = model(value)
                    judge = judge.adding(out)
    return judge.at(out), out
