"""What a joint says while it stands: its friction holds as much as it does in motion, about, and no more.

The torque at standstill follows from what came before, so no law is proved by it. But a model that asks for more of a
joint that stands than friction ever held of it is wrong: a law of its partner's speed that a few rows of common motion
made large, an offset, or links that only ever moved one at a time. So these rows count in every fit as a weak prior:
each stretch once (what friction holds stays the same in it), as known to within what the starting model leaves of the
joint in motion. Where rows in motion say anything, that changes nothing; where they say nothing, a model stays as near
to what was measured as friction lets it, and no nearer: that is in the standard errors, and what motion leaves open is
told as that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects, label

from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.types import Array

Mask = NDArray[np.bool_]
#: A joint rests where it stays slow for so long [s]; so much at both ends is braking and starting.
RESTS, ENDS = 0.4, 0.1
#: A low-pass has forgotten what was there so many of its time constants before.
FORGETS = 4.0
#: Of the stretches at rest as many count as this share of the rows in motion, and these at least.
SHARE, LEAST = 0.01, 10.0
#: A stretch that lies this many times as far off as the joint does in motion is a brake, a hand or a stop.
FAR = 3.0


@dataclass(frozen=True)
class Resting:
    """``rows`` (K, n) per run in which each joint stands; ``size`` (n,) [N m] of what friction may hold there;
    ``samples`` (n,) how many independent ones the rows are worth."""

    rows: tuple[Mask, ...]
    size: Array
    samples: Array

    def weights(self, floor: Array) -> Array:
        """(n,) [N m]^-2 by which each of the rows counts, beside rows in motion that count by 1 / ``floor``^2."""
        count = np.maximum(np.sum([own.sum(axis=0) for own in self.rows], axis=0), 1)
        size = np.maximum(self.size, floor)
        return np.asarray(np.where(floor > 0, self.samples / count / np.maximum(size, 1e-150) ** 2, 0.0))


def resting_rows(base: Model, runs: Sequence[Run], left: Sequence[Array], settings: LoopSettings) -> Resting:
    """Of ``runs``, of which the starting model ``base`` leaves ``left`` (K, n) [N m] each."""
    speed, n = settings.process.slow_speed, left[0].shape[1]
    moving = np.sum([run.mask.sum(axis=0) for run in runs], axis=0)
    square = np.sum([np.sum(own**2 * run.mask, axis=0) for run, own in zip(runs, left, strict=True)], axis=0)
    square = square / np.maximum(moving, 1)
    if base.effects:
        square += _held_by(base, runs, speed) ** 2
    rows, stretches = [], np.zeros(n)
    for run, own in zip(runs, left, strict=True):
        slow, kept = standing_rows(base.in_run(run.name), run, speed), np.zeros(own.shape, bool)
        for j in np.flatnonzero(moving > 0):
            for part in rests(run.time, slow[:, j]):
                if part.stop > part.start and np.mean(own[part, j] ** 2) <= FAR**2 * square[j]:
                    kept[part, j] = True
                    stretches[j] += 1
        rows.append(kept)
    return Resting(tuple(rows), np.sqrt(square), np.minimum(stretches, np.maximum(SHARE * moving, LEAST)))


def _held_by(base: Model, runs: Sequence[Run], speed: float) -> Array:
    """(n,) [N m] largest that the friction which ``base`` has holds of each joint."""
    n = base.robot.n_joints
    out = np.zeros(n)
    for run in runs:
        m = run.motion
        some = slice(None, None, max(len(m.time) // 100, 1))
        half = base.in_run(run.name).turning(
            m.q[some], 0.0 * m.dq[some], 0.0 * m.ddq[some], speed, range(n), m.time[some], m.began
        )[1]
        out = np.maximum(out, half.max(axis=0))
    return out


def standing_rows(model: Model, run: Run, speed: float) -> Mask:
    """(K, n) where each joint has been slower than ``speed`` over the filter's window, and for as long as the torque of
    the motion before is still recorded, by the ``model`` of this run, and its torque is not cut off."""
    slow = run.smooth((np.abs(run.motion.dq) < speed).astype(float)) > 1.0 - 1e-9
    read = model.readings
    rows = np.arange(len(slow))[:, None]
    last = np.maximum.accumulate(np.where(slow, -len(slow), rows), axis=0)
    since = (rows - last) * float(run.time[1] - run.time[0])
    return np.asarray(slow & ~run.cut_off & (since > read.delay + FORGETS * read.lag))


def rests(time: Array, slow: NDArray[np.bool_]) -> list[slice]:
    """Rows within each stretch of ``slow`` (K,) that lasts :data:`RESTS`, without its :data:`ENDS`."""
    out = []
    for (stretch,) in find_objects(label(slow)[0]):
        first, last = time[stretch][[0, -1]]
        if last - first >= RESTS:
            low, high = np.searchsorted(time, (first + ENDS, last - ENDS))
            out.append(slice(int(low), int(high)))
    return out
