"""What is left where a joint stands: friction holds a part of it, and no more.

The torque of a joint that stands follows from what came before, so these samples take no part in the search and prove
no law. But friction holds no more than its own torque: what stands farther off than that is a hand, a stop, a brake or
a load that the model does not know, and an all-clear beside it would be none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.loop.diagnosis import moving_rms
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.types import Array

#: Friction holds up to so many times what it brakes with at slow speed: the torque at which a joint breaks away.
BREAKS_AWAY = 2.0
#: Noise reaches so many times its rms, and now and then farther.
NOISE = 4.0
#: It is told where it lasts so long [s], and for such a share of the time at which the joint stands.
LASTS, SHARE = 0.5, 0.05


@dataclass(frozen=True)
class Standing:
    """Per joint (n,), where it stands and more is left than friction holds: for how many ``seconds``, by how much
    (``rms`` [N m]), beside the friction that ``held`` [N m] on the average; the ``share`` of these samples in the
    squares of all that is left; ``longest``: the run that has most of it, and between which stamps [s] of it. All 0 or
    empty where nothing of that is seen."""

    seconds: Array
    rms: Array
    held: Array
    share: Array
    longest: tuple[str, ...]

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(n,) joints where it is."""
        return np.asarray(self.seconds > 0)

    def notes(self, joints: Sequence[str]) -> list[str]:
        """A line a joint."""
        return [
            f"{joints[j]}: while it stands {self.rms[j]:.3g} (rms, for {self.seconds[j]:.3g} s, {self.longest[j]}) are "
            f"left, of which friction as it was found holds {self.held[j]:.3g}: a hand, a stop, a brake, a load or "
            "friction that the model does not know; leave those moments out, or look what they have in common"
            for j in map(int, np.flatnonzero(self.seen))
        ]


def beyond_friction(model: Model, runs: Sequence[Run], floor: Array, settings: LoopSettings) -> Standing:
    """What ``model`` leaves at standstill of ``runs`` that its own friction does not hold.

    ``floor`` (n,) [N m]: noise of the torque, at most; 0 where a joint never moves, of which nothing is said.
    """
    # What the model is off by in motion it may be off by at rest: that has been told already.
    moving = moving_rms(model, runs)
    noise, speed = np.maximum(floor, moving), settings.process.slow_speed
    stood, square, held, moved = np.zeros((4, len(floor)))
    seconds = np.zeros((len(runs), len(floor)))
    where = [[""] * len(floor) for _ in runs]
    for r, run in enumerate(runs):
        m, dt = run.motion, float(run.time[1] - run.time[0])
        middle, half = model.in_run(run.name).turning(m.q, m.dq, m.ddq, speed, m.time, m.began)
        left, holds = run.tau - run.smooth(middle), run.smooth(half)
        slow = run.smooth((np.abs(m.dq) < speed).astype(float)) > 1.0 - 1e-9
        far = slow & (np.abs(left) > BREAKS_AWAY * holds + NOISE * noise)
        seconds[r] = dt * far.sum(axis=0)
        stood += dt * slow.sum(axis=0)
        square += dt * np.sum(left**2 * far, axis=0)
        held += dt * np.sum(holds * far, axis=0)
        moved += dt * run.mask.sum(axis=0)
        for j in np.flatnonzero(far.any(axis=0)):
            at = run.time[far[:, j]]
            where[r][j] = f"most in run {run.name} between {at[0]:.2f} and {at[-1]:.2f} s"
    total = seconds.sum(axis=0)
    seen = (floor > 0) & (total >= np.maximum(LASTS, SHARE * stood))
    time = np.where(seen, total, np.inf)
    whole = np.maximum(square + moved * moving**2, 1e-300)
    return Standing(
        np.where(seen, total, 0.0),
        np.sqrt(square / time),
        held / time,
        np.where(seen, square / whole, 0.0),
        tuple(where[int(r)][j] if seen[j] else "" for j, r in enumerate(seconds.argmax(axis=0))),
    )
