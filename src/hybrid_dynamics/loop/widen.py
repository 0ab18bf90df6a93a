"""One link changed beyond belief, or all links a little? The data may not tell; what the URDF says of the links does.

Where several links are off and a run is short, the ten numbers of one link can stand for all of them: with a mass that
no such link has, right in the poses of the run and far off in others. The burden of proof is then turned round: all
links together, each near what the URDF says, take its place where they predict held-out samples no worse.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.inertial_parameters import body_scale
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.beside import beside_links
from hybrid_dynamics.loop.trace import Judge, joined
from hybrid_dynamics.types import Array

#: A link that differs by more than this multiple of a plausible change (half its mass, shifted by its own size) is
#: not believed: one of twice its mass is.
BELIEVED = 2.0
#: Of the ten parameters mass and first moment: inertias show in accelerations, in a short run hardly.
WEIGHED = 4


def widened(judge: Judge, chosen: Sequence[Term]) -> list[Term]:
    """``chosen`` with all links' parameters in the place of bodies, where one of these is beyond belief.

    What is estimated beside all links stands beside them here, too: a constant torque is what one link bends itself for.
    """
    evidence = judge.evidence
    links = [t for t in evidence.columns.terms if t.family().all_links]
    if not links or links[0] in chosen:
        return list(chosen)
    x = refit(evidence, chosen)
    if beyond_belief(judge, chosen, x) <= BELIEVED:
        return list(chosen)
    before = evidence.held(chosen, physical=True).score
    trial = joined(chosen, links[0])
    refit(evidence, chosen, everything=True)
    together = [*trial, *beside_links(judge, trial)]
    refit(evidence, together)
    if evidence.held(together, physical=True).score <= before:
        return trial
    refit(evidence, chosen)
    return list(chosen)


def beyond_belief(judge: Judge, chosen: Sequence[Term], x: Array) -> float:
    """Largest change of a link's mass or first moment by single bodies of ``chosen`` at ``x``, in plausible changes."""
    evidence = judge.evidence
    layout = evidence.layout(chosen)
    largest = 0.0
    for term, start in zip(layout.terms, layout.starts, strict=True):
        if term.joint is None:
            continue
        for first, own in term.family().inertial_bodies(evidence.robot, term):
            change = np.abs(x[start + first : start + first + len(own)]) / body_scale(own)
            largest = max(largest, float(change[:WEIGHED].max()))
    return largest
