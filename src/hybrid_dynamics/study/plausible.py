"""Whether hidden effects have values that a real arm could have: what nobody would look for is hidden nowhere."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.effects import Effect, with_effects
from hybrid_dynamics.robots import Robot

#: Coordinates are plausible up to so many times their scale: half a radian of wrong zero is none.
LARGEST = 0.4
#: Way [m] by which a centre of mass may be elsewhere: 20 floors would ask a light wrist for more than a metre.
_SHIFT = 0.15
#: And up to so much where a scale does not say it: friction beyond half the load is none of a joint that carries some.
_MOST = {"load_dependent_friction": 0.5}


def plausible(robot: Robot, effects: Sequence[Effect]) -> bool:
    """True where every value is within its bounds and scale, and every link with its effects is a body."""
    for effect in effects:
        term = effect.term(robot)
        kind = term.family()
        x = kind.coordinates_of(effect.parameters, robot, term)
        most = np.minimum(LARGEST * kind.prior_scale(robot, term), _MOST.get(term.effect, np.inf))
        if np.any(x < kind.lower_bounds(robot, term)) or np.any(np.abs(x) > most):
            return False
    changed, _ = with_effects(robot, effects)
    for number in changed.joint_ids:
        body = changed.model.inertias[number]
        if np.linalg.norm(body.lever - robot.model.inertias[number].lever) > _SHIFT:
            return False
        moments = np.linalg.eigvalsh(body.inertia)
        if body.mass <= 0 or moments[0] <= 0 or moments[2] > (1 + 1e-6) * (moments[0] + moments[1]):
            return False
    return True
