"""Friction or an offset that changes over the run (warm-up): tau = r T (1 - exp(-t/T)) g.

t is the time since the run began, T the time constant (refined), r the rate at the beginning; setting ``of`` says what
changes: ``offset`` g = 1, ``coulomb`` g = sign(dq), ``viscous`` g = dq (the rate is then in N m/rad). Friction that
becomes less stays friction: r T, what has gone in the end, is at most what the joint has.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Family, Term, register
from hybrid_dynamics.effects.sign import WIDTH, sign_of
from hybrid_dynamics.effects.state import Equivalence, Parameter, Refined, Settings, State
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

OF, CONSTANT = "of", "time_constant"
OFFSET, COULOMB, VISCOUS = "offset", "coulomb", "viscous"
#: Time constant [s] the search starts from: between a short run and a warm-up of minutes.
_START = 30.0


@register
class Drift(Family):
    name = "drift"
    scope = "joint"
    follows_time = True
    known_settings = (OF, WIDTH)
    equation = r"\tau = r\,T\,(1 - e^{-t/T})\,g,\quad g \in \{1,\ \operatorname{sign}(\dot q),\ \dot q\}"
    parameters = (Parameter("rate", "N m/s"), Parameter(CONSTANT, "s"))
    size = 1
    searched = False
    several = True
    # What changes explains more than what is there from the beginning does.
    beside = ("torque_offset", "viscous_friction", "coulomb_friction")
    nonlinear_settings = (Refined(CONSTANT, 2.0, 3000.0),)
    drawn_against = "time"
    shown_by = "the same motion is repeated from the cold start to the warm joint"
    equivalent_to = (
        Equivalence(
            ("torque_offset",),
            "over a short run a drift is a constant",
            "repeat the same motion early and late in one run",
        ),
    )

    def grid(self, options: Mapping[str, Any]) -> list[Settings]:
        # Noise that wanders slowly looks like an offset that drifts: that is asked for by name only.
        named = self.name in options.get("effects", ())
        return [((OF, of), (CONSTANT, _START)) for of in (OFFSET, COULOMB, VISCOUS) if named or of != OFFSET]

    def place(self, term: Term) -> tuple[Any, ...]:
        return (term.effect, term.joint, term.options[OF])

    def opposes_motion(self, term: Term) -> bool:
        return bool(term.options[OF] != OFFSET)

    def unit(self, key: str, settings: Mapping[str, Any]) -> str:
        return "s" if key == CONSTANT else "N m/rad" if settings.get(OF) == VISCOUS else "N m/s"

    def law(self, xp: Any, at: State, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        if at.time is None:
            raise InputError(f"effect {self.name} changes over the run, and no time stamps are given; give time")
        constant = parameters[CONSTANT]
        grown = parameters["rate"] * constant * (1.0 - xp.exp(-at.time / constant))
        what = settings.get(OF)
        if what == OFFSET:
            return grown
        if what == VISCOUS:
            return grown * at.own_dq
        if what == COULOMB:
            return grown * sign_of(xp, at.own_dq, settings, at.z)
        raise InputError(f"effect {self.name}: setting {OF} is {what!r}; expected {OFFSET}, {COULOMB} or {VISCOUS}")

    def draw(self, robot: Robot, term: Term, rng: np.random.Generator) -> Array:
        return np.array([1.0 if term.options[OF] != OFFSET else rng.choice([-1.0, 1.0])])

    def draw_term(self, robot: Robot, moving: NDArray[np.bool_], rng: np.random.Generator) -> Term:
        term = super().draw_term(robot, moving, rng)
        return term.refined(**{CONSTANT: float(np.exp(rng.uniform(np.log(5.0), np.log(60.0))))})
