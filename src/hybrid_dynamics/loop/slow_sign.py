"""Dry friction whose sign turns over slowly: one law, where the search has put together several.

Below a few tenths of a radian a second the friction of many geared and lubricated joints is a smooth step (Gaz et al.,
IEEE RA-L 4(4), 2019, identify one on every joint of a Panda). The grid of the search ends at a sharper one; with the
widest of these, or a curved viscous law, or both, it makes something like it. What is offered here is the step itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.sign import WIDTH, with_sign
from hybrid_dynamics.loop.one_setting import best_setting, stands_at_end
from hybrid_dynamics.loop.search import take
from hybrid_dynamics.loop.trace import Judge

#: Widest step [rad/s], if the joint is ever as fast: what is wider than its motion is viscous friction.
WIDEST = 1.0


def slow_signs(judge: Judge, chosen: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with a smooth step in the place of what stands for one, joint by joint, where it predicts better; and
    the judge there.

    The step costs two numbers, its width being one; it comes in only where the whole model costs no more with it, and
    where it costs less if it predicts as well.
    """
    out = list(chosen)
    widest = max(judge.settings.sign_widths)
    for joint in sorted({t.index for t in out if _stands_for_one(t, widest)}):
        own = [t for t in out if t.joint == joint]
        curved = [t for t in own if len(t.family().viscous_powers) > 1]
        viscous = [t for t in own if t.family().viscous_powers == (1,)]
        dry = [t for t in own if _is_dry(t)]
        room = judge.price(*out) - (0.0 if _wide(dry, widest) else 1.0)
        trials = [
            [*rest, step]
            for gone in ([*curved, *dry], [*curved, *dry, *viscous])
            if (step := _best_step(judge, rest := [t for t in out if t not in gone], joint)) is not None
        ]
        trials = [t for t in trials if judge.price(*t) <= room]
        trial = _simplest(judge.adding([term for trial in trials for term in trial]), trials)
        # What was tried and not taken leaves nothing behind: its sign would be a choice later on.
        offered = judge.adding(trial)
        if trial and _serves(offered, trial, out, room):
            there = take(offered, out, trial)
            judge, out = (judge, out) if there is None else (there, trial)
    return judge.at(out), out


def _serves(judge: Judge, trial: Sequence[Term], out: Sequence[Term], room: float) -> bool:
    """True where ``trial`` predicts held-out rows better than ``out``, or costs less than ``room`` and does as well."""
    new, old = (judge.evidence.held(terms, physical=True) for terms in (trial, out))
    return new.score < old.score or (judge.price(*trial) < room and judge.as_good(new, old) and judge.spares(new, old))


def _simplest(judge: Judge, trials: Sequence[list[Term]]) -> list[Term]:
    """Of ``trials`` that predict as well as the best one the one of the lowest price; none of none."""
    held = [judge.evidence.held(trial, physical=True) for trial in trials]
    if not held:
        return []
    best = min(held, key=lambda h: h.score)
    good = [trial for trial, own in zip(trials, held, strict=True) if judge.as_good(own, best)]
    return min(good, key=lambda trial: judge.price(*trial))


def _is_dry(term: Term) -> bool:
    """True for the plain dry friction that every joint may have."""
    return term.family().everywhere and term.family().turns_sign


def _wide(dry: Sequence[Term], widest: float) -> bool:
    """True where one of ``dry`` has the widest sign of the grid, or a wider one: then its width counts already."""
    return any(float(t.options.get(WIDTH, 0.0)) >= widest for t in dry)


def _stands_for_one(term: Term, widest: float) -> bool:
    """True for what a search makes of a smooth step: a curved viscous law, a dry friction as wide as the grid goes."""
    if term.joint is None:
        return False
    return len(term.family().viscous_powers) > 1 or (_is_dry(term) and _wide([term], widest))


def _best_step(judge: Judge, rest: Sequence[Term], joint: int) -> Term | None:
    """The dry friction of ``joint`` beside ``rest`` with the width that predicts best; None where that is no width."""
    evidence = judge.evidence
    offered = [t for t in evidence.terms if t.joint == joint and _is_dry(t)]
    low, high = max(judge.settings.sign_widths), min(WIDEST, float(evidence.problem.fastest[joint]))
    if not offered or not 0.0 < low < high:
        return None

    def step(width: float) -> Term:
        way = ((WIDTH, float(f"{width:.4g}")),)
        return replace(offered[0], settings=with_sign(offered[0].settings, way))

    width, _ = best_setting(evidence, low, high, True, lambda w: [*rest, step(w)])
    return None if stands_at_end(width, low, high, True) else step(width)
