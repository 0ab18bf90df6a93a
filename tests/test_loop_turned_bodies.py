"""What turns gravity or an arm's zero turns all its bodies, those found by the loop, too: both are fitted at once."""

from __future__ import annotations

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect, Term, family
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop.augment import effects_of, refit
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.types import Array

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
#: Of the torque [N m].
NOISE = 0.05
#: Twice as heavy as the URDF says.
HEAVY = Effect("link_mass", (ELBOW,), {"mass": 4.0})
TURNED = [
    Effect("gravity_tilt", (), {"roll": 0.0, "pitch": -0.15}),
    Effect("position_offset", (SHOULDER,), {"offset": 0.1}),
]


def _judge(*hidden: Effect) -> Judge:
    settings = LoopSettings()
    train = [noisy_log(hidden, seed, "train", NOISE) for seed in (1, 2)]
    logs = read_motion(ROBOT, train, [noisy_log(hidden, 51, "test", NOISE)], settings)
    return gather(Model(ROBOT), logs, settings)[0]


def _fit(judge: Judge, terms: list[Term]) -> tuple[Array, Array, Array]:
    """Parameters, their standard errors, and the rms of what is left [N m] per joint."""
    judge = judge.adding(terms)
    fitted = refit(judge.evidence, terms)
    effects = fitted.model().effects
    values = np.array([v for e in effects for v in e.parameters.values()])
    errors = np.array([s for e in effects for s in e.std_errors.values()])
    left = judge.evidence.problem.left(effects_of(judge.evidence, terms, fitted.x))
    squares = [np.mean(own[m.any(axis=1)] ** 2, axis=0) for own, m in zip(left, judge.evidence.mask, strict=True)]
    return values, errors, np.sqrt(np.mean(squares, axis=0))


@pytest.mark.parametrize("turned", TURNED, ids=lambda e: e.effect)
def test_a_body_and_what_turns_it_are_recovered_together(turned: Effect, monkeypatch: pytest.MonkeyPatch) -> None:
    terms = [turned.term(ROBOT), HEAVY.term(ROBOT)]
    judge = _judge(turned, HEAVY)
    truth = np.array([*turned.parameters.values(), *HEAVY.parameters.values()])
    values, errors, left = _fit(judge, terms)
    assert np.all(np.abs(values - truth) < 4 * np.maximum(errors, 1e-4))
    assert np.all(left < 1.1 * judge.floor)
    # Control: with columns of the bodies as the URDF has them, fitted once, it is far off.
    kind = family(turned.effect)
    monkeypatch.setattr(kind, "uses_body", False)
    monkeypatch.setattr(kind, "nonlinear", False)
    control, _, rest = _fit(_judge(turned, HEAVY), terms)
    assert np.any(np.abs(control - truth) > 4 * np.maximum(errors, 1e-4))
    assert np.any(rest > 1.1 * judge.floor)
