"""A torque that depends on the joint's own position alone (counterbalance springs, cable packages).

Setting ``shape``: ``linear`` k (q - q0); ``sine`` k sin(q - q0), a spring on a crank, stiffness k >= 0 at the rest
position; ``piecewise``: continuous, one stiffness in each piece between the positions of setting ``knots`` and beyond
the outer ones the outer pieces', zero at the rest position. Every stiffness is positive: a spring pulls back. What
drives a joint away from a position, as gravity does, is a sine of it, and does not grow without end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Family, Term, register
from hybrid_dynamics.effects.state import Equivalence, Motion, Parameter, Settings, State
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

SHAPE, KNOTS = "shape", "knots"
LINEAR, SINE, PIECEWISE = "linear", "sine", "piecewise"
_PIECES = 3
#: A softer spring [N m/rad] is a constant torque.
SOFTEST = 1e-3


@register
class JointSpring(Family):
    name = "joint_spring"
    scope = "joint"
    known_settings = (SHAPE, KNOTS)
    equation = r"\tau = k\,(q - q_0)\quad\text{or}\quad \tau = k \sin(q - q_0)\quad\text{or piecewise linear in } q"
    parameters = (Parameter("stiffness", "N m/rad"), Parameter("rest_position", "rad"))
    says_where = ("rest_position",)
    size = 2
    searched = False
    contains = ("torque_offset",)
    drawn_against = "q"
    shown_by = "the joint moves slowly over its whole range, the joints before it in several postures"
    equivalent_to = (
        Equivalence(
            ("link_com",),
            "the first moment of the first link that gravity loads makes a torque of sine and cosine of its position",
            "accelerate the joint hard, or turn the joints before it",
        ),
        Equivalence(
            ("torque_offset",),
            "far from its rest position a soft spring is a constant torque over a short travel",
            "move the joint over a wide range of positions",
        ),
    )

    def grid(self, options: Mapping[str, Any]) -> list[Settings]:
        return [((SHAPE, LINEAR),), ((SHAPE, SINE),)]

    def propose(
        self, names: Sequence[str], motions: Sequence[Motion], residuals: Sequence[Array], moving: NDArray[np.bool_]
    ) -> list[Term]:
        """Piecewise springs with knots at even shares of the positions seen."""
        q = np.concatenate([m.q for m in motions])
        shares = np.linspace(0, 1, _PIECES + 1)
        knots = {int(j): tuple(np.quantile(q[:, j], shares).round(4).tolist()) for j in np.flatnonzero(moving)}
        return [
            Term(self.name, j, ((KNOTS, own), (SHAPE, PIECEWISE)))
            for j, own in knots.items()
            if own[-1] - own[0] > 0.3 and all(b > a for a, b in pairwise(own))
        ]

    def covers(self, term: Term, special: Term) -> bool:
        # A constant torque is where a spring rests; a sine's mean is nothing.
        return super().covers(term, special) and term.options[SHAPE] != SINE

    def size_of(self, term: Term) -> int:
        return len(term.options[KNOTS]) if term.options.get(SHAPE) == PIECEWISE else 2

    def published(self, settings: Mapping[str, Any]) -> tuple[str, ...]:
        shape = settings.get(SHAPE)
        if shape in (LINEAR, SINE):
            return ("stiffness", "rest_position")
        knots = settings.get(KNOTS, ())
        if shape != PIECEWISE or len(knots) < 2 or any(b <= a for a, b in pairwise(knots)):
            raise InputError(
                f"effect {self.name}: settings are {dict(settings)}; expected shape {LINEAR}, {SINE}, or {PIECEWISE} "
                "with knots, at least two positions in rising order"
            )
        return (*(f"stiffness_{k + 1}" for k in range(len(knots) - 1)), "rest_position")

    def unit(self, key: str, settings: Mapping[str, Any]) -> str:
        return "rad" if key == "rest_position" else "N m/rad"

    def in_descriptions(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> dict[str, float]:
        if settings.get(SHAPE, LINEAR) != LINEAR:
            return super().in_descriptions(parameters, settings)
        stiffness = parameters["stiffness"]
        return {"stiffness": stiffness, "offset": -stiffness * parameters["rest_position"]}

    def law(self, xp: Any, at: State, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        q, rest = at.own_q, parameters["rest_position"]
        if settings[SHAPE] == LINEAR:
            return parameters["stiffness"] * (q - rest)
        if settings[SHAPE] == SINE:
            return parameters["stiffness"] * xp.sin(q - rest)
        knots = settings[KNOTS]
        return sum(
            parameters[f"stiffness_{k + 1}"] * (_part(xp, q, knots, k) - _part(xp, rest, knots, k))
            for k in range(len(knots) - 1)
        )

    def columns(self, motion: Motion, term: Term) -> Array:
        q = motion.q[:, term.index]
        settings = term.options
        if settings[SHAPE] == LINEAR:
            return np.column_stack([q, -np.ones_like(q)])
        if settings[SHAPE] == SINE:
            return np.column_stack([np.sin(q), -np.cos(q)])
        knots = settings[KNOTS]
        return np.column_stack([*(_part(np, q, knots, k) for k in range(len(knots) - 1)), -np.ones_like(q)])

    def parameters_of(self, x: Array, robot: Robot, term: Term) -> dict[str, float]:
        settings = term.options
        if settings[SHAPE] == LINEAR:
            stiffness = float(x[0])
            return {"stiffness": stiffness, "rest_position": float(x[1]) / _not_zero(stiffness)}
        if settings[SHAPE] == SINE:
            return {"stiffness": float(np.hypot(x[0], x[1])), "rest_position": float(np.arctan2(x[1], x[0]))}
        values = {f"stiffness_{k + 1}": float(v) for k, v in enumerate(x[:-1])}
        return values | {"rest_position": _rest(x, settings[KNOTS])}

    def coordinates_of(self, parameters: Mapping[str, float], robot: Robot, term: Term) -> Array:
        settings, rest = term.options, parameters["rest_position"]
        if settings[SHAPE] == LINEAR:
            return np.array([parameters["stiffness"], parameters["stiffness"] * rest])
        if settings[SHAPE] == SINE:
            return parameters["stiffness"] * np.array([np.cos(rest), np.sin(rest)])
        knots = settings[KNOTS]
        own = np.array([parameters[f"stiffness_{k + 1}"] for k in range(len(knots) - 1)])
        return np.append(own, sum(s * _part(np, rest, knots, k) for k, s in enumerate(own)))

    def lower_bounds(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        size = self.size if term is None else term.size
        if term is not None and term.options[SHAPE] == SINE:
            return np.full(size, -np.inf)
        return np.append(np.full(size - 1, SOFTEST), -np.inf)

    def draw(self, robot: Robot, term: Term, rng: np.random.Generator) -> Array:
        rest = float(rng.uniform(-0.5, 0.5))
        if term.options[SHAPE] == SINE:
            return np.array([np.cos(rest), np.sin(rest)])
        return np.append(np.ones(term.size - 1), rest)


def _part(xp: Any, q: Any, knots: Sequence[float], k: int) -> Any:
    """How far ``q`` lies into piece ``k``, from the first inner knot on; the outer pieces have no outer end."""
    last = len(knots) - 2
    low, high = knots[k], knots[k + 1]
    if last == 0:
        return q - low
    if k == 0:
        return xp.minimum(q - high, 0.0)
    if k == last:
        return xp.maximum(q - low, 0.0)
    return xp.minimum(xp.maximum(q - low, 0.0), high - low)


def _rest(x: Array, knots: Sequence[float]) -> float:
    """Position nearest to the middle of the knots where a piecewise spring has no torque; on the outer pieces, which go
    on beyond the knots, else; of one that is nowhere without torque the knot of the least."""
    grid = np.array(knots)
    torque = np.array([sum(s * _part(np, q, knots, k) for k, s in enumerate(x[:-1])) - x[-1] for q in grid])
    found = [
        grid[k] - torque[k] * (grid[k + 1] - grid[k]) / (torque[k + 1] - torque[k])
        for k in range(len(grid) - 1)
        if torque[k] * torque[k + 1] <= 0 and torque[k] != torque[k + 1]
    ]
    if not found:
        low, high = (grid[k] - torque[k] / _not_zero(float(x[i])) for k, i in ((0, 0), (-1, -2)))
        # An outer piece says nothing of the other side of its knot.
        found = [q for q, beyond in ((low, low <= grid[0]), (high, high >= grid[-1])) if beyond]
    return float(min(found, key=lambda q: abs(q - grid.mean()), default=grid[np.argmin(np.abs(torque))]))


def _not_zero(value: float) -> float:
    return value if abs(value) > 1e-12 else 1e-12
