"""Keys of a ``log.yaml`` that mend one fault, for all joints in the robot's order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


def turned(n: int, joints: Sequence[int], signals: Sequence[str]) -> dict[str, Any]:
    """The sign of ``signals`` at ``joints`` (0-based) is turned."""
    return {"sign": {s: [-1 if j in joints else 1 for j in range(n)] for s in signals}}


def reordered(source: Sequence[int], signals: Sequence[str]) -> dict[str, Any]:
    """Joint j takes column ``source[j]`` (0-based) of each of ``signals``."""
    return {"columns": {s: [f"{s}{k + 1}" for k in source] for s in signals}}


def exchanged(n: int, a: int, b: int) -> list[int]:
    """The identity with ``a`` and ``b`` exchanged."""
    out = list(range(n))
    out[a], out[b] = b, a
    return out
