"""A link or two changed much, or all links a little? The data may not tell; what the URDF says of the links does.

Where several links are off and a run is short, the ten numbers of one link can stand for all of them: with a mass that
no such link has, right in the poses of the run and far off in others. The burden of proof is then turned round: all
links together, each near what the URDF says, take its place where they predict held-out samples no worse. Where several
bodies are named, each as it could be, a URDF that is approximate everywhere is as likely: all links are named where
they predict better by a standard error, not by the several that an effect beside others must gain. And where most
joints of an arm whose links were never identified are left with more than their floor, the link that is named is not
all that is off: all links, with the friction that no few seconds prove, take its place unless it predicts better by as
much as an effect must to come in. Where no link is named there, none alone may have been sure: all links come in where
held-out samples gain by them what an effect must, and more where one is off by more than a plausible change. Links that
do not stand for what else has no name on these joints. Constant torques of most joints are what links weigh in few
poses: with three or more named, all links, each within a plausible change, need be no more than as likely, as in the
place of a body. The other way round: :mod:`.narrow`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.inertia import body_scale
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.beside import beside_links, plain_beside
from hybrid_dynamics.loop.held import Held
from hybrid_dynamics.loop.search import take
from hybrid_dynamics.loop.trace import Gain, Judge, covers, joined
from hybrid_dynamics.loop.weighing import counting_by
from hybrid_dynamics.types import Array

#: A link that differs by more than this multiple of a plausible change (half its mass, shifted by its own size) is
#: not believed: one of twice its mass is.
BELIEVED = 2.0
#: And where nothing but what is left on the joints speaks of links, more than one such change must be surer.
PLAUSIBLE = 1.0
#: So many joints must have a constant torque each for them to be what links weigh.
FEWEST = 3
#: Of the ten parameters mass and first moment: inertias show in accelerations, in a short run hardly.
WEIGHED = 4
#: Standard errors by which held-out samples must be predicted better where several bodies are named, all believed.
BETTER = 1.0


def widened(judge: Judge, chosen: Sequence[Term], candidates: Sequence[Term] = ()) -> tuple[Judge, list[Term]]:
    """``chosen`` with all links' parameters in the place of bodies, where one of these is beyond belief, several are
    named, or most joints are left with more than their floor; in the last case also where no body is named, sooner
    where constant torques are that could be weight.

    What is estimated beside all links stands beside them here: a link bends itself for a constant torque. So does, on
    both sides, the friction of ``candidates`` that is missing.
    """
    links = [t for t in judge.evidence.terms if t.family().all_links]
    if not links or not chosen or links[0] in chosen:
        return judge, list(chosen)
    covered = any(covers(links[0], t) for t in chosen)
    bodies = [t for t in chosen if t.family().is_body]
    unbelieved = False
    if bodies:
        fitted = refit(judge.evidence, chosen)
        judge = judge.over(fitted.evidence)
        unbelieved = beyond_belief(judge, chosen, fitted.x) > BELIEVED
    before = with_plain(judge, chosen, candidates)
    left = _unexplained(judge, before)
    if not (unbelieved or left or len(bodies) > 1):
        return judge, list(chosen)
    trial = joined(chosen, links[0])
    judge, beside = beside_links(judge, trial)
    judge, plain = plain_beside(judge, [*trial, *beside], candidates)
    together = [*trial, *beside, *plain]
    after = judge.evidence.held(together, physical=True)
    if left and covered:
        good = as_likely(judge, after, before)
    elif covered:
        good = judge.news(after, before).surer_than(0.0 if unbelieved else BETTER)
    else:
        # All bodies are covered: none is named, and joints are left.
        likely = _like_weight(judge, chosen) and as_likely(judge, after, before)
        good = _as_an_effect(judge, together, judge.news(after, before), likely)
    there = take(judge, chosen, together) if good else None
    return (judge, list(chosen)) if there is None else (there, trial)


def _like_weight(judge: Judge, terms: Sequence[Term]) -> bool:
    """True where ``terms`` have a constant torque on most of the joints that move, three at least: fewer may well be
    what sensors' zeros are off by."""
    constant = {t.index for t in terms if t.family().like_weight}
    return len(constant) >= FEWEST and 2 * len(constant) > int((judge.floor > 0).sum())


def _as_an_effect(judge: Judge, terms: Sequence[Term], gain: Gain, likely: bool) -> bool:
    """True where all links among ``terms`` come in though none is named: for their ``gain``, or, each within a
    plausible change, as ``likely`` as the constant torques that may be their weight."""
    if not (likely or gain.surer_than(judge.settings.gain_in_errors)):
        return False
    change = _largest_change_of_all(judge, terms)
    return (likely and change <= PLAUSIBLE) or gain.surer_than(judge.settings.gain_in_errors * _doubt(change))


def _largest_change_of_all(judge: Judge, terms: Sequence[Term]) -> float:
    """Largest change of a link that ``terms`` re-identify together, in plausible changes."""
    fitted = refit(judge.evidence, terms)
    every = [t for t in terms if t.family().all_links]
    return _largest_change(judge.over(fitted.evidence), terms, every, fitted.x)


def _doubt(change: float) -> float:
    """By how much more than an effect links must gain of which one is off by so many plausible ``change`` s: as the
    square, as if these were standard deviations; by no gain where it is beyond belief."""
    return np.inf if change > BELIEVED else max(change / PLAUSIBLE, 1.0) ** 2


def too_few(judge: Judge, few: Sequence[Term], many: Sequence[Term], candidates: Sequence[Term]) -> bool:
    """True where a ``few`` bodies, with the friction that they lack, leave most joints with more than their floor, and
    ``many``, with all links, are as likely."""
    own = with_plain(judge, few, candidates)
    return _unexplained(judge, own) and as_likely(judge, with_plain(judge, many, candidates), own)


def _unexplained(judge: Judge, few: Held) -> bool:
    """True where a ``few`` bodies leave most joints with more than their floor, and all links may be what is off: not
    where the starting model has them already, as identified."""
    return judge.mostly_left(few) and not judge.evidence.problem.links_identified


def as_likely(judge: Judge, links: Held, few: Held) -> bool:
    """True where a ``few`` bodies do not predict so much better than all ``links`` as an effect must to come in.

    A joint counts by what both leave of it: by what the few leave, one that they do not explain would hardly count.
    """
    both = np.sqrt(0.5 * (judge.mean_square(links) + judge.mean_square(few)))
    fair = counting_by(judge, both)
    return fair.as_good(links, few, judge.settings.gain_in_errors)


def with_plain(judge: Judge, current: Sequence[Term], candidates: Sequence[Term]) -> Held:
    """Held-out predictions of ``current`` beside the friction of ``candidates`` that it lacks.

    What is held near zero has the column of what is not, which the evidence has already: predictions of one evidence
    and the other compare.
    """
    judge, plain = plain_beside(judge, current, candidates)
    return judge.evidence.held([*current, *plain], physical=True)


def beyond_belief(judge: Judge, chosen: Sequence[Term], x: Array) -> float:
    """Largest change of a link's mass or first moment by single bodies of ``chosen`` at ``x``, in plausible changes.

    Plausible is what the link's own description makes so: a light one may change by little. A link's mass or centre
    alone (``link_mass``, ``link_com``) is no body of ten numbers and is not looked at, a tool has no description to
    differ from, and all links together are what this is asked in favour of. Not the measure of :mod:`.balanced`, which
    takes all ten numbers of every body, those of a link against one scale for any robot.
    """
    return _largest_change(judge, chosen, [t for t in chosen if t.joint is not None], x)


def _largest_change(judge: Judge, terms: Sequence[Term], asked: Sequence[Term], x: Array) -> float:
    """Largest change of a mass or first moment by the bodies of ``asked``, of all ``terms`` at ``x``, in plausible
    changes."""
    evidence = judge.evidence
    layout = evidence.layout(terms)
    largest = 0.0
    for term, start in zip(layout.terms, layout.starts, strict=True):
        if term not in asked:
            continue
        for first, own in term.family().inertial_bodies(evidence.robot, term):
            change = np.abs(x[start + first : start + first + len(own)]) / body_scale(own)
            largest = max(largest, float(change[:WEIGHED].max()))
    return largest
