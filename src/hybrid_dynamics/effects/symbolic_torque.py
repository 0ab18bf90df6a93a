"""A law without a name, found by symbolic regression and proven on held-out runs: tau = scale * expression.

Setting ``expression``: text in the grammar of :mod:`hybrid_dynamics.effects.expression`, states numbered in the robot's
joint order. The one coordinate scales it, so that it is re-fitted with everything else.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Family, Term, register
from hybrid_dynamics.effects.expression import compile_law
from hybrid_dynamics.effects.state import Parameter, State
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot

EXPRESSION = "expression"


@register
class SymbolicTorque(Family):
    name = "symbolic_torque"
    scope = "joint"
    known_settings = (EXPRESSION,)
    equation = r"\tau = a\,f(q, \dot q, \ddot q)"
    parameters = (Parameter("scale", "1"),)
    searched = False
    asked_only = True
    hidden = False
    several = True
    drawn_against = "dq"
    shown_by = "the joint and those its law names move independently of each other"

    def terms(self, robot: Robot, moving: NDArray[np.bool_], options: Mapping[str, Any]) -> list[Term]:
        return []  # its laws come from symbolic regression

    def at(self, joint: int, expression: str) -> Term:
        """The term of ``expression`` on ``joint``; :class:`InputError` where the grammar refuses it."""
        compile_law(expression)
        return Term(self.name, joint, ((EXPRESSION, expression),))

    def place(self, term: Term) -> tuple[Any, ...]:
        return (term.effect, term.joint, term.options[EXPRESSION])

    def published(self, settings: Mapping[str, Any]) -> tuple[str, ...]:
        text = settings.get(EXPRESSION)
        if not isinstance(text, str):
            raise InputError(f"effect {self.name}: setting {EXPRESSION} is {text!r}; expected a law as text")
        compile_law(text)
        return super().published(settings)

    def law(self, xp: Any, at: State, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        return parameters["scale"] * compile_law(settings[EXPRESSION])(xp, at)

    def draw_term(self, robot: Robot, moving: NDArray[np.bool_], rng: np.random.Generator) -> Term:
        j, k = rng.choice(np.flatnonzero(moving), 2, replace=False) + 1
        return self.at(int(j) - 1, f"sin(q{k}) * dq{j}")
