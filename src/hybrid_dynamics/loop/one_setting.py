"""One nonlinear setting of a law, at the value that predicts best: a search in a closed range."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import minimize_scalar

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.evidence import Evidence

#: Trials of one search.
TRIALS = 14
#: A value this near to the end of its range, as a share of the range, stands at that end.
AT_END = 0.02


def best_setting(
    evidence: Evidence, low: float, high: float, log: bool, model: Callable[[float], Sequence[Term]]
) -> tuple[float, float]:
    """The value between ``low`` and ``high`` with which ``model`` predicts the parts left out best, and that score.

    ``log``: the value is searched by its logarithm.
    """

    def loss(u: float) -> float:
        trial = model(float(np.exp(u)) if log else float(u))
        return evidence.adding(trial).held(trial).score

    ends = (np.log(low), np.log(high)) if log else (low, high)
    found = minimize_scalar(loss, bounds=ends, method="bounded", options={"maxiter": TRIALS})
    return float(np.exp(found.x)) if log else float(found.x), float(found.fun)


def stands_at_end(value: float, low: float, high: float, log: bool) -> bool:
    """True where ``value`` is that of an end of its range rather than one between."""
    if log:
        value, low, high = np.log(value), np.log(low), np.log(high)
    return not AT_END < (value - low) / (high - low) < 1 - AT_END
