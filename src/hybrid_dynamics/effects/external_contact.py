"""Something pushes against the arm during part of a run: a constant torque of one joint within time intervals.

Setting ``intervals``: pairs (start, end) [s since the run began]. What happened in one run says nothing about another:
the loop gives such an effect the run it belongs to (``only_run``), unless every run shows it at the same time.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import INTERVALS, ONLY_RUN, Family, Term, register
from hybrid_dynamics.effects.state import Equivalence, Parameter, State
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot


@register
class ExternalContact(Family):
    name = "external_contact"
    scope = "joint"
    known_settings = (INTERVALS,)
    equation = r"\tau = \tau_c \text{ within the intervals, else } 0"
    parameters = (Parameter("torque", "N m"),)
    searched = False
    momentary = True
    several = True
    drawn_against = "time"
    shown_by = "the same motion is repeated without contact"
    equivalent_to = (
        Equivalence(
            ("torque_offset",), "a push that lasts the whole run is an offset", "repeat the run without contact"
        ),
    )

    def terms(self, robot: Robot, moving: NDArray[np.bool_], options: Mapping[str, Any]) -> list[Term]:
        return []  # the loop finds intervals by what stands out in time

    def at(self, joint: int, intervals: tuple[tuple[float, ...], ...], run: str | None = None) -> Term:
        """The term of a push on ``joint`` during ``intervals`` of ``run``."""
        own = {} if run is None else {ONLY_RUN: run}
        return Term(self.name, joint, tuple(sorted({INTERVALS: intervals, **own}.items())))

    def place(self, term: Term) -> tuple[Any, ...]:
        return (term.effect, term.joint, term.options[INTERVALS], term.options.get(ONLY_RUN))

    def in_descriptions(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> dict[str, float]:
        return {"one_run": 1.0}

    def law(self, xp: Any, at: State, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        if at.time is None:
            raise InputError(f"effect {self.name} acts in parts of a run, and no time stamps are given; give time")
        inside: Any = 0.0
        for start, end in settings[INTERVALS]:
            inside = inside + xp.where(at.time >= start, 1.0, 0.0) * xp.where(at.time <= end, 1.0, 0.0)
        return parameters["torque"] * inside

    def draw_term(self, robot: Robot, moving: NDArray[np.bool_], rng: np.random.Generator) -> Term:
        start = float(rng.uniform(2.0, 4.0))
        return self.at(int(rng.choice(np.flatnonzero(moving))), ((start, start + float(rng.uniform(1.0, 3.0))),))
