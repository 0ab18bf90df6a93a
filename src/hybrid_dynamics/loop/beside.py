"""What is estimated beside the names and is no name: the constant torque of joints beside all links, which can look
like weight, and friction, offset and armature that a log hints at and cannot prove.

In few poses the weight of links makes a constant torque as well as an offset does. Left out, all of it goes into the
links, and other poses are predicted wrongly; least squares, which fits both, shares it between them. So do we: but what
the data cannot tell from weight is no finding, and is held near zero (ridge regression: Hoerl and Kennard 1970).

A few seconds show a little of the friction of every joint, and none of it as surely as a name asks for. A name that is
wrong is worse than none; a prediction without friction is worse than one with a guess of it: where all links are
identified, whose own guesses it would end in, and where most joints are left with more than their floor, everything
that every arm has is estimated. So are the links, which a description knows to within a quarter at best: where most
joints are left with more than their floor, all that are not named are estimated near what they are said to be.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from hybrid_dynamics.effects import Term, family
from hybrid_dynamics.effects.base import HELD
from hybrid_dynamics.effects.inertial_parameters import LINKS
from hybrid_dynamics.loop.balanced import balanced
from hybrid_dynamics.loop.floor import FEWEST_ROWS
from hybrid_dynamics.loop.held import Held
from hybrid_dynamics.loop.prune import on_every_joint
from hybrid_dynamics.loop.trace import ACCEPTED, Judge, all_links_of, covers, has_all_links, has_family

#: Size that such a torque is expected within, as a share of the root mean square of the joint's torque.
EXPECTED = 0.1
#: Links are expected within one of these shares of what is plausible of them (half their mass): from a quarter of their
#: mass, as in a description made from drawings, to a fortieth, as in one that was identified. Held-out rows choose.
LINKS_WITHIN = (0.5, 0.25, 0.1, 0.05)
#: Standard errors by which held-out runs must be worse with them for the links to be left as they are described.
SURELY = 2.0
#: A coefficient of so small a share of what it is held within is none.
NOTHING = 1e-3
#: The size of the coefficient that a search has found at a place.
Sizes = Mapping[tuple[Any, ...], float]
NONE_FOUND: Sizes = MappingProxyType({})


def all_beside(
    judge: Judge,
    chosen: Sequence[Term],
    candidates: Sequence[Term],
    unsure: Sequence[Term] = (),
    found: Sizes = NONE_FOUND,
) -> tuple[Judge, list[Term]]:
    """What is estimated beside the names ``chosen``, for links and for what is too unsure to be named, without what
    makes a body that is none; and the judge who has their columns. ``found``: see :func:`held_near`."""
    judge, beside = beside_links(judge, chosen, found)
    judge, guessed = beside_names(judge, [*chosen, *beside], candidates, unsure, found)
    unnamed = [*beside, *guessed]
    lost = balanced(judge, [*chosen, *unnamed], unnamed)
    return judge, [t for t in unnamed if t not in lost]


def beside_links(judge: Judge, chosen: Sequence[Term], found: Sizes = NONE_FOUND) -> tuple[Judge, list[Term]]:
    """Terms that look like weight, on the joints that move and have no such name among ``chosen``; and the judge who
    has their columns.

    None where the links of the robot are not identified together.
    """
    if not has_all_links(chosen):
        return judge, []
    moving = np.flatnonzero(judge.evidence.samples >= FEWEST_ROWS)
    names = [name for name in judge.settings.families if family(name).like_weight]
    alike = [Term(name, int(j)) for name in names for j in moving if not _makes(chosen, name, int(j))]
    return held_near(judge, alike, found)


def links_too(judge: Judge, model: Sequence[Term], candidates: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """The links of which ``model`` has no body, held near the starting model's, where something is left to find on most
    joints; and the judge who has their columns.

    What the links are off by is too little, or too alike to something else, to be a name: too short a log. A model that
    leaves the links as they are said to be is wrong by all of it. Held-out rows choose how near; against links at all
    they are heard where they are other runs (:func:`speaks_against`). Those that a starting model has found or guessed
    are left as they are: links do not change.
    """
    started = judge.evidence.base.effects
    if has_all_links(model) or any(family(e.effect).all_links for e in started):
        return judge, []
    if not links_near(judge, model, candidates, max(LINKS_WITHIN)):
        return judge, []
    held = judge.evidence.held(list(model), physical=True)
    if not judge.mostly_left(held):
        return judge, []
    trials = []
    for share in LINKS_WITHIN:
        near = links_near(judge, model, candidates, share)
        there = judge.adding(near)
        after = there.evidence.held([*model, *near], physical=True)
        if not speaks_against(there, after, held):
            trials.append((after.score, share, there, near))
    if not trials:
        return judge, []
    *_, there, near = min(trials, key=lambda t: t[:2])
    return there, near


def links_near(judge: Judge, model: Sequence[Term], candidates: Sequence[Term], share: float) -> list[Term]:
    """All links of ``candidates`` of which ``model`` has no body, held within ``share`` of what is plausible: one term,
    or none."""
    links, robot = all_links_of(candidates), judge.evidence.robot
    if links is None:
        return []
    own = {robot.joint_names[j] for t in model if covers(links, t) for j in t.family().joints_of(robot, t)}
    rest = tuple(name for name in links.options[LINKS] if name not in own)
    return [replace(links, settings=tuple(sorted({**links.options, LINKS: rest, HELD: share}.items())))] if rest else []


def speaks_against(judge: Judge, new: Held, old: Held) -> bool:
    """True where other runs are surely predicted worse by ``new`` than by ``old``: parts of a single run move too much
    alike to say what another motion asks of links, and the names were chosen on them with the links as described."""
    return len(judge.evidence.runs) > 1 and judge.gain(old, new).surer_than(SURELY)


def plain_beside(judge: Judge, current: Sequence[Term], candidates: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """Of ``candidates`` the friction, offset and armature that ``current`` lacks on joints on which something is left,
    and the judge who has their columns: what two models need beside them to be compared, before anybody asks which of
    it is there."""
    left = judge.above_floor(judge.evidence.held(list(current), physical=True))
    plain = on_every_joint(candidates)
    return held_near(judge, [t for t in plain if left[t.index] and not _makes(current, t.effect, t.index)])


def beside_names(
    judge: Judge,
    model: Sequence[Term],
    candidates: Sequence[Term],
    unsure: Sequence[Term] = (),
    found: Sizes = NONE_FOUND,
) -> tuple[Judge, list[Term]]:
    """Of friction, offset and armature what ``model`` lacks and held-out rows miss, too little to be named, on joints
    on which something is left to find; and the judge who has their columns. None where nothing is named.

    What a search had found and was too ``unsure`` to be kept comes back where all of it together is missed: one by one
    each can stand for another. Beside all links, which take up what is left out, and where most joints are left with
    more than their floor, the rest of it comes in, as least squares has it on every joint, unless held-out rows speak
    against it. Else every joint by itself, the best first, each by the rule by which a search takes it.
    """
    current = list(model)
    if not current:
        return judge, []
    plain = on_every_joint(candidates)
    left = judge.above_floor(judge.evidence.held(current, physical=True))
    group = [t for t in unsure if left[t.index] and not _makes(current, t.effect, t.index)]
    judge, group = held_near(judge, group, found)
    if len(group) > 1 and _missed(judge, current, group):
        current += group
    held = judge.evidence.held(current, physical=True)
    if has_all_links(current) or judge.mostly_left(held):
        judge, rest = _as_on_every_arm(judge, current, plain)
        return judge, [*current, *rest][len(model) :]
    for joint in np.flatnonzero(judge.above_floor(held)):
        missing = [t for t in plain if t.joint == joint and not has_family(current, t.effect, int(joint))]
        judge, free = held_near(judge, missing)
        while free:
            best = min(free, key=lambda t: (judge.evidence.held([*current, t]).score, repr(t)))
            if not _missed(judge, current, [best]):
                break
            current.append(best)
            free.remove(best)
    return judge, current[len(model) :]


def _as_on_every_arm(judge: Judge, current: Sequence[Term], plain: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """What of ``plain`` is missing in ``current`` on joints on which something is left to find: all of it, else what of
    it held-out rows do not speak against.

    All of it first: through the links each can stand for another's, and one by one the order would decide.
    """
    held = judge.evidence.held(list(current), physical=True)
    judge, missing = plain_beside(judge, current, plain)
    whole = judge.evidence.held([*current, *missing], physical=True)
    # What one joint gains pays for no other's loss.
    good = judge.as_good(whole, held) and judge.spares(whole, held)
    out = missing if good else _one_by_one(judge, current, missing, held)
    # They stand last, and each has one coefficient. What physics holds at nothing is nothing.
    x = judge.evidence.fit([*current, *out])
    values = zip(out, x[len(x) - len(out) :], strict=True)
    return judge, [t for t, value in values if abs(value) > NOTHING * t.options[HELD]]


def _one_by_one(judge: Judge, current: Sequence[Term], missing: Sequence[Term], held: Held) -> list[Term]:
    """Of ``missing`` a joint's together, or what of it is as good on held-out rows as ``current`` alone, ``held``."""
    out: list[Term] = []
    for joint in sorted({t.index for t in missing}):
        own = [t for t in missing if t.index == joint]
        for group in (own, *([t] for t in own if len(own) > 1)):
            trial = judge.evidence.held([*current, *out, *group], physical=True)
            if judge.as_good(trial, held):
                # The best so far is what all are compared with: small losses do not add up.
                out, held = [*out, *group], min(held, trial, key=lambda h: h.score)
                if group is own:
                    break
    return out


def _missed(judge: Judge, current: Sequence[Term], group: Sequence[Term]) -> bool:
    """True where held-out rows miss ``group`` in ``current`` as a search asks for, for one of it at least."""
    held = judge.evidence.held
    after = held([*current, *group], physical=True)
    gain = judge.gain(after, held(current, physical=True))
    return any(judge.reason(term, gain, after) == ACCEPTED for term in group)


def _makes(chosen: Sequence[Term], name: str, joint: int) -> bool:
    """True where one of ``chosen`` is the family ``name`` on ``joint``, or makes what it makes beside another."""
    together = [a.effects for t in chosen if t.joint == joint for a in t.family().equivalent_to if len(a.effects) > 1]
    return has_family(chosen, name, joint) or any(name in effects for effects in together)


def held_near(judge: Judge, terms: Sequence[Term], found: Sizes = NONE_FOUND) -> tuple[Judge, list[Term]]:
    """``terms`` of one coefficient, held within what makes :data:`EXPECTED` of their joint's torque, or within the size
    at which a search had ``found`` what stood at their place, where that is more; and the judge who has their columns.
    None of a joint without torque."""
    judge = judge.adding(terms)
    evidence = judge.evidence
    size = evidence.problem.torque_size
    out = []
    for term in terms:
        joint, square = term.index, evidence.unit_square(term)
        if size[joint] > 0 and square > 0:
            expected = EXPECTED * size[joint] / np.sqrt(square)
            within = float(f"{max(expected, found.get(term.place, 0.0)):.3g}")
            out.append(replace(term, settings=tuple(sorted([*term.settings, (HELD, within)]))))
    return judge.adding(out), out
