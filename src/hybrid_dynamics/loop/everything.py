"""Whether everything at once, named or not, predicts the test runs better than what was named.

A few seconds of log show a little of many effects and none of them surely. A model of sure names alone is worse then
than a fit of all of them. Such a fit explains nothing, but that it is better says that something is missing, and where.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.augment import model_of
from hybrid_dynamics.loop.beside import beside_links
from hybrid_dynamics.loop.confirm import change_of, moving_errors
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.prune import on_every_joint
from hybrid_dynamics.loop.trace import Judge, all_links_of
from hybrid_dynamics.types import Array

#: Worth a word is what at least halves a joint's mean square.
MUCH = 2.0
#: What is left (rms) is worth a word from this share of the joint's torque on: simulations without noise leave less,
#: and no drive's torque is known better.
WORTH = 0.01


@dataclass(frozen=True)
class Everything:
    """Per joint (n,): how many ``times`` (mean square) as much the model leaves of the test runs as a fit of everything
    at once does, where that is surely and much more; 1 elsewhere."""

    times: Array

    @property
    def better(self) -> NDArray[np.bool_]:
        """(n,) joints on which effects are missing."""
        return np.asarray(self.times > 1.0)

    def notes(self, joints: Sequence[str]) -> list[str]:
        """What is said of it, if anything."""
        names = [f"{joints[int(j)]} ({self.times[j]:.2g} times)" for j in np.flatnonzero(self.better)]
        if not names:
            return []
        return [
            "all links, friction, offset and armature of every joint, fitted at once, leave much less on the test runs "
            f"(mean square) on {', '.join(names)}: effects are missing there that these runs cannot tell apart; "
            "record longer runs, or runs that move these joints through more poses"
        ]


def better_with_everything(
    judge: Judge, candidates: Sequence[Term], model: Model, tests: Sequence[Run], rounded_away: Array
) -> Everything:
    """Where all links, friction, offset and armature of every joint, fitted at once to the training runs, predict
    ``tests`` surely and much better than ``model``, joint by joint.

    "Surely" as with names (:mod:`.confirm`): Student's t over blocks of time, Bonferroni over the joints. Nothing is
    asked where the links are not among ``candidates``, or are in the starting model; nor where no more is left than
    ``rounded_away`` (n,) [N m]: steps of the torque follow the motion, and a constant takes a part of them.
    """
    times = np.ones(judge.evidence.n)
    links = all_links_of(candidates)
    if links is None or judge.evidence.problem.links_identified:
        return Everything(times)
    terms = [*on_every_joint(candidates), links]
    there, beside = beside_links(judge.at(terms), terms)
    rival = model_of(there.evidence, [*terms, *beside], False)
    ours, theirs = (moving_errors(m, tests) for m in (model, rival))
    left, torque = (
        np.sum([np.sum(e**2, axis=0) for e in part], axis=0) for part in (ours, [run.tau * run.mask for run in tests])
    )
    rows = np.sum([run.mask.sum(axis=0) for run in tests], axis=0)
    for j in np.flatnonzero(left > np.maximum(WORTH**2 * torque, rows * rounded_away**2)):
        change = change_of(judge, ours, theirs, tests, np.eye(len(times))[j], len(times))
        if change.contradicts and change.relative > MUCH - 1.0:
            times[j] = 1.0 + change.relative
    return Everything(times)
