"""Whose motion a coupled torque follows: where another joint's would do as well, no coupling is a finding.

In a few moves from pose to pose all joints begin and end together, and what one of them does is a multiple of what any
other does, move by move. A torque that a few seconds leave unexplained then follows somebody's motion, and of many
partners and signs the best one predicts well until the next moves. So a coupling is named where its partner is told
from every other one that the joint may have.

Where joints move in turn, two of them never do at once. What one asks of the other is then in no row that counts, and a
coupling would be another name for each one's own friction, for a joint that stands as large as for one that moves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.law import FROM_JOINT
from hybrid_dynamics.loop.floor import FEWEST_ROWS
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.trace import DECISIVE, Judge, same_place
from hybrid_dynamics.robots import Robot

#: Share of a joint's rows in motion in which its partner has to move, too.
TOGETHER = 0.05


def seen_together(runs: Sequence[Run], robot: Robot, terms: Sequence[Term]) -> list[Term]:
    """Those of ``terms`` of which every joint with a torque moves together with the one that it follows, on enough rows
    of ``runs`` and on no too small share of its own motion; and all that follow no other joint."""
    both = np.sum([run.mask.astype(float).T @ run.mask for run in runs], axis=0)

    def seen(row: int, partner: int | None) -> bool:
        return partner is None or both[row, partner] >= max(FEWEST_ROWS, TOGETHER * both[row, row])

    return [t for t in terms if FROM_JOINT not in t.options or all(seen(*pair) for pair in t.family().rows(robot, t))]


def told_apart(robot: Robot, terms: Sequence[Term]) -> list[str]:
    """One sentence on ``terms`` that are not asked, since joints do not move together."""
    pairs = {tuple(sorted((t.index, robot.joint_names.index(str(t.options[FROM_JOINT]))))) for t in terms}
    if not pairs:
        return []
    which = ", ".join(f"{robot.joint_names[j]} and {robot.joint_names[k]}" for j, k in sorted(pairs))
    return [f"{which}: never move at once, so nobody asks whether they are coupled; move neighbours together for that"]


def partner_open(judge: Judge, chosen: Sequence[Term]) -> dict[Term, list[str]]:
    """Those of ``chosen`` that follow another joint's motion, and in whose place a coupling of the same joint to other
    ones, named here, predicts held-out rows not surely worse. Not a change of what the starting model has.

    Surely: as what counts at any size, since the one that is named is the best of several partners and signs; that the
    two differ by little does not say which of them it is.
    """
    out = {}
    known = judge.evidence.problem.base_places
    for term in chosen:
        if FROM_JOINT not in term.options or any(same_place(term, base) for base in known):
            continue
        others = _others(judge, term)
        there = judge.adding(others)
        full = there.evidence.held(list(chosen), physical=True)
        rest = [t for t in chosen if t != term]
        gains = {c: there.gain(there.evidence.held([*rest, c], physical=True), full, full) for c in others}
        alike = {str(c.options[FROM_JOINT]) for c, gain in gains.items() if -gain.total <= DECISIVE * gain.error}
        if alike:
            out[term] = sorted(alike)
    return out


def _others(judge: Judge, term: Term) -> list[Term]:
    """What the joint of ``term`` may follow instead: its family's terms with other partners."""
    here = np.arange(judge.evidence.n) == term.index
    listed = term.family().terms(judge.evidence.robot, here, judge.settings.options)
    return [c for c in listed if c.joint == term.joint and not same_place(c, term)]


def notes_of(unknown: dict[Term, list[str]], joints: Sequence[str]) -> list[str]:
    """One sentence for each coupling that is not named."""
    return [
        f"{joints[term.index]}: a torque that follows the motion of {term.options[FROM_JOINT]} as well as that of "
        f"{', '.join(others)} is no finding: let {joints[term.index]} rest while each of these moves alone"
        for term, others in unknown.items()
    ]
