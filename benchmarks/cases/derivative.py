"""Total-variation differentiation against PyNumDiff's, the parameter chosen from the data beforehand for both."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks import differentiate

#: A coarse encoder: there the peer's solver does not stop long before the optimum.
COUNTS = differentiate.COUNTS[1]


def total_variation(side: str, rows: int) -> Callable[[], dict[str, Any]]:
    from hybrid_dynamics.differentiate.total_variation import objective

    alpha = differentiate.chosen_alpha(rows, COUNTS)
    x = differentiate.measured(rows, COUNTS)[:, 0]
    routine = differentiate.ours if side == "ours" else differentiate.pynumdiff_tvrdiff
    routine(differentiate.measured(200)[:, 0], alpha)  # both load their libraries at the first call
    return lambda: {"objective": objective(np.asarray(routine(x, alpha)), x, differentiate.DT, alpha)}
