"""What no effect explains, as the expression that symbolic regression finds for it."""

from __future__ import annotations

from collections.abc import Sequence

from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run


def expression_of(model: Model, runs: Sequence[Run], joint: int) -> str:
    """Expression in q1 dq1 ddq1 ... [N m] for the residual of ``joint`` (0-based)."""
    return "0"
