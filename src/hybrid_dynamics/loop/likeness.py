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

#: What lacks no more than this share of a torque makes the same one.
SAME = 1e-6
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


class Likeness:
    """How much of the weighted torque of ``term`` at coordinates ``x`` others can make."""

    def __init__(self, evidence: Evidence, term: Term, x: Array) -> None:
        self._evidence = evidence
        #: Per joint the columns of the term and their weights in its torque.
        self._own = [(column, x[position]) for position, column in evidence.indices(evidence.layout([term]))]
        self._energy = 0.0
        for j, (column, own) in enumerate(self._own):
            square = evidence.sums.full[j][column[:, None], column]
            self._energy += float(evidence.weights[j] * own @ square @ own)

    def share(self, *others: Term) -> float:
        """Share (0 to 1) of the torque that columns of ``others`` together can produce."""
        evidence = self._evidence
        layout = evidence.layout(others)
        a, b = np.zeros((layout.total, layout.total)), np.zeros(layout.total)
        for j, (position, column) in enumerate(evidence.indices(layout)):
            if len(position):
                full = evidence.sums.full[j]
                a[position[:, None], position] += evidence.weights[j] * full[column[:, None], column]
                own, x = self._own[j]
                if len(own):
                    b[position] += evidence.weights[j] * full[column[:, None], own] @ x
        scale = 1.0 / np.sqrt(np.maximum(np.diag(a), 1e-300))
        scale[np.diag(a) <= 1e-12] = 0.0
        y = b * scale
        if len(y) > 1:
            y = np.asarray(np.linalg.lstsq(a * scale[:, None] * scale[None, :], y, rcond=1e-12)[0], float)
        return float((b * scale) @ y) / self._energy if self._energy > 0 else 0.0
