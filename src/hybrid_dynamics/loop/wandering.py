"""What one of the runs surely lacks is no constant of the robot.

An offset or friction that fits all runs together may be the mean of a law that nobody offers: -9 N m in one run, 2 in
another, and in a third -2. Held-out runs are predicted better with it than without, now and then surely, and yet it is
not there. So plain friction, an offset or a rotor of which a run surely has less than half of what is named is no name:
it is estimated beside the names, where there are any, and a note tells what these runs say. Friction that is twice as
large in a cold run is friction in both. (Found on simulated logs of a law of two joints, which the catalogue does not
have.)

A run is asked with all free that acts on that joint but bodies, since what one law has more of in it the next one has
less of; where that leaves open how much, the run contradicts nothing. What the starting model has is not asked: of that
a change is named, and robots change. Nor are laws of several numbers, which have a form of their own, and bodies
(:mod:`.runs`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.units import unit_of
from hybrid_dynamics.loop.augment import effects_of, refit
from hybrid_dynamics.loop.beside import held_near
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.identifiability import fit_alone
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.loop.weighing import as_left
from hybrid_dynamics.types import Array

#: A run lacks what it surely has less than this share of; surely: so many standard errors of many blocks.
LACKING, SURELY = 0.5, 3.0
#: A run is asked where the joint moves in so many blocks more than coordinates are fitted to it.
FEWEST_BLOCKS = 5
#: Of a run its name, what it says of a coefficient, and the standard error of that.
Said = tuple[str, float, float]


def without_wandering(
    judge: Judge, names: Sequence[Term], beside: Sequence[Term], fixed: Collection[Term] = ()
) -> tuple[Judge, list[Term], list[Term], list[str]]:
    """``names`` without what runs surely lack (``fixed`` stays), what is estimated beside them with it, the judge
    there, and a sentence for each of it. Where no name would be left nothing stands beside."""
    if len(judge.evidence.runs) < 2:
        return judge, list(names), list(beside), []
    everything = [*names, *beside]
    fitted = refit(judge.evidence, everything)
    gone = wandering(judge.over(fitted.evidence), everything, fitted.x, [t for t in names if t not in fixed])
    if not gone:
        return judge, list(names), list(beside), []
    kept = [t for t in names if t not in gone]
    sizes = {t.place: abs(value) for t, (value, _) in gone.items()}
    judge, held = held_near(judge, list(gone), sizes)
    beside = [*beside, *held] if kept else []
    notes = [_note(judge.evidence, t, value, runs) for t, (value, runs) in gone.items()]
    return as_left(judge.at([*kept, *beside]), [*kept, *beside]), kept, beside, notes


def wandering(
    judge: Judge, terms: Sequence[Term], x: Array, asked: Sequence[Term]
) -> dict[Term, tuple[float, list[Said]]]:
    """Of the plain terms ``asked``, among ``terms`` with coordinates ``x``, those that runs surely lack: their
    coefficient of all runs together, and what these runs say."""
    evidence = judge.evidence
    layout = evidence.layout(terms)
    starts = dict(zip(layout.terms, layout.starts, strict=True))
    out = {}
    for term in asked:
        if term.joint is None or not term.family().everywhere or term.size > 1 or evidence.in_base(term):
            continue
        together = [t for t in terms if evidence.acts(t)[term.index] and not t.family().is_body]
        own = np.concatenate([np.arange(starts[t], starts[t] + t.size) for t in together])
        own.sort()
        at, value = int(np.searchsorted(own, starts[term])), float(x[starts[term]])
        lacking: list[Said] = []
        for r, run in enumerate(evidence.runs):
            blocks = evidence.blocks.run == r
            moving = int((evidence.count[blocks, term.index] > 0).sum())
            if moving < len(own) + FEWEST_BLOCKS:
                continue
            solution, covariance, _ = fit_alone(evidence, terms, x, own, blocks)
            size, error = float(solution[at]), float(np.sqrt(covariance[at, at]))
            level = float(student.isf(norm.sf(SURELY) / len(evidence.runs), moving - len(own)))
            if np.sign(value) * size + level * error < LACKING * abs(value):
                lacking.append((run.name, size, error))
        if lacking:
            out[term] = value, lacking
    return out


def _note(evidence: Evidence, term: Term, value: float, runs: Sequence[Said]) -> str:
    (effect,) = effects_of(evidence, [term], np.array([value]))
    parameter = next(iter(effect.parameters))
    unit = unit_of(effect, parameter, evidence.robot.prismatic)
    said = ", ".join(f"{name} {size:.2g} +- {error:.2g}" for name, size, error in runs)
    joint = evidence.robot.joint_names[term.index]
    return (
        f"{term.effect} of {joint}: {value:.3g} {unit} fit all runs together, and {said} surely less than half of "
        "it: no constant of the robot and no finding; something else makes it, or it changed between the runs"
    )
