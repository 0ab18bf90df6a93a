"""Effects entering dynamics: the inverse of finding them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Effect, StateTorque, family
from hybrid_dynamics.robots import Robot

Array = NDArray[np.float64]


def plant(robot: Robot, effects: Iterable[Effect], along: bool = False) -> tuple[Robot, StateTorque]:
    """The robot with ``effects``: a changed copy, and the torque its drives must add.

    The second is a function of joint states ``(q, dq)``, both (T, n), giving (T, n) [N m]: under drive torque tau the
    changed robot accelerates as if it were given ``tau - torque(q, dq)``. Effects that depend on the load need a third
    argument, the rigid-body torque (T, n) of the changed robot. With ``along`` its rows must be one run in the order of
    time (friction may depend on the past); without, they are states in any order.
    """
    changed = robot.copy()
    added: list[tuple[int, Effect]] = []
    for effect in effects:
        kind = family(effect.effect)
        kind.change(changed, effect)
        joint = effect.joint_index(robot)
        if joint is not None and kind.torque(effect, np.zeros(1), np.zeros(1), np.zeros(1)) is not None:
            added.append((joint, effect))

    def torque(q: Array, dq: Array, load: Array | None = None) -> Array:
        out = np.zeros_like(dq)
        for joint, effect in added:
            own = None if load is None else load[:, joint]
            kind = family(effect.effect)
            law = kind.torque_along if along else kind.torque
            part = law(effect, q[:, joint], dq[:, joint], own)
            assert part is not None
            out[:, joint] += part
        return out

    return changed, torque
