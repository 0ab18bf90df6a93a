"""How far the ends of a run are felt."""

from __future__ import annotations

import math

#: Length of a low-pass's transient in periods of its cut-off frequency: what is padded before, and trimmed after.
TRANSIENT_PERIODS = 2.0


def transient_samples(cutoff_hz: float, dt: float) -> int:
    """Samples at each end in which a low-pass with that cut-off still feels the edge."""
    return math.ceil(TRANSIENT_PERIODS / (cutoff_hz * dt))
