"""How much of an effect's torque others can make: what could stand in its place."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.types import Array

#: Family and joint of a term, whatever its settings.
Place = tuple[str, int | None]

#: Two effects that stand for another must together make nearly all of its torque.
LIKENESS_OF_PAIR = 0.9


def pairs(term: Term, candidates: Sequence[Term]) -> list[tuple[Term, Term]]:
    """Two effects of one coefficient each that could act together where ``term`` acts."""
    places: dict[Place, Term] = {}
    for c in candidates:
        single = c.family().scope == "joint" and c.family().size == 1
        if single and (term.joint in (None, c.joint) or term.family().scope != "joint"):
            places.setdefault((c.effect, c.joint), c)
    return list(combinations(places.values(), 2))


def overlap(evidence: Evidence, term: Term, x: Array, *others: Term) -> float:
    """Share (0 to 1) of the weighted torque of ``term`` at ``x`` that columns of ``others`` together can produce."""
    one, two = evidence.layout([term]), evidence.layout(others)
    a, b = np.zeros((two.total, two.total)), np.zeros(two.total)
    energy = 0.0
    for j, ((p1, c1), (p2, c2)) in enumerate(zip(evidence.indices(one), evidence.indices(two), strict=True)):
        gram, w = evidence.full_gram[j], evidence.weights[j]
        if len(p1):
            energy += w * float(x[p1] @ gram[np.ix_(c1, c1)] @ x[p1])
        if len(p2):
            a[np.ix_(p2, p2)] += w * gram[np.ix_(c2, c2)]
            if len(p1):
                b[p2] += w * gram[np.ix_(c2, c1)] @ x[p1]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(a), 1e-300))
    scale[np.diag(a) <= 1e-12] = 0.0
    y = np.linalg.lstsq(a * scale[:, None] * scale[None, :], b * scale, rcond=1e-12)[0]
    return float((b * scale) @ y) / energy if energy > 0 else 0.0
