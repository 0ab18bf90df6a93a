"""How far the ends of a run are felt."""

from __future__ import annotations

import math

import numpy as np

from hybrid_dynamics.types import Array

#: Length of a low-pass's transient in periods of its cut-off frequency: what is padded before, and trimmed after.
TRANSIENT_PERIODS = 2.0


def transient_samples(cutoff_hz: float, dt: float) -> int:
    """Samples at each end in which a low-pass with that cut-off still feels the edge."""
    return math.ceil(TRANSIENT_PERIODS / (cutoff_hz * dt))


def chord(x: Array) -> Array:
    """The straight line (T,) or (T, n) from the first sample of ``x`` to the last: taken off before a recursive filter
    and put back after it, so that steady motion has no transient at all."""
    share = np.linspace(0, 1, len(x)).reshape(-1, *[1] * (x.ndim - 1))
    return np.asarray(x[0] + share * (x[-1] - x[0]))
