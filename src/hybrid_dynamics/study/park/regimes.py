"""Where in its motion a joint is: fits leave out standing rows, the user does not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from hybrid_dynamics.loop.process import Run

REGIMES = ("standing", "reversal", "slow", "fast")


def regime_of(run: Run, standing: float, turn: float, slow: float) -> NDArray[np.int_]:
    """Index into ``REGIMES`` of every row and joint (K, n).

    ``standing``: slower than this [rad/s]. ``reversal``: within ``turn`` [s] of a change of direction. ``slow``: below
    this share of the joint's highest speed in the run. The first that holds counts.
    """
    step = float(np.median(np.diff(run.time)))
    sign = np.sign(run.dq)
    change = np.zeros(run.dq.shape, int)
    change[1:] = sign[1:] != sign[:-1]
    near = maximum_filter1d(change, 2 * round(turn / step) + 1, axis=0).astype(bool)
    speed = np.abs(run.dq)
    out = np.full(run.dq.shape, REGIMES.index("fast"))
    out[speed < slow * speed.max(axis=0, keepdims=True)] = REGIMES.index("slow")
    out[near] = REGIMES.index("reversal")
    out[speed < standing] = REGIMES.index("standing")
    return out
