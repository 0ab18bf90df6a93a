"""A law is kept whose coefficient is twice as sure as a gain must be, where slow noise leaves its gain few blocks; and
one without which its joint is left with more than twice as much, whose coefficient is as sure as a gain must be."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop import LoopSettings, Model, prune
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.trace import Gain, Judge

ROBOT = arm()
ELBOW = ROBOT.joint_names[1]
SPRING = Term("joint_spring", 1, (("shape", "linear"),))
BLOCKS, LOOKED = 14, 100


@pytest.mark.parametrize(
    ("size", "gain", "more", "stays"),
    [
        (20.0, 4.5, 0.9, True),
        (8.0, 4.5, 0.9, False),
        (20.0, 1.5, 0.9, False),
        (8.0, 6.0, 0.9, True),
        (8.0, 2.5, 1.1, True),
        (4.0, 2.5, 1.1, False),
        (8.0, 1.5, 1.1, False),
    ],
    ids=[
        "sure coefficient",
        "neither",
        "no gain to speak of",
        "sure gain",
        "wrong without it",
        "wrong without it, of no sure size",
        "wrong without it, which may be chance",
    ],
)
def test_a_coefficient_or_its_gain_must_be_sure(
    size: float, gain: float, more: float, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``gain`` in its standard errors, ``size`` of the coefficient in its own; ``more`` is left without, in times of
    what is left, or of the squared floor."""
    settings = LoopSettings()
    spring = Effect("joint_spring", (ELBOW,), {"stiffness": 4.0, "rest_position": 0.1}, {"shape": "linear"})
    logs = read_motion(ROBOT, [noisy_log([spring], k, "train", 0.1) for k in (1, 2)], [], settings)
    judge, _, _ = gather(Model(ROBOT), logs, settings)
    judge = judge.adding([SPRING]).at([SPRING])
    # Between what a gain of 4.5 and one of 6 standard errors is, with so few blocks.
    assert 4.5 < judge.level(LOOKED, BLOCKS) < 6.0
    worth = Judge.worth

    def measured(self: Judge, *args: Any, **kwargs: Any) -> Gain:
        own = worth(self, *args, **kwargs)
        left = np.maximum(self.mean_square(self.evidence.held([SPRING], physical=True)), self.floor**2)
        return replace(own, error=own.total / gain, blocks=BLOCKS, per_joint=more * left)

    monkeypatch.setattr(Judge, "worth", measured)
    monkeypatch.setattr(prune, "in_errors", lambda judge, current, x: dict.fromkeys(current, size))
    kept = prune.keep_sure(judge, [SPRING], LOOKED, lambda step: None)[1]
    assert kept == ([SPRING] if stays else [])
