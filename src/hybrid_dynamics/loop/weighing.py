"""By what a joint counts beside the others: its floor during the search, what the model leaves of it in the end.

Links are shared by the joints. Weighed by its floor alone, a joint of which much has no name would bend them to that,
and all others would pay for it. Weighed by what is left of each, the estimate is that of least squares with unequal
noise, known by what it leaves (feasible generalised least squares), which the baseline makes too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.floor import difference_floor
from hybrid_dynamics.loop.noise import noise_floor
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.types import Array

#: Floors that turn out lower by this factor ask for another look.
MUCH = 1.3
#: Times that joints are weighed anew by what the last fit left: as often as the baseline's are.
REWEIGHTINGS = 2


def weighed_by(judge: Judge, floor: Array) -> Judge:
    """``judge`` for whom ``floor`` (n,) [N m] is the floor, and who weighs joints by it."""
    return replace(judge, floor=floor, evidence=judge.evidence.weigh(floor))


def lower_floor(judge: Judge, chosen: Sequence[Term]) -> tuple[Judge, Array | None]:
    """Floors (n,) after ``chosen`` has been added, where one of them is much lower than before, else None; and the
    judge there."""
    fitted = refit(judge.evidence, chosen)
    evidence, x = fitted.evidence, fitted.x
    held = np.sqrt(judge.mean_square(evidence.held(chosen, physical=True)))
    low = difference_floor(evidence.runs, evidence.residuals(chosen, x), evidence.mask)
    rich = np.minimum(noise_floor(evidence, chosen, x), held)
    lower = np.minimum(judge.floor, np.maximum(rich, low))
    seen = judge.floor > 0
    lower = np.where(seen, np.maximum(lower, judge.settings.resolution * np.sqrt(judge.torque_variance)), 0.0)
    return judge.over(evidence), lower if np.any(seen & (lower < judge.floor / MUCH)) else None


def counting_by(judge: Judge, left: Array) -> Judge:
    """``judge`` who weighs joints by what is ``left`` of them (n,) [N m], where that is more than their floor."""
    floor = np.where(judge.floor > 0, np.maximum(judge.floor, left), 0.0)
    return replace(judge, evidence=judge.evidence.weigh(floor))


def as_left(judge: Judge, terms: Sequence[Term]) -> Judge:
    """``judge`` who weighs every joint by what a fit of ``terms`` leaves of it (root mean square, training runs), where
    that is more than its floor."""
    for _ in range(REWEIGHTINGS):
        evidence = judge.evidence
        square = evidence.errors(terms, evidence.fit(terms)).sum(axis=0) / np.maximum(evidence.samples, 1)
        judge = counting_by(judge, np.sqrt(square))
    return judge
