"""A guess beside the names by which a joint of the test runs ends worse than it began is taken back, and told."""

from __future__ import annotations

import numpy as np
import pytest
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.effects.base import HELD
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.confirm import Confirmation, confirm
from hybrid_dynamics.loop.diagnosis import errors_of
from hybrid_dynamics.loop.found import Found
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.simulation.excitation import excitations

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
FRICTION = Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 0.8})


def offset(value: float, joint: str = ELBOW) -> Effect:
    return Effect("torque_offset", (joint,), {"offset": value})


def asked(in_training: list[Effect], in_test: list[Effect]) -> tuple[Found, Confirmation, list[Run]]:
    """Friction of the shoulder is named, offsets of both joints are guessed beside it; the test runs are asked."""
    settings = LoopSettings()
    train, _ = excitations(ROBOT, in_training, train=1, test=0, duration=8.0, rate=250.0)
    _, test = excitations(ROBOT, in_test, train=0, test=1, duration=8.0, rate=250.0)
    logs = read_motion(ROBOT, train, test, settings)
    judge, candidates, _ = gather(Model(ROBOT), logs, settings)
    named = [next(t for t in candidates if t.effect == "coulomb_friction" and t.joint == 0)]
    guesses = [Term("torque_offset", j, ((HELD, 5.0),)) for j in range(2)]
    judge = judge.adding(guesses).at([*named, *guesses])
    fitted = refit(judge.evidence, [*named, *guesses])
    found = Found(named, fitted.x[:1], [], [], [], judge.over(fitted.evidence), Model(ROBOT), guesses)
    return found, confirm(judge, Model(ROBOT), found.model(named), found, logs.test, candidates), logs.test


@pytest.mark.parametrize(("later", "gone"), [(1.0, []), (0.6, []), (0.0, [ELBOW]), (-1.0, [ELBOW])])
def test_a_guess_that_the_test_runs_contradict_goes_and_the_other_stays(later: float, gone: list[str]) -> None:
    """Of .6 N m an offset of 1 N m is still the better guess, of nothing it is not."""
    found, said, tests = asked(
        [FRICTION, offset(1.0), offset(2.0, SHOULDER)], [FRICTION, offset(later), offset(2.0, SHOULDER)]
    )
    assert [ROBOT.joint_names[g.index] for g in said.guesses] == gone
    assert said.refused == ()
    kept = {e.joints[0]: e.parameters["offset"] for e in said.model.effects if e.effect == "torque_offset"}
    assert set(kept) == {SHOULDER, ELBOW} - set(gone)
    assert kept[SHOULDER] == pytest.approx(2.0, abs=0.1)
    before, after = (np.array(errors_of(m, tests)["rmse"]) for m in (Model(ROBOT), said.model))
    assert after[1] <= 1.02 * before[1]
    if gone:
        # Control: as it was found, the elbow ends worse than it began.
        assert errors_of(found.model(found.terms), tests)["rmse"][1] > 1.5 * before[1]
