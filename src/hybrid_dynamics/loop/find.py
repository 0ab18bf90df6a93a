"""What is missing, found on the training runs alone: the ends of the search, the best one, what is surely there."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop.all_gains import from_gains
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.balanced import balanced, undone
from hybrid_dynamics.loop.cheaper import cheaper, plain_instead
from hybrid_dynamics.loop.complete import complete
from hybrid_dynamics.loop.contact import named as named_contacts
from hybrid_dynamics.loop.contact import run_by_run, worse_with
from hybrid_dynamics.loop.contact import wanted as wanted_contact
from hybrid_dynamics.loop.forms import choose_forms
from hybrid_dynamics.loop.found import Found
from hybrid_dynamics.loop.further import (
    at_the_end,
    further_candidates,
    merge_forms,
    refine,
    reshaped,
    simplify,
    simplify_bodies,
)
from hybrid_dynamics.loop.in_the_hand import payload_for_links
from hybrid_dynamics.loop.known import known_and_beside, known_nearer, much_worse, notes_on, taken_back
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.mounting import turned_by
from hybrid_dynamics.loop.narrow import narrowed
from hybrid_dynamics.loop.one_for_two import friction_for_offset, one_for_two, with_rest
from hybrid_dynamics.loop.partner import notes_of, partner_open
from hybrid_dynamics.loop.prepare import Logs
from hybrid_dynamics.loop.prune import choose, from_everything, impossible, in_errors, keep_sure, without_noise
from hybrid_dynamics.loop.richer import plainer_laws, richer_laws, within_bounds
from hybrid_dynamics.loop.runs import pool, split_by_run, wholes_of
from hybrid_dynamics.loop.scale import gain_for_links, links_for_gain
from hybrid_dynamics.loop.search import Step, search
from hybrid_dynamics.loop.signs import choose_signs
from hybrid_dynamics.loop.slow_sign import slow_signs
from hybrid_dynamics.loop.soundest import End, soundest
from hybrid_dynamics.loop.trace import LEFT, Judge, elsewhere, same_place
from hybrid_dynamics.loop.wandering import without_wandering
from hybrid_dynamics.loop.weighing import as_left, lower_floor, weighed_by
from hybrid_dynamics.loop.widen import widened

#: So often at most floors that turn out lower ask for another look.
MOST_WEIGHINGS = 2
#: A joint outweighs the others where it leaves so many times as many of its floors as another.
LOUD = 2.0
#: So often at most others are asked after something has been let go of.
MOST_RETURNS = 2


def find(judge: Judge, candidates: Sequence[Term], report: Callable[[Step], None], start: Model | None = None) -> Found:
    """Search from everything and from nothing, and from the gains of all joints where these leave much; keep the best
    end, then only what is surely there.

    Where the model found leaves much less than the joints were weighed by at first (a large effect had drowned the
    rest), they are weighed anew and the search goes on from there. What the search's model has beyond ``start`` is
    found by the logs beforehand, and is among the terms whatever else is.
    """
    start = start or judge.evidence.base
    given = turned_by(start, judge.evidence.base)
    candidates = list(candidates)
    looked = len({s.place for s in candidates})
    judge, chosen, steps = _both_ends(judge, candidates, report)
    for _ in range(MOST_WEIGHINGS):
        judge, lower = lower_floor(judge, chosen)
        if lower is None:
            break
        judge, further = search(weighed_by(judge, lower), candidates, report, chosen)
        steps += further
        chosen = list(further[-1].terms)
    end = from_gains(judge, chosen, candidates, report)
    candidates += end.gains
    steps += end.steps
    judge, chosen, offered, further = _with_the_rest(end.judge, end.terms, candidates, report)
    steps += further
    # Another form of what has been looked for already is new, too.
    candidates += offered
    judge, chosen, further = beside_loud(judge, chosen, candidates, report)
    steps += further
    looked = len({s.place for s in candidates})
    judge, chosen = _in_simplest_form(judge, chosen, candidates)
    split, further = split_by_run(judge, chosen, candidates, report)
    parts = list(further[-1].terms) if further else []
    # Where the search let go of every part, nothing differs between runs.
    if wholes_of(parts):
        split, merged, x = pool(split, parts)
        sizes = in_errors(split, merged, x)
        # What is nothing on the whole, now this and now that way, is no cause of the robot.
        if all(sizes.get(s, np.inf) > 1.0 for s in wholes_of(parts)):
            notes = ["the runs disagree: a whole-robot effect has its own parameters in every training run"]
            known = [t for t in given if t not in merged]
            merged, x = [*known, *merged], np.concatenate([np.zeros(sum(t.size for t in known)), x])
            split = split.adding(known)
            return Found(merged, x, wholes_of(parts), [*steps, *further], notes, split, start)
    judge, chosen = _drop_guesses(judge, chosen)
    rounds = list[tuple[End, list[Term], _Sifted]]()
    for left in reversed(range(1 + MOST_RETURNS)):
        judge, chosen, common, further = _surely(judge, chosen, candidates, looked, report)
        sifted = _sifted(judge, chosen, candidates, common, looked, report)
        steps += [*further, *sifted.steps]
        judge, chosen = sifted.judge.adding(given), [*given, *(t for t in sifted.terms if t not in given)]
        there, names, beside = known_and_beside(judge, chosen, candidates, sifted.unsure, given)
        rounds.append((End(there, names, beside, candidates), chosen, sifted))
        lost = _missed(judge, chosen, names, beside) if left else []
        if not lost:
            break
        candidates = elsewhere(sifted.candidates, lost)
        rest = [t for t in chosen if t not in lost and t not in given]
        judge, chosen, further = _refined(judge, rest, candidates, report)
        judge, chosen = _in_simplest_form(judge, chosen, candidates)
        steps += further
    taken, chosen, sifted = rounds[soundest([r[0] for r in rounds], given)]
    there, names, beside, nearer = known_nearer(taken.judge, taken.names, taken.beside, given)
    joints = judge.evidence.robot.joint_names
    notes = [*notes_of(sifted.unknown, joints), *notes_on(taken_back(chosen, names), joints), *nearer]
    there, names, beside, astray = without_wandering(there, names, beside, given)
    notes += astray
    return Found(names, refit(there.evidence, names).x, [], steps, notes, there, start, beside, instead=end.instead)


@dataclass(frozen=True)
class _Sifted:
    """``terms`` that are there, ``judge`` there and the ``steps``; ``unsure``: what every joint has, too unsure to be
    named; ``candidates`` without what cannot be; ``unknown``: couplings whose partner is open, with who it could be."""

    judge: Judge
    terms: list[Term]
    unsure: list[Term]
    candidates: list[Term]
    unknown: dict[Term, list[str]]
    steps: list[Step]


def _sifted(
    judge: Judge,
    chosen: Sequence[Term],
    candidates: Sequence[Term],
    common: Collection[str],
    looked: int,
    report: Callable[[Step], None],
) -> _Sifted:
    """``chosen``, that a search surely found, completed by what every joint has, in fewest and plainest causes."""
    judge, chosen = links_for_gain(judge, chosen)
    judge, chosen = complete(judge, chosen, candidates, common)
    judge, kept = without_noise(judge, chosen)
    if any(not s.family().everywhere for s in chosen if s not in kept):
        # What goes had stood for plain friction, too: of that joint it has not been asked.
        judge, kept = without_noise(*complete(judge, kept, candidates, common))
    judge, found = choose_signs(*gain_for_links(judge, kept))
    judge, kept = without_noise(judge, found, sure=True)
    unsure = [t for t in found if t not in kept and t.family().everywhere]
    judge, chosen = widened(judge, kept, candidates)
    judge, chosen, steps = _as_few_bodies(judge, chosen, candidates, looked, report)
    if chosen != kept:
        # What stood beside one body may be nothing beside all of them.
        judge, chosen = without_noise(judge, chosen)
    # What is left now beside a body may show that less than a body does, and that what had balanced it is nothing.
    bodies = chosen
    judge, chosen = payload_for_links(*simplify_bodies(judge, bodies, candidates), candidates)
    judge, plainer = plain_instead(*cheaper(judge, chosen), candidates)
    if plainer != chosen:
        # What had balanced the costlier law on other joints need not be sure any more.
        judge, chosen, _, further = keep_sure(judge, plainer, looked, report)
        steps += further
    if chosen != bodies:
        judge, chosen = without_noise(judge, chosen, sure=True)
    unknown = partner_open(judge, chosen)
    others = list(candidates)
    cannot_be = [*impossible(judge, chosen), *balanced(judge, chosen)]
    # What is as large as that beside something that cannot be may be plausible without it.
    if lost := [*(cannot_be or undone(judge, chosen)), *unknown]:
        # It could be when it was named, and no longer can beside what came in since.
        rest = [t for t in chosen if t not in lost]
        others = elsewhere(candidates, lost)
        judge, chosen = without_noise(*complete(judge, rest, others, common))
    judge, chosen = friction_for_offset(judge, chosen, others)
    judge, chosen = plainer_laws(*with_rest(*one_for_two(judge, chosen)))
    return _Sifted(judge, chosen, unsure, others, unknown, steps)


def _missed(judge: Judge, chosen: Sequence[Term], names: Sequence[Term], beside: Sequence[Term]) -> list[Term]:
    """What of ``chosen`` is not among ``names`` any more, where these with all that stands ``beside`` predict held-out
    rows much worse (:func:`.known.much_worse`).

    It may have balanced what stays, which then is wrong by all of it. Both are asked where ``chosen`` stands.
    """
    lost = taken_back(chosen, names)
    if not lost:
        return []
    judge = as_left(judge.at(chosen), chosen).adding([*names, *beside])
    held = judge.evidence.held
    after, before = held([*names, *beside], physical=True), held(list(chosen), physical=True)
    return lost if much_worse(judge, after, before) else []


def with_contacts(found: Found, logs: Logs) -> Found:
    """``found`` with what surely pushed in the moments that the search left out, as the model found leaves it there.

    What happens at one time of every training run and in no test run is told run by run.
    """
    name, judge = wanted_contact(found.judge.settings), found.judge
    if name is None or not judge.contacts:
        return found
    model, evidence = found.model(found.terms, False), judge.evidence
    contacts: list[Effect] = []
    for contact in judge.contacts:
        alike = named_contacts(model, evidence.runs, evidence.mask, [contact], name)
        if worse_with(model, alike, logs.test):
            apart = run_by_run(contact, len(evidence.runs))
            alike = named_contacts(model, evidence.runs, evidence.mask, apart, name)
        contacts += alike
    return replace(found, contacts=contacts)


def _as_few_bodies(
    judge: Judge, chosen: Sequence[Term], candidates: Sequence[Term], looked: int, report: Callable[[Step], None]
) -> tuple[Judge, list[Term], list[Step]]:
    """``chosen`` with a body or two in the place of all links where these do as well; the judge there, and the steps.

    Of a single link's body, and not of all links', it is known what it could stand for: a wrong zero, a spring, a gain.
    """
    judge, few = narrowed(judge, chosen, candidates)
    if few == list(chosen):
        return judge, few, []
    judge, offered = further_candidates(judge, few)
    asked = [*candidates, *offered]
    judge, few, steps = _refined(judge, few, asked, report)
    judge, few = _in_simplest_form(judge, few, asked)
    judge, few, _, further = _surely(judge, few, asked, looked, report)
    # Rows at rest had their say on how a sign turns over, and the search has none of it.
    judge, few = choose_signs(judge, few)
    return judge, few, [*steps, *further]


def _in_simplest_form(judge: Judge, chosen: Sequence[Term], candidates: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` in the plainest laws that do as well, and the judge there."""
    return choose_forms(*richer_laws(*slow_signs(*merge_forms(*simplify(*reshaped(judge, chosen), candidates)))))


def _refined(
    judge: Judge,
    chosen: Sequence[Term],
    candidates: Sequence[Term],
    report: Callable[[Step], None],
    replacing: bool = True,
) -> tuple[Judge, list[Term], list[Step]]:
    """Search on from ``chosen`` and refine; without what ends where no such law is, once more. With the judge there."""
    judge, steps = search(judge, candidates, report, chosen, replacing)
    judge, found = within_bounds(*refine(judge, steps[-1].terms))
    if implausible := _implausible(judge, found):
        rest = elsewhere(candidates, implausible)
        judge, further = search(judge, rest, report, [t for t in found if t not in implausible], replacing)
        steps += further
        judge, found = within_bounds(*refine(judge, steps[-1].terms))
        implausible = _implausible(judge, found)
    return judge, [t for t in found if t not in implausible], steps


def _implausible(judge: Judge, found: Sequence[Term]) -> list[Term]:
    """Those of ``found`` that are at the end of what is plausible, or beyond."""
    lost = [*at_the_end(found), *impossible(judge, found)]
    return lost or undone(judge, found)


def _surely(
    judge: Judge, chosen: Sequence[Term], candidates: Sequence[Term], looked: int, report: Callable[[Step], None]
) -> tuple[Judge, list[Term], set[str], list[Step]]:
    """Those of ``chosen`` that are surely there, the judge where they stand, the common families, and the steps.

    What is let go of had kept others out that explain the same torque, and perhaps surely: on the joints that miss it
    they are asked once more.
    """
    offered = list(candidates)
    with_all = judge.mean_square(judge.evidence.held(chosen, physical=True))
    judge, kept, common, steps = keep_sure(judge, chosen, looked, report)
    for _ in range(MOST_RETURNS):
        lost = elsewhere(chosen, kept)
        without = judge.mean_square(judge.evidence.held(kept, physical=True))
        missed = without > with_all + LEFT * judge.floor**2
        if all(s.family().everywhere for s in lost) or not missed.any():
            break
        offered = [
            c
            for c in offered
            if not any(same_place(c, s) for s in lost) and (c.joint is None or missed[c.joint] or c in kept)
        ]
        # What is sure stays: in its place a richer law would take up what the lost one explained.
        other, trial, further = _refined(judge, kept, offered, report, replacing=False)
        steps += further
        other, trial = _in_simplest_form(other, trial, offered)
        if set(trial) == set(kept):
            break
        other, again, same, further = keep_sure(other, trial, looked, report)
        steps += further
        held = other.adding(kept).evidence.held
        if held(again, physical=True).score >= held(kept, physical=True).score:
            break
        judge, chosen, kept, common = other, trial, again, same
    return judge, kept, common, steps


def _both_ends(
    judge: Judge, candidates: Sequence[Term], report: Callable[[Step], None]
) -> tuple[Judge, list[Term], list[Step]]:
    there, everything = from_everything(judge, candidates, report)
    if everything:
        there, further = search(there, candidates, report, everything[-1].terms)
        everything += further
    here, nothing = search(judge, candidates, report)
    ends = [(here, nothing[-1].terms), *([(there, everything[-1].terms)] if everything else [])]
    judge, chosen = choose(ends)
    return judge, chosen, nothing if list(nothing[-1].terms) == chosen else everything


def _with_the_rest(
    judge: Judge, chosen: Sequence[Term], candidates: Sequence[Term], report: Callable[[Step], None]
) -> tuple[Judge, list[Term], list[Term], list[Step]]:
    """``chosen`` once the rest of the catalogue has been asked, too: the judge there, that, what was offered beyond
    ``candidates``, and the steps.

    A fast ripple has passed for noise until it is found: what it had drowned is asked for then.
    """
    chosen, asked, steps = list(chosen), list(candidates), []
    lower = None
    for left in reversed(range(1 + MOST_WEIGHINGS)):
        judge, offered = further_candidates(judge, chosen)
        if not offered and lower is None:
            break
        asked += offered
        there, found, further = _refined(judge, chosen, asked, report)
        steps += further
        # A way of many steps, each as good as the one before, may end far below where it began.
        judge, chosen = choose([(there, found), (judge, chosen)])
        judge, lower = lower_floor(judge, chosen) if left else (judge, None)
        if lower is None:
            break
        judge = weighed_by(judge, lower)
    return judge, chosen, asked[len(candidates) :], steps


def beside_loud(
    judge: Judge, chosen: Sequence[Term], candidates: Sequence[Term], report: Callable[[Step], None]
) -> tuple[Judge, list[Term], list[Step]]:
    """``chosen`` searched on with every joint weighed by what is left of it, the judge who does so, and the steps.

    A joint whose law has no name outweighs the others by the square of what it leaves in floors, and what happens to
    it by chance drowns a cause of theirs.
    """
    left = np.sqrt(judge.mean_square(judge.evidence.held(chosen, physical=True)))
    weighed = np.maximum(judge.floor, left)
    seen = judge.floor > 0
    if not seen.any() or np.ptp(np.log(weighed[seen] / judge.floor[seen])) < np.log(LOUD):
        return judge, list(chosen), []
    quiet = replace(judge, evidence=judge.evidence.weigh(weighed))
    there, found, steps = _refined(quiet, chosen, candidates, report)
    quiet, found = choose([(there, found), (quiet, list(chosen))])
    return quiet, found, steps


def _drop_guesses(judge: Judge, chosen: list[Term]) -> tuple[Judge, list[Term]]:
    """Take back single-joint names on joints where more than half of the excess over the floor stays; and the judge at
    what is kept."""
    judge = judge.at(chosen)
    evidence = judge.evidence
    before = judge.mean_square(evidence.held([]))
    after = judge.mean_square(evidence.held(chosen, physical=True))
    floor = judge.floor**2
    guessed = (after - floor) > np.maximum(0.5 * (before - floor), LEFT * floor)
    kept = [s for s in chosen if s.family().scope != "joint" or s.joint is None or not guessed[s.joint]]
    return judge if len(kept) == len(chosen) else judge.at(kept), kept
