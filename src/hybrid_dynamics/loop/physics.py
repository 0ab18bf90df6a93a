"""What physics demands of coordinates: bounds, bodies that can exist, viscous torques that oppose the motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.solve import Constraints
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: Shares of a joint's fastest speed at which its viscous terms together must oppose the motion.
_SPEEDS = np.linspace(0.1, 1.0, 10)


def physical_constraints(
    terms: Sequence[Term], starts: Sequence[int], total: int, base: Mapping[Term, Array], robot: Robot, fastest: Array
) -> Constraints:
    """Constraints on the ``total`` coordinates of ``terms``, those of each beginning at ``starts``.

    ``base`` holds the coordinates of effects that the starting model has already: they may become less, the sum must
    stay physical. ``fastest`` (n,) [rad/s] is the highest speed seen of each joint.
    """
    lower = np.concatenate([s.family().lower_bounds(robot, s) - base.get(s, 0.0) for s in terms] or [np.zeros(0)])
    bodies: list[tuple[int, Array]] = []
    for term, start in zip(terms, starts, strict=True):
        bodies += [(start + first, offset) for first, offset in term.family().inertial_bodies(robot, term)]
    places = [(s, start) for s, start in zip(terms, starts, strict=True) if s.family().viscous_powers]
    own = [(s, x) for s, x in base.items() if s.family().viscous_powers]
    rows, least = [], []
    # Also where only the starting model is curved: less of a viscous term could let the rest drive.
    curved = {s.index for s, _ in [*places, *own] if s.family().viscous_powers != (1,)}
    for j in sorted(curved & {s.index for s, _ in places}):
        for speed in _SPEEDS * fastest[j]:
            row = np.zeros(total)
            for term, start in places:
                if term.joint == j:
                    row[start : start + term.family().size] = _per_speed(term, speed)
            rows.append(row)
            least.append(-sum(float(_per_speed(s, speed) @ x) for s, x in own if s.joint == j))
    return Constraints(lower, tuple(bodies), np.array(rows).reshape(len(least), total), np.array(least))


def _per_speed(term: Term, speed: float) -> Array:
    """Viscous torque at ``speed`` [rad/s], divided by it, of one unit of each coordinate of ``term``."""
    return np.array([speed ** (power - 1) for power in term.family().viscous_powers])
