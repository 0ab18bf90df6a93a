"""What a named law may have besides, where these runs do not go.

A law that holds the named one and something more in a corner of the states (Stribeck friction: more friction at the
slowest speeds) predicts no better than the named one if the runs hardly visit the corner. That it needs one number more
is then no argument against it: the number is not found to be nothing, it is not found at all. It is listed where a rest
of half the size of what is named lies within its uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.effects import Term, family
from hybrid_dynamics.loop.trace import Judge

#: A rest of this share of the named torque matters; within so many standard errors it cannot be excluded.
MATTERS, UNCERTAIN = 0.5, 2.0


def unseen_beside(judge: Judge, terms: Sequence[Term], term: Term) -> list[Term]:
    """Laws that hold ``term``, one of ``terms``, and whose rest these runs do not see."""
    out = []
    for name in (*judge.settings.families, *judge.settings.further):
        kind = family(name)
        if not kind.rest_hides_at or term.effect not in kind.contains or term.joint is None:
            continue
        general = Term(name, term.joint, tuple(sorted((*term.settings, *kind.rest_hides_at))))
        if _hides(judge.adding([general]), terms, term, general):
            out.append(general)
    return out


def _hides(judge: Judge, terms: Sequence[Term], term: Term, general: Term) -> bool:
    """True where a rest of ``general`` (coordinates: what it holds of ``term``, the rest) may be there all the same."""
    evidence = judge.evidence
    trial = [general if t == term else t for t in terms]
    if not judge.as_good(evidence.held(trial, physical=True), evidence.held(terms, physical=True)):
        return False
    x, layout = evidence.fit(trial), evidence.layout(trial)
    start = dict(zip(layout.terms, layout.starts, strict=True))[general]
    error = float(np.sqrt(evidence.covariance(trial, x)[start + 1, start + 1]))
    return float(x[start + 1]) + UNCERTAIN * error >= MATTERS * float(x[start])
