"""Joints of which the delivered model leaves more of the test runs than the starting model did.

Names, links and tilts that the arm needs as a whole may cost one joint: where joints turn one way only, the training
runs do not say which of several splits is true, and the test runs move otherwise. No single name is to blame then (what
is, :mod:`.confirm` withdraws), and the user of that joint has to be told.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.units import unit_at
from hybrid_dynamics.loop.confirm import WORSE, ends_worse
from hybrid_dynamics.loop.diagnosis import moving_rms, rms_in_motion
from hybrid_dynamics.loop.everything import WORTH
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.types import Array

#: How the note begins.
SPOILED = "worse than the starting model on the test runs"


@dataclass(frozen=True)
class Spoiled:
    """Per joint (n,): what the model and the ``start`` leave of the test runs in motion, rms [N m], and ``seen``, where
    the model leaves noticeably more."""

    model: Array
    start: Array
    seen: NDArray[np.bool_]

    @property
    def share(self) -> Array:
        """(n,) share of what the model leaves (mean square) that the starting model would not; 0 where not seen."""
        return np.where(self.seen, 1.0 - (self.start / np.maximum(self.model, 1e-300)) ** 2, 0.0)

    def notes(self, joints: Sequence[str], slides: Collection[str] = ()) -> list[str]:
        """What is said of it, if anything; ``slides`` are the prismatic joints."""
        names = [
            f"{joints[j]} ({self.model[j]:.3g} instead of {self.start[j]:.3g} {unit_at('N m', joints[j], slides)})"
            for j in map(int, np.flatnonzero(self.seen))
        ]
        if not names:
            return []
        return [
            f"{SPOILED} (rms): {', '.join(names)}; the training runs do not show how these joints' torque parts into "
            "causes: learn from runs in which they turn both ways through the poses of the test runs, or keep the "
            "starting model there"
        ]


def spoiled(judge: Judge, base: Model, model: Model, tests: Sequence[Run]) -> Spoiled:
    """Ask every joint whether it ends worse under ``model`` than under ``base``, the starting model, on ``tests``
    (:func:`~.confirm.ends_worse`: beyond the standard error of a second or two, which is all that a test may be).

    And by :data:`~.confirm.WORSE` of what ``base`` leaves, of the floor or of :data:`~.everything.WORTH` of the torque,
    whichever is most: below these nobody would notice.
    """
    after, before = moving_rms(model, tests), moving_rms(base, tests)
    torque = rms_in_motion([run.tau for run in tests], tests)
    least = np.max([before, judge.floor, WORTH * torque], axis=0) ** 2
    seen = ends_worse(judge, base, model, tests) & (after**2 - before**2 > WORSE * least)
    return Spoiled(after, before, seen)
