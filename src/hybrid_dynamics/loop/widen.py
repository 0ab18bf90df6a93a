"""A link or two changed much, or all links a little? The data may not tell; what the URDF says of the links does.

Where several links are off and a run is short, the ten numbers of one link can stand for all of them: with a mass that
no such link has, right in the poses of the run and far off in others. The burden of proof is then turned round: all
links together, each near what the URDF says, take its place where they predict held-out samples no worse. Where several
bodies are named, each as it could be, a URDF that is approximate everywhere is as likely: all links are named where
they predict better by a standard error, not by the several that an effect beside others must gain. The other way
round: :mod:`.narrow`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.inertia import body_scale
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.beside import beside_links
from hybrid_dynamics.loop.search import take
from hybrid_dynamics.loop.trace import Judge, joined
from hybrid_dynamics.types import Array

#: A link that differs by more than this multiple of a plausible change (half its mass, shifted by its own size) is
#: not believed: one of twice its mass is.
BELIEVED = 2.0
#: Of the ten parameters mass and first moment: inertias show in accelerations, in a short run hardly.
WEIGHED = 4
#: Standard errors by which held-out samples must be predicted better where several bodies are named, all believed.
BETTER = 1.0


def widened(judge: Judge, chosen: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with all links' parameters in the place of bodies, where one of these is beyond belief or several are
    named.

    What is estimated beside all links stands beside them here, too: a link bends itself for a constant torque.
    """
    links = [t for t in judge.evidence.terms if t.family().all_links]
    bodies = [t for t in chosen if t.family().is_body]
    if not links or links[0] in bodies or not bodies:
        return judge, list(chosen)
    fitted = refit(judge.evidence, chosen)
    unbelieved = beyond_belief(judge, chosen, fitted.x) > BELIEVED
    if not unbelieved and len(bodies) < 2:
        return judge, list(chosen)
    trial = joined(chosen, links[0])
    judge, beside = beside_links(judge.over(fitted.evidence), trial)
    together, evidence = [*trial, *beside], judge.evidence
    gain = judge.news(evidence.held(together, physical=True), evidence.held(chosen, physical=True))
    there = take(judge, chosen, together) if gain.surer_than(0.0 if unbelieved else BETTER) else None
    return (judge, list(chosen)) if there is None else (there, trial)


def beyond_belief(judge: Judge, chosen: Sequence[Term], x: Array) -> float:
    """Largest change of a link's mass or first moment by single bodies of ``chosen`` at ``x``, in plausible changes.

    Plausible is what the link's own description makes so: a light one may change by little. A link's mass or centre
    alone (``link_mass``, ``link_com``) is no body of ten numbers and is not looked at, a tool has no description to
    differ from, and all links together are what this is asked in favour of. Not the measure of :mod:`.balanced`, which
    takes all ten numbers of every body, those of a link against one scale for any robot.
    """
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
