"""One cause in the place of two of its joint that make the same torque while it moves.

Dry friction and an offset are friction that is rougher one way, by the same two numbers: one cause, so it is the name,
and both together are listed. Only where the offset acts at rest, too, are they two. At rest dry friction may hold any
torque, so a single rest says nothing; over many, what is left of the torque is about the offset, or about nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from hybrid_dynamics.effects import Term, family
from hybrid_dynamics.loop.search import take
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.types import Array

#: A joint rests where it stays slow for so long [s]; so much at both ends is braking and starting.
RESTS, ENDS = 0.4, 0.1


def one_for_two(judge: Judge, chosen: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with one effect in the place of two of a joint that it is equivalent to, where it costs less and
    predicts held-out rows as well, unless both act at rest; and the judge there.

    What the starting model has of either stays as it is: what is found then is its change.
    """
    out = list(chosen)
    judge = judge.at(out)
    for joint in sorted({t.joint for t in chosen if t.joint is not None}):
        for one, two in _instead(judge, [t for t in out if t.joint == joint]):
            trial = [one if t == two[0] else t for t in out if t not in two[1:]]
            offered = judge.adding([one])
            evidence = offered.evidence
            new, old = (evidence.held(terms, physical=True) for terms in (trial, out))
            if judge.price(*trial) >= judge.price(*out) or not (offered.as_good(new, old) and offered.spares(new, old)):
                continue
            if acts_at_rest(judge, out, two):
                continue
            if (there := take(offered, out, trial)) is not None:
                judge, out = there, trial
    return judge, out


def acts_at_rest(judge: Judge, terms: Sequence[Term], two: Sequence[Term]) -> bool:
    """Whether the constant one of ``two`` of ``terms`` surely acts where their joint rests: without ``two``, what is
    left of the torque at rest is nearer to it than to nothing (Student's t over the rests)."""
    constant = next((t for t in two if t.family().like_weight), None)
    if constant is None:
        return False
    evidence = judge.evidence
    x, layout, joint = evidence.fit(terms), evidence.layout(terms), constant.index
    places = dict(zip(layout.terms, layout.starts, strict=True))
    offset, rest = float(x[places[constant]]), x.copy()
    for term in two:
        rest[places[term] : places[term] + term.size] = 0.0
    left = evidence.residuals(terms, rest)
    means = [
        float(own[rows, joint].mean())
        for run, own in zip(evidence.runs, left, strict=True)
        for rows in _rests(run.time, np.abs(run.dq[:, joint]) < judge.settings.process.slow_speed)
    ]
    if len(means) < 2:
        return False
    nearer = np.sign(offset) * np.array(means) - abs(offset) / 2
    level = float(student.ppf(1.0 - judge.settings.confirmation, len(means) - 1))
    return bool(nearer.mean() > level * nearer.std(ddof=1) / np.sqrt(len(means)))


def _rests(time: Array, slow: NDArray[np.bool_]) -> list[slice]:
    """Rows within each stretch of ``slow`` (K,) that lasts :data:`RESTS`, without its :data:`ENDS`."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]]).astype(int)))
    out = []
    for first, end in edges.reshape(-1, 2):
        if time[end - 1] - time[first] >= RESTS:
            low, high = np.searchsorted(time, (time[first] + ENDS, time[end - 1] - ENDS))
            out.append(slice(int(low), int(high)))
    return out


def _instead(judge: Judge, own: Sequence[Term]) -> list[tuple[Term, list[Term]]]:
    """What could stand in the place of effects ``own`` of one joint: the one, with the settings of what it holds, and
    the others. Families with parameters to refine are no matter of the same numbers."""
    out = []
    for kind in (family(name) for name in judge.settings.further):
        for alike in kind.equivalent_to:
            two = [t for t in own if t.effect in alike.effects]
            held = [t for t in two if t.effect in kind.contains]
            whole = len(alike.effects) > 1 and {t.effect for t in two} == set(alike.effects)
            if whole and len(held) == 1 and not kind.nonlinear_settings and not any(map(judge.evidence.in_base, two)):
                out.append((Term(kind.name, held[0].joint, held[0].settings), two))
    return out
