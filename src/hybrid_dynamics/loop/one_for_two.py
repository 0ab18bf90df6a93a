"""One cause in the place of two of its joint that make the same torque while it moves.

Dry friction and an offset are friction that is rougher one way, by the same two numbers: one cause, so it is the name,
and both together are listed. Only where the offset acts at rest, too, are they two. At rest dry friction may hold any
torque, so a single rest says nothing; over many, what is left of the torque is about the offset, or about nothing.
Where they do not say which, the one cause stands with the middle of what may hold the joint.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import t as student

from hybrid_dynamics.effects import Term, family
from hybrid_dynamics.effects.base import ONLY_RUN
from hybrid_dynamics.effects.sign import AT_REST, MIDDLE
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.further import first_as_good
from hybrid_dynamics.loop.likeness import Likeness
from hybrid_dynamics.loop.prune import impossible
from hybrid_dynamics.loop.resting import rests
from hybrid_dynamics.loop.search import take
from hybrid_dynamics.loop.trace import Judge, covers, same_place
from hybrid_dynamics.types import Array


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
            if _at_rest(judge, out, two):
                continue
            there = take(offered, out, trial)
            if there is not None and one not in impossible(there, trial):
                judge, out = there, trial
    return judge, out


def two_for_one(
    judge: Judge, names: Sequence[Term], beside: Sequence[Term], fixed: Collection[Term] = ()
) -> tuple[Judge, list[Term]]:
    """``names`` with two plain effects in the place of one that is equivalent to them and cannot be: estimated next to
    what stands ``beside`` the names, its numbers are others than those by which it was named. With the judge who has
    the columns. Nothing ``fixed``, nor what the starting model has, nor what is a run's own."""
    out = list(names)
    for one in impossible(judge, [*names, *beside]):
        pairs = [alike.effects for alike in one.family().equivalent_to if len(alike.effects) > 1]
        plain = [pair for pair in pairs if all(family(e).everywhere for e in pair)]
        kept = one not in names or one in fixed or judge.evidence.in_base(one) or ONLY_RUN in one.options
        if kept or one.joint is None or not plain:
            continue
        settings = tuple((key, value) for key, value in one.settings if key != AT_REST)
        two = [Term(e, one.joint, settings if e in one.family().contains else ()) for e in plain[0]]
        at, rest = out.index(one), [t for t in out if t != one]
        out[at : at + 1] = [t for t in two if not any(same_place(t, o) or covers(o, t) for o in rest)]
    return judge.adding(out), out


def friction_for_offset(judge: Judge, chosen: Sequence[Term], candidates: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with dry friction, of ``candidates``, in the place of an offset of a joint without any, where it
    predicts held-out rows as well and the rests do not surely say that the offset acts then, too; and the judge there.

    Of a joint that moves one way the two are one torque, and friction is what every joint has.
    """
    out = list(chosen)
    judge = judge.at(out)
    for term in chosen:
        own = [t for t in (*out, *judge.evidence.problem.base_places) if t.joint == term.joint]
        rough = any(t.family().is_friction and not t.family().viscous_powers for t in own)
        if not term.family().like_weight or not term.family().everywhere or rough or judge.evidence.in_base(term):
            continue
        dry = [c for c in candidates if c.joint == term.joint and c.family().everywhere and c.family().turns_sign]
        if not dry or _at_rest(judge, out, [term]):
            continue
        judge = judge.adding(dry)
        evidence, layout = judge.evidence, judge.evidence.layout(out)
        start = layout.starts[layout.terms.index(term)]
        likeness = Likeness(evidence, term, evidence.fit(out)[start : start + term.size])
        # How its sign turns over is not in these rows: that which does not is nearest to what was found.
        likest = max(dry, key=lambda c: (likeness.share(c), repr(c)))
        judge, out = first_as_good(judge, out, [[likest if t == term else t for t in out]], certain=True)
    return judge, out


def with_rest(judge: Judge, chosen: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with friction that is rougher one way holding a joint at rest where it stands, between both of its
    torques, unless the rests of these runs surely say that nothing acts then; and the judge there."""
    out = list(chosen)
    for i, term in enumerate(chosen):
        known = AT_REST in term.family().known_settings and AT_REST not in term.options
        if known and not judge.evidence.in_base(term) and _at_rest(judge, chosen, [term]) is not False:
            out[i] = replace(term, settings=tuple(sorted({**term.options, AT_REST: MIDDLE}.items())))
    return judge.adding(out).at(out), out


def _at_rest(judge: Judge, terms: Sequence[Term], own: Sequence[Term]) -> bool | None:
    """Whether the constant part of ``own`` effects of a joint, of all ``terms``, surely acts where the joint rests or
    surely does not: without them, what is left of the torque at rest is nearer to it, or to nothing (Student's t over
    the rests). None where it cannot be told, or there is none."""
    evidence, joint = judge.evidence, own[0].index
    x, layout = evidence.fit(terms), evidence.layout(terms)
    places = dict(zip(layout.terms, layout.starts, strict=True))
    offset, without = 0.0, x.copy()
    for term in own:
        part = slice(places[term], places[term] + term.size)
        offset += _constant(evidence, term, x[part])
        without[part] = 0.0
    left = evidence.residuals(terms, without)
    means = [
        float(residual[rows, joint].mean())
        for run, residual in zip(evidence.runs, left, strict=True)
        for rows in rests(run.time, np.abs(run.dq[:, joint]) < judge.settings.process.slow_speed)
    ]
    if len(means) < 2 or offset == 0.0:
        return None
    nearer = np.sign(offset) * np.array(means) - abs(offset) / 2
    level = float(student.ppf(1.0 - judge.settings.confirmation, len(means) - 1))
    surely = bool(abs(nearer.mean()) > level * nearer.std(ddof=1) / np.sqrt(len(means)))
    return bool(nearer.mean() > 0) if surely else None


def _constant(evidence: Evidence, term: Term, x: Array) -> float:
    """The constant torque [N m] that coordinates ``x`` (p,) of ``term`` make while its joint moves."""
    kind = term.family()
    return kind.in_descriptions(kind.parameters_of(x, evidence.robot, term), term.options).get("offset", 0.0)


def _instead(judge: Judge, own: Sequence[Term]) -> list[tuple[Term, list[Term]]]:
    """What could stand in the place of effects ``own`` of one joint: the one, with the settings of what it holds, and
    the others. Families with parameters to refine are no matter of the same numbers.

    Also of the one and a part of the others it stands by itself: two numbers of the three say all.
    """
    out = []
    for kind in (family(name) for name in judge.settings.further):
        for alike in kind.equivalent_to:
            parts = [t for t in own if t.effect in alike.effects]
            if len(alike.effects) < 2 or kind.nonlinear_settings or any(map(judge.evidence.in_base, parts)):
                continue
            already = [t for t in own if t.effect == kind.name]
            held = [t for t in parts if t.effect in kind.contains]
            if already and parts:
                out.append((already[0], [*already, *parts]))
            elif len(held) == 1 and {t.effect for t in parts} == set(alike.effects):
                out.append((Term(kind.name, held[0].joint, held[0].settings), parts))
    return out
