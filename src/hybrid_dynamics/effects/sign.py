"""How the sign of dry friction turns over: at once, over a speed, or over a presliding displacement.

Measured joints do not reverse their friction at once. Two settings describe how, one at a time:

- ``sign_width`` w [rad/s]: tanh(dq / w), a function of the state (a joint at rest has no friction torque);
- ``sign_displacement`` s [rad]: presliding, dz/dq = (1 - z sign(dq)) / s (Dahl 1968, scaled to |z| <= 1): the sign
  follows the distance since the last reversal, so a joint at rest keeps the friction torque of its last motion.

Neither setting: sign(dq).
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from hybrid_dynamics.effects.state import Settings
from hybrid_dynamics.types import Array

WIDTH, SIGN_DISPLACEMENT = "sign_width", "sign_displacement"
#: What a friction that is rougher one way says of a joint at rest, where that is not nothing: between both torques.
AT_REST, MIDDLE = "at_rest", "middle"
#: Width [rad/s] beyond which the sign turns over slowly; grids of widths end here.
SLOW = 0.08


def width_settings(widths: tuple[float, ...]) -> list[Settings]:
    """One settings tuple per width [rad/s]; the sharp sign carries no setting."""
    return [((WIDTH, float(w)),) if w > 0 else () for w in widths]


def sign_part(settings: Settings) -> Settings:
    """Of ``settings`` those that say how the sign turns over."""
    return tuple(s for s in settings if s[0] in (WIDTH, SIGN_DISPLACEMENT))


def with_sign(settings: Settings, way: Settings) -> Settings:
    """``settings`` with the sign turning over in another ``way``."""
    return tuple(sorted((*(s for s in settings if s[0] not in (WIDTH, SIGN_DISPLACEMENT)), *way)))


def displacement_settings(displacements: tuple[float, ...]) -> list[Settings]:
    """One settings tuple per displacement [rad]."""
    return [((SIGN_DISPLACEMENT, float(s)),) for s in displacements]


def sign_of(xp: Any, dq: Any, settings: Mapping[str, Any], z: Any = None) -> Any:
    """The sign of ``dq`` over the array namespace ``xp``: its memory ``z`` where it turns over a displacement.

    Without its past (``z`` None) a sign that turns over a presliding displacement is sharp.
    """
    if SIGN_DISPLACEMENT in settings and z is not None:
        return z
    width = float(settings.get(WIDTH, 0.0))
    return xp.tanh(dq / width) if width > 0 else xp.sign(dq)


def displacement_of(settings: Mapping[str, Any]) -> float | None:
    """The displacement [rad] over which the sign turns over, or None."""
    return float(settings[SIGN_DISPLACEMENT]) if SIGN_DISPLACEMENT in settings else None


def presliding_sign(q: Array, displacement: float, level: Array | None = None, start: float = 0.0) -> Array:
    """z (T,) along positions ``q`` (T,) [rad] of one run; ``start`` at its first row, whose past nobody knows.

    Between two reversals Dahl's equation has a closed form in the distance; only reversals are walked through.
    ``level`` (T,): what z comes to at the speed of each row, else 1 (:func:`_relaxed`).
    """
    step = np.diff(q)
    if level is not None:
        return _relaxed(step, displacement, 0.5 * (level[1:] + level[:-1]), start)
    way = np.sign(step)
    moved = np.flatnonzero(way)
    if len(moved) == 0:
        return np.full(len(q), start)
    # A row at rest belongs to the motion before it.
    last = np.maximum.accumulate(np.where(way != 0, np.arange(len(way)), moved[0]))
    way = way[last]
    edges = np.concatenate([[0], np.flatnonzero(np.diff(way)) + 1, [len(way)]])
    path = np.concatenate([[0.0], np.cumsum(np.abs(step))])
    out = np.zeros(len(q))
    out[0] = z = start
    for low, high in pairwise(edges):
        left = (z - way[low]) * np.exp(-(path[low + 1 : high + 1] - path[low]) / displacement)
        out[low + 1 : high + 1] = way[low] + left
        z = float(out[high])
    return out


def _relaxed(step: Array, displacement: float, level: Array, start: float) -> Array:
    """z (T,) from ``start`` over ``step`` (T - 1,) [rad] with the ``level`` (T - 1,) of each:
    dz/dq = (1 - z sign(dq) / level) / s.

    Exact for a level that is constant within a step: z becomes a z + b. Such maps are composed by pairs of twice the
    distance each time (Hillis and Steele, CACM 29(12), 1986), until nothing is left of where z began.
    """
    keeps = np.exp(-np.abs(step) / (displacement * level))
    z = np.sign(step) * level * (1.0 - keeps)
    z[:1] += keeps[:1] * start
    reach = 1
    while reach < len(z) and np.any(keeps[reach:]):
        z[reach:] += keeps[reach:] * z[:-reach]
        keeps[reach:] *= keeps[:-reach].copy()
        reach *= 2
    return np.concatenate([[start], z])
