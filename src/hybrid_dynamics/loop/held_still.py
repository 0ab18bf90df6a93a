"""What the test runs say of joints that only stand in them: a model may not ask more of these than friction holds.

Nothing of a joint's own motion is tested where it stands. But gravity, an offset and what a moving neighbour asks of it
act there as well, and were measured: a name that puts newton metres on a joint that the starting model had right at
rest is wrong, whatever it made of the training runs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.floor import FEWEST_ROWS
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.resting import standing_rows
from hybrid_dynamics.loop.standing import BREAKS_AWAY, NOISE, left_at_rest
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.types import Array

#: A model asks too much of a joint where it leaves so many times what the starting model does, and more than noise; and
#: a name is to blame where no more than so much of that is left without it.
MORE, BLAMED = 2.0, 0.5


def only_standing(tests: Sequence[Run], floor: Array, speed: float) -> NDArray[np.int_]:
    """Joints that move in training (``floor`` (n,) > 0) and only stand, slower than ``speed`` [rad/s], in ``tests``."""
    moved = np.sum([run.mask.sum(axis=0) for run in tests], axis=0)
    stood = np.sum([np.sum(np.abs(run.dq) < speed, axis=0) for run in tests], axis=0)
    return np.flatnonzero((floor > 0) & (moved < FEWEST_ROWS) & (stood >= FEWEST_ROWS))


def beyond_at_rest(model: Model, tests: Sequence[Run], joints: Sequence[int], speed: float) -> Array:
    """(k,) [N m] root mean square of what ``model`` leaves of ``joints`` at rest that their friction does not hold."""
    square, count = np.zeros((2, len(joints)))
    for run in tests:
        own = model.in_run(run.name)
        slow = standing_rows(own, run, speed)[:, joints]
        left, holds = left_at_rest(own, run, joints, speed)
        beyond = np.maximum(np.abs(left) - BREAKS_AWAY * holds, 0.0)
        square += np.sum(np.where(slow, beyond, 0.0) ** 2, axis=0)
        count += slow.sum(axis=0)
    return np.asarray(np.sqrt(square / np.maximum(count, 1)))


def asks_too_much(
    base: Model,
    model: Model,
    kept: Sequence[Term],
    without: Callable[[Term], Model],
    tests: Sequence[Run],
    judge: Judge,
) -> Term | None:
    """The name of ``kept`` that makes ``model`` ask far more than ``base`` of a joint that only stands in ``tests``;
    None where there is none. ``without`` a name: the model then."""
    floor, speed = judge.floor, judge.settings.process.slow_speed
    joints = [int(j) for j in only_standing(tests, floor, speed)]
    if not joints or not kept:
        return None
    ours, theirs = (beyond_at_rest(m, tests, joints, speed) for m in (model, base))
    wrong = ours > np.maximum(MORE * theirs, NOISE * floor[joints])
    if not wrong.any():
        return None
    left = [float(np.max(beyond_at_rest(without(s), tests, joints, speed)[wrong] / ours[wrong])) for s in kept]
    best = int(np.argmin(left))
    return kept[best] if left[best] <= BLAMED else None
