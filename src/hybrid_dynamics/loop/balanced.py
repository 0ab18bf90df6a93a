"""Effects that only something that is none could balance: a huge offset, and a link as heavy as the robot to undo it;
friction that falls with the speed, and ten times as much that rises with it; an offset, and a wave that is as large.

Over a short range of positions a constant torque and a weight that is not there make a bow between them, and follow
with it a law that has no name here; over a short range of speeds powers of the speed do. Each is many times what can
be, and both together predict well where the runs were, and nothing anywhere else: neither is a result.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.carried import rows_and_rms
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.types import Array

#: A body is off by more than a description ever is beyond so many of its plausible changes: a link four times as heavy.
BEYOND = 6.0
#: An effect has made it so where the body is off by less than this share of it without the effect.
UNDONE = 0.5
#: A coefficient of friction, or any other torque on one joint, makes at most so many times all torque that there is on
#: it where it moves, the recorded one and the starting model's together: of more, others must have undone as much.
MOST_TORQUE = 2.0


def balanced(judge: Judge, current: Sequence[Term], among: Sequence[Term] | None = None) -> list[Term]:
    """Those of ``current`` that are no bodies, and without which no body is off by more than a description ever is.

    Looked for ``among`` these (default: all). None where bodies are plausible as they are, and where nothing makes
    them so: a description may hold placeholders.
    """
    rest, out = list(current), []
    while (most := _farthest(judge, rest)) > BEYOND:
        asked = [t for t in rest if not t.family().is_body and (among is None or t in among)]
        trials = [(t, [s for s in rest if s != t]) for t in asked]
        cures = [(t, trial) for t, trial in trials if _farthest(judge, trial) <= UNDONE * most]
        if not cures:
            return []
        term, rest = min(cures, key=lambda cure: (judge.evidence.held(cure[1]).score, repr(cure[0])))
        out.append(term)
    return out


def undone(judge: Judge, current: Sequence[Term]) -> list[Term]:
    """Torques on one joint of ``current`` that make more than there is (:data:`MOST_TORQUE`), so that others must undo
    them, of viscous friction each power of the speed: the largest goes first, and the rest is asked again without it.
    Not where another law follows the time: friction of a cold start may be far more than most of a run shows, and that
    law what it falls by."""
    evidence, rest = judge.evidence, list(current)
    most = MOST_TORQUE * torque_moving(evidence)
    drifting = {t.joint for t in current if t.family().follows_time}
    out: list[Term] = []
    while True:
        x, layout = evidence.fit(rest), evidence.layout(rest)
        excess = {
            term: max(evidence.square_at(term, part) for part in _parts(term, x[start : start + term.size]))
            - most[term.index] ** 2
            for term, start in zip(layout.terms, layout.starts, strict=True)
            if term.joint is not None and _is_torque(term) and term.joint not in drifting
        }
        worst = max(excess, key=lambda t: (excess[t], repr(t)), default=None)
        if worst is None or excess[worst] <= 0.0:
            return out
        out.append(worst)
        rest.remove(worst)


def _parts(term: Term, x: Array) -> Sequence[Array]:
    """Coordinates (p,) of what is asked of ``term`` at ``x`` (p,): of friction each of them alone, any other law as a
    whole. A spring's stiffness and where it rests are two numbers of one torque.
    """
    return list(np.diag(x)) if term.family().is_friction else [x]


def _is_torque(term: Term) -> bool:
    """True for a torque of its own on one joint: neither a body nor a reading of positions or torques."""
    kind = term.family()
    return not (kind.is_body or kind.changes_reading or kind.follows_time)


def torque_moving(evidence: Evidence) -> Array:
    """(n,) [N m] root mean square of every joint's recorded torque and of the starting model's together, each over the
    rows that count."""
    torques = [run.tau for run in evidence.runs], evidence.problem.base_torque
    parts = [list(zip(evidence.runs, own, evidence.mask, strict=True)) for own in torques]
    return np.asarray(np.sum([rows_and_rms(part)[1] for part in parts], axis=0))


def _farthest(judge: Judge, current: Sequence[Term]) -> float:
    """The largest change of a body that a fit of ``current`` makes, in its family's prior scale; 0 without bodies.

    All ten numbers of every body count, a tool's and those of all links too: is any of it out of all proportion? Not
    :func:`.widen.beyond_belief`, which asks of one link whether its own description could be so wrong.
    """
    evidence, most = judge.evidence, 0.0
    if not any(t.family().is_body for t in current):
        return most
    x, layout = evidence.fit(current), evidence.layout(current)
    for term, start in zip(layout.terms, layout.starts, strict=True):
        if term.family().is_body:
            change = np.abs(x[start : start + term.size]) / term.prior_scale(evidence.robot)
            most = max(most, float(change.max(initial=0.0)))
    return most
