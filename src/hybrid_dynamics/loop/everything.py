"""Whether everything at once, named or not, predicts the test runs better than what was named.

A few seconds of log show a little of many effects and none of them surely. A model of sure names alone is worse then
than a fit of all of them. Such a fit explains nothing, but that it is better says that something is missing, and where.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import t as student

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.augment import model_of
from hybrid_dynamics.loop.beside import beside_links
from hybrid_dynamics.loop.diagnosis import predict_run
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.trace import Judge, difference_error

#: Worth a word is what at least halves a joint's mean square.
MUCH = 2.0
#: What is left (rms) is worth a word from this share of the joint's torque on: simulations without noise leave less,
#: and no drive's torque is known better.
WORTH = 0.01


def better_with_everything(judge: Judge, candidates: Sequence[Term], model: Model, tests: Sequence[Run]) -> list[str]:
    """A note where all links, friction, offset and armature of every joint, fitted at once to the training runs,
    predict ``tests`` surely and much better than ``model``, joint by joint; else no note.

    "Surely" as with names (:mod:`.confirm`): Student's t over blocks of time, Bonferroni over the joints. Nothing is
    asked where the links are not among ``candidates``, or are in the model already.
    """
    terms = _everything(candidates)
    links = {t.effect for t in terms if t.family().all_links}
    if not links or any(e.effect in links for e in model.effects):
        return []
    there = judge.at(terms)
    there, beside = beside_links(there, terms)
    rival = model_of(there.evidence, [*terms, *beside], False)
    ours, theirs = ([(run.tau - predict_run(m, run)) * run.mask for run in tests] for m in (model, rival))
    times = [run.time for run in tests]
    torque = np.sum([np.sum((run.tau * run.mask) ** 2, axis=0) for run in tests], axis=0)
    names = []
    for j, joint in enumerate(model.robot.joint_names):
        one, other = ([e[:, [j]] for e in part] for part in (ours, theirs))
        large, small = (float(sum(np.sum(e**2) for e in part)) for part in (one, other))
        spread, blocks = difference_error(one, other, times, judge.settings.block, np.ones(1))
        chance = judge.settings.confirmation / len(model.robot.joint_names)
        level = float(student.ppf(1.0 - chance, max(blocks - 1, 1)))
        if large > WORTH**2 * torque[j] and large > MUCH * small and large - small > level * spread:
            names.append(f"{joint} ({large / max(small, 1e-300):.2g} times)")
    if not names:
        return []
    return [
        "all links, friction, offset and armature of every joint, fitted at once, leave much less on the test runs "
        f"(mean square) on {', '.join(names)}: effects are missing there that these runs cannot tell apart; "
        "record longer runs, or runs that move these joints through more poses"
    ]


def _everything(candidates: Sequence[Term]) -> list[Term]:
    """One term of every place that a joint of a real arm has, and all links together."""
    places: dict[tuple[str, int | None], Term] = {}
    for term in candidates:
        own = term.family()
        if own.all_links or (own.scope == "joint" and own.everywhere):
            places.setdefault(term.place, term)
    return list(places.values())
