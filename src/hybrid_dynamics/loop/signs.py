"""How the sign of dry friction turns over, chosen by the rows that the search leaves out, too.

Below the slow speed dry friction takes any value, so these rows have no say in what is named. They have one in how it
turns over, which moving rows show at their edge only: of the few blocks of a short log the edge may prefer a sign that
is plainly wrong at every reversal. A joint that turns round passes through its slow speeds, and what its torque does
there is the law itself; one that rests is held, and says only which of two equal ways is nearer. There a sharp sign
follows the rounding of a speed that is zero: a narrow one does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.sign import WIDTH, displacement_settings, sign_part, width_settings, with_sign
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.resting import rests
from hybrid_dynamics.loop.trace import Judge

#: A sign of this width [rad/s] is sharp but for speeds that nobody tells from rest; it comes in where no more than this
#: share of the squared error is left.
NARROW, RESTS_GAIN = 1e-3, 0.9


def choose_signs(judge: Judge, current: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """Friction whose sign turns over, joint by joint, in the way that predicts all its rows best.

    All rows are those of rests, too. A way that is surely worse on moving rows is taken only where the joint's
    reversals gain more than they lose. Friction of the starting model stays as it is.
    """
    turning = [s for s in current if s.family().turns_sign and not judge.evidence.in_base(s)]
    # Some families are offered with a sharp sign only.
    further = [*width_settings(judge.settings.sign_widths), *displacement_settings(judge.settings.sign_displacements)]
    narrow = ((WIDTH, NARROW),)
    judge = judge.adding(
        [replace(s, settings=with_sign(s.settings, way)) for s in turning for way in (*further, narrow)]
    )
    # A sharp sign of a speed that is nothing but rounding comes and goes at random: what follows the model's torque (a
    # delay, a gain) would hold that in every trial.
    quiet = {s: replace(s, settings=with_sign(s.settings, narrow)) for s in turning if not sign_part(s.settings)}
    judge, best = judge.at([quiet.get(s, s) for s in current]), list(current)
    evidence = judge.evidence
    ways = [*sorted({sign_part(s.settings) for s in evidence.terms if s.family().turns_sign} - {narrow}), narrow]
    for joint in sorted({s.index for s in turning}):
        own = [i for i, s in enumerate(best) if s.joint == joint and s in turning]
        rows, reversals = _rows(evidence, joint)
        start = list(best)
        reference = evidence.held(start)
        error, turned = evidence.held_out_on(start, joint, (rows, reversals))
        for way in ways:
            trial = [replace(s, settings=with_sign(s.settings, way)) if i in own else s for i, s in enumerate(start)]
            if trial == start or not all(evidence.has(s) for s in trial):
                continue
            value, there = evidence.held_out_on(trial, joint, (rows, reversals))
            loss = judge.gain(reference, evidence.held(trial))
            surely = loss.surer_than(1.0) and np.any(loss.per_joint > judge.settings.floor_share * judge.floor**2)
            if surely and loss.total >= (turned - there) * evidence.weights[joint]:
                continue
            if value < (RESTS_GAIN if way == narrow else 1.0) * error:
                best, error = trial, value
    return judge, best


def _rows(evidence: Evidence, joint: int) -> tuple[list[NDArray[np.bool_]], list[NDArray[np.bool_]]]:
    """(K,) of every run: all rows of ``joint``; and those beside the moving ones at which it does not rest. Neither
    holds moments that the evidence leaves out, since something may push then."""
    every, reversals = [], []
    for run, kept in zip(evidence.runs, evidence.mask, strict=True):
        moving = run.mask[:, joint]
        passing = ~moving
        for rows in rests(run.time, passing):
            passing[rows] = False
        quiet = ~(moving & ~kept[:, joint])
        every.append(quiet)
        reversals.append(passing & quiet)
    return every, reversals
