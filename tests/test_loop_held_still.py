"""A joint that only stands in the test runs: nobody may ask more of it there than friction holds."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect, predict
from hybrid_dynamics.loop import LoopSettings
from hybrid_dynamics.loop.held_still import asks_too_much, beyond_at_rest, only_standing
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import ProcessSettings, Run, process
from hybrid_dynamics.trajectory import Trajectory

DRY = Effect("coulomb_friction", ("elbow",), {"coulomb_torque": 2.0})
WRONG = Effect("torque_offset", ("elbow",), {"offset": 1.5})
SPEED = LoopSettings().process.slow_speed


def standing_elbow(elbow: float = 0.3) -> Run:
    """The shoulder moves; the elbow stands, held by its friction with half of what that could."""
    time = np.arange(2000) / 200.0
    q = np.column_stack([0.6 * np.sin(1.5 * time), np.full_like(time, elbow)])
    dq = np.gradient(q, time, axis=0)
    tau = predict(arm(), [], q, dq, np.gradient(dq, time, axis=0), time) + np.array([0.0, 1.0])
    tau += 0.01 * np.random.default_rng(0).normal(size=tau.shape)
    return process(Trajectory("test", "test", time, {"q": q, "tau": tau}), arm(), ProcessSettings())


def judge(floor: float = 0.01) -> Any:
    return SimpleNamespace(floor=np.full(2, floor), settings=LoopSettings())


def asked(base: list[Effect], named: list[Effect], floor: float = 0.01) -> str | None:
    """The effect that is to blame."""
    terms = {effect.term(arm()): effect for effect in named}

    def without(term: Any) -> Model:
        return Model(arm(), (*base, *(e for t, e in terms.items() if t != term)))

    model = Model(arm(), (*base, *named))
    blamed = asks_too_much(Model(arm(), tuple(base)), model, list(terms), without, [standing_elbow()], judge(floor))
    return None if blamed is None else blamed.effect


def test_joints_that_only_stand_are_those_that_moved_in_training() -> None:
    run = standing_elbow()
    assert only_standing([run], np.array([0.1, 0.1]), SPEED).tolist() == [1]
    assert only_standing([run], np.array([0.1, 0.0]), SPEED).tolist() == []


@pytest.mark.parametrize(("named", "expected"), [([], 1.0), ([DRY], 0.0), ([WRONG], 0.5), ([WRONG, DRY], 0.0)])
def test_friction_holds_what_it_can_and_an_offset_acts(named: list[Effect], expected: float) -> None:
    got = beyond_at_rest(Model(arm(), tuple(named)), [standing_elbow()], [1], SPEED)
    np.testing.assert_allclose(got, [expected], atol=0.02)


def test_a_name_that_asks_for_more_is_to_blame_and_friction_never_is() -> None:
    weak = Effect("coulomb_friction", ("elbow",), {"coulomb_torque": 0.6})
    large = Effect("torque_offset", ("elbow",), {"offset": 9.0})
    # 1 N m is measured: what friction of .6 holds is no more than that, so the start leaves nothing.
    assert asked([weak], [large, DRY]) == "torque_offset"
    # The controls: friction alone, an offset that friction can hold, noise as large as that, no name at all.
    assert asked([weak], [DRY]) is None
    assert asked([weak], [WRONG]) is None
    assert asked([weak], [large, DRY], floor=2.0) is None
    assert asked([weak], []) is None


def test_a_joint_on_which_nothing_is_left_beside_one_that_is_asked_too_much_divides_by_nothing() -> None:
    time = np.arange(2000) / 200.0
    q = np.tile([0.5, 0.3], (2000, 1))
    still = np.zeros_like(q)
    tau = predict(arm(), [], q, still, still, time)
    run = process(Trajectory("test", "test", time, {"q": q, "tau": tau}), arm(), ProcessSettings())
    exact, term = Model(arm()), WRONG.term(arm())
    blamed = asks_too_much(exact, Model(arm(), (WRONG,)), [term], lambda t: exact, [run], judge())
    assert blamed == term
