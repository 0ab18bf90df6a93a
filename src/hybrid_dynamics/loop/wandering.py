"""What one of the runs surely lacks is no constant of the robot.

An offset, a spring or friction that fits all runs together may be the mean of a law that nobody offers: -9 N m in
one run, 2 in another, and in a third -2. Held-out runs are predicted better with it than without, now and then surely,
and yet it is not there. So where the parameters of an effect differ between runs beyond uncertainty
(:func:`.identifiability.inconsistent`), a run that has surely less than half of the mean contradicts the name. Friction
that is twice as large in a cold run is friction in both. (Found on simulated logs of a law of two joints, which the
catalogue does not have: an offset, a spring.)
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.identifiability import inconsistent
from hybrid_dynamics.loop.known import amounts_of, without_effect
from hybrid_dynamics.loop.trace import Judge

#: A run lacks what it surely has less than this share of, in the mean of all runs; surely: so many standard errors.
LACKING, SURELY = 0.5, 3.0


def wandering(judge: Judge, chosen: Sequence[Term], fixed: Collection[Term] = ()) -> dict[Term, list[str]]:
    """Those of ``chosen`` that are not ``fixed`` and of which runs surely lack every number that says how much there
    is, with the names of these runs; of a body's many numbers all."""
    if len(judge.evidence.runs) < 2:
        return {}
    fitted = refit(judge.evidence, list(chosen))
    first = len(judge.evidence.base.effects)
    effects = dict(zip(chosen, fitted.model(False).effects[first:], strict=True))
    out = {}
    for term, entries in inconsistent(judge.over(fitted.evidence), chosen, fitted.x).items():
        if term in fixed:
            continue
        differing = {entry["parameter"]: entry for entry in entries}
        nothing = without_effect(term, judge.evidence.robot)
        lacking = [_lacking(differing.get(a), nothing.get(a, 0.0)) for a in amounts_of(effects[term])]
        if both := set.intersection(*lacking):
            out[term] = sorted(both)
    return out


def _lacking(entry: Mapping[str, Any] | None, nothing: float) -> set[str]:
    """The runs that surely lack a parameter, which is ``nothing`` without the effect; none of one that is alike."""
    if entry is None:
        return set()
    sizes = np.array([run["value"] - nothing for run in entry["runs"]])
    errors = np.array([run["std_error"] for run in entry["runs"]])
    mean = float((sizes / errors**2).sum() / (1.0 / errors**2).sum())
    lacks = np.sign(mean) * sizes + SURELY * errors < LACKING * abs(mean)
    return {run["run"] for run, lack in zip(entry["runs"], lacks, strict=True) if lack}


def notes_of(gone: Mapping[Term, Sequence[str]], joints: Sequence[str]) -> list[str]:
    """One sentence for each of what is ``gone``."""
    return [
        f"{t.effect}{'' if t.joint is None else f' of {joints[t.joint]}'}: {', '.join(runs)} surely "
        f"{'has' if len(runs) == 1 else 'have'} less than half of it, so it is no finding: it stands for something "
        "that is not in the catalogue, or that changed between the runs"
        for t, runs in gone.items()
    ]
