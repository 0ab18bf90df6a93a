"""A third end of the search: of every drive the torque is read too large or too small, of each by its own factor.

A joint's torque is a current times what the maker says of the motor, which may be off by half, on every joint
otherwise. Asked one by one such gains explain little: each multiplies a torque that lacks the friction the others hide,
and a body of one link, which moves several joints at once, comes in first. So where a search leaves most joints with
more than their floor, the gains of all joints are asked together, with all that every arm has, and what is not needed
is dropped. Found on five seconds of an arm that the project had not seen (an AIRBOT Play whose lab says that its torque
constants are wrong): beside one link's body 4 and 6.5 times the error of the gains on two joints of the other run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.beside import LINKS_WITHIN, links_near, plain_beside
from hybrid_dynamics.loop.floor import FEWEST_ROWS
from hybrid_dynamics.loop.held import Held
from hybrid_dynamics.loop.known import WRONG
from hybrid_dynamics.loop.prune import from_everything
from hybrid_dynamics.loop.scale import gain_families
from hybrid_dynamics.loop.search import Step, search
from hybrid_dynamics.loop.trace import Gain, Judge, all_links_of, has_all_links
from hybrid_dynamics.loop.weighing import counting_by
from hybrid_dynamics.loop.widen import BETTER, with_plain

#: Of fewer joints a search asks all gains in pairs.
FEWEST = 3


@dataclass(frozen=True)
class GainsEnd:
    """The better end: its ``terms`` and the ``judge`` there; the ``gains`` that were offered and the ``steps``, where
    it has gains; ``instead``: the end that has gains where it was not better."""

    judge: Judge
    terms: list[Term]
    gains: list[Term] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    instead: list[Term] = field(default_factory=list)


def from_gains(
    judge: Judge, chosen: Sequence[Term], candidates: Sequence[Term], report: Callable[[Step], None]
) -> GainsEnd:
    """``chosen``, or what is needed of gains of all joints and of ``candidates`` where that predicts held-out rows
    better by :data:`BETTER` standard errors than ``chosen`` and than all links do, however near they are held, joints
    counting by what both leave, and much better on one. An end that has gains and was not better may be as good as
    what is named in the end (:func:`as_good_as`).

    Nothing is asked where ``chosen`` has all links (gains in their place: :mod:`.narrow`), where it or all links, with
    the friction that they lack, leave most joints no more than their floor, or of a starting model whose links were
    identified: their drives had their say then, and motors do not change from one day to the next.
    """
    gains, links = _gains(judge), all_links_of(candidates)
    if len(gains) < FEWEST or has_all_links(chosen) or judge.evidence.problem.links_identified:
        return GainsEnd(judge, list(chosen))
    rivals = [list(chosen), *([] if links is None else [[links]])]
    rivals += [near for share in LINKS_WITHIN if (near := links_near(judge, [], candidates, share))]
    held = []
    for rival in rivals:
        held.append(with_plain(judge.adding(rival).at(rival), rival, candidates))
        if not judge.mostly_left(held[-1]):
            return GainsEnd(judge, list(chosen))
    there, steps = from_everything(judge.adding(gains), candidates, report, gains)
    there, further = search(there, [*candidates, *gains], report, steps[-1].terms)
    found = list(further[-1].terms)
    if not any(t in gains for t in found):
        return GainsEnd(judge, list(chosen))
    better = (_better(there, found, rival, own, candidates) for rival, own in zip(rivals, held, strict=True))
    if not all(better):
        return GainsEnd(judge, list(chosen), instead=found)
    return GainsEnd(there, found, gains, [*steps, *further])


def as_good_as(judge: Judge, gains: Sequence[Term], named: Sequence[Term], candidates: Sequence[Term]) -> bool:
    """True where an end of the search that has ``gains`` predicts held-out rows as well as what is ``named`` where
    ``judge`` stands, within a standard error, each with the friction of ``candidates`` that it lacks."""
    alone = with_plain(judge.adding(named), named, candidates)
    there = judge.adding(gains).at(gains)
    gain, gained, _ = _compared(there, gains, named, alone, candidates)
    return min(gain.total, gained) >= -gain.error


def _better(
    judge: Judge, found: Sequence[Term], rival: Sequence[Term], alone: Held, candidates: Sequence[Term]
) -> bool:
    """True where ``found``, where ``judge`` stands, predicts held-out rows surely better than ``rival`` with the
    friction that it lacks, which leaves a joint with :data:`~.known.WRONG` times as much (mean square)."""
    gain, gained, times = _compared(judge, found, rival, alone, candidates)
    return gain.surer_than(BETTER) and times > WRONG and gained > BETTER * gain.error


def _compared(
    judge: Judge, found: Sequence[Term], rival: Sequence[Term], alone: Held, candidates: Sequence[Term]
) -> tuple[Gain, float, float]:
    """What ``found``, where ``judge`` stands, gains over ``rival`` with the friction that it lacks; the same over the
    better of that and of what ``rival`` predicts where it stands ``alone``, on each joint; and how many times as much
    (mean square) that leaves of the joint on which it is worst.

    Where the gains stand a law of the rival may be another.
    """
    judge, plain = plain_beside(judge.adding(rival), rival, candidates)
    own, full = (judge.evidence.held(terms, physical=True) for terms in (found, [*rival, *plain]))
    least = np.minimum(judge.mean_square(full), judge.mean_square(alone))
    fair = counting_by(judge, np.sqrt(0.5 * (judge.mean_square(own) + least)))
    gained = float((least - judge.mean_square(own)) @ (fair.evidence.weights * fair.evidence.samples))
    times = float(np.max(least / np.maximum(judge.mean_square(own), 1e-300)))
    return fair.gain(own, full), gained, times


def _gains(judge: Judge) -> list[Term]:
    """The gains of single joints that move, where gains may be named and the starting model has none there."""
    moving = judge.evidence.samples >= FEWEST_ROWS
    kinds = gain_families(judge.settings)
    listed = [t for k in kinds for t in k.terms(judge.evidence.robot, moving, judge.settings.options)]
    return [t for t in listed if t.joint is not None and not judge.evidence.in_base(t)]
