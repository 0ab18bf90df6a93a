"""Settings of the ``differentiate`` stage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from hybrid_dynamics.differentiate.registry import DIFFERENTIATORS
from hybrid_dynamics.errors import require

ZOH = "zoh"


@dataclass(frozen=True)
class DifferentiateSettings:
    """How velocity, acceleration and jerk are had from a run.

    ``method``: ``zoh`` (simulated data, consistent with a zero-order-held torque) or the name of a differentiator.
    ``cutoff_hz``: cut-off of the zero-phase low-pass that torque passes (and, with ``butterworth``, every signal);
    0 = chosen from the spectrum of the motion.
    ``order``: order of that low-pass. ``trim_s``: seconds dropped at each end; -1 = the filter's transient.
    ``options``: options of the differentiator that override its choice from the data.
    """

    method: str = "butterworth"
    cutoff_hz: float = 0.0
    order: int = 4
    trim_s: float = -1.0
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = (ZOH, *DIFFERENTIATORS)
        require(self.method in known, f"differentiate.method is {self.method!r}; expected one of {', '.join(known)}")
        require(
            0 <= self.cutoff_hz < float("inf"),
            f"differentiate.cutoff_hz is {self.cutoff_hz}; expected 0 (chosen from the data) or a frequency in Hz",
        )
        require(1 <= self.order <= 8, f"differentiate.order is {self.order}; expected 1 to 8")
        require(
            self.trim_s == -1 or 0 <= self.trim_s < float("inf"),
            f"differentiate.trim_s is {self.trim_s}; expected -1 (the filter's transient) or seconds, at least 0",
        )
