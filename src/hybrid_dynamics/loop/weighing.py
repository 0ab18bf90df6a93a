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
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.types import Array

#: Times that joints are weighed anew by what the last fit left: as often as the baseline's are.
REWEIGHTINGS = 2


def weighed_by(judge: Judge, floor: Array) -> Judge:
    """``judge`` for whom ``floor`` (n,) [N m] is the floor, and who weighs joints by it."""
    return replace(judge, floor=floor, evidence=judge.evidence.weigh(floor))


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
