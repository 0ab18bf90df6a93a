"""An effect that a model holds more than once at one place, as one: what it was before, and what changed since."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hybrid_dynamics.effects.base import Effect
from hybrid_dynamics.robots import Robot


def added_up(effects: Sequence[Effect], robot: Robot) -> Effect:
    """``effects`` of one kind at one joint as one; standard errors are the latest: then the sum was measured."""
    last = effects[-1]
    term = last.term(robot)
    kind = term.family()
    x = kind.summed(np.array([kind.coordinates_of(e.parameters, robot, term) for e in effects]))
    return replace(last, parameters=kind.parameters_of(x, robot, term))


def together(effects: Sequence[Effect], robot: Robot) -> list[Effect]:
    """``effects`` in order, those of one kind at one joint as one; bodies and the whole robot's effects as they are."""
    places: dict[object, list[Effect]] = {}
    for effect in effects:
        term = effect.term(robot)
        # One key for all that add up, a key of its own for what does not.
        key = term.as_finding if term.family().scope == "joint" else id(effect)
        places.setdefault(key, []).append(effect)
    return [own[0] if len(own) == 1 else added_up(own, robot) for own in places.values()]
