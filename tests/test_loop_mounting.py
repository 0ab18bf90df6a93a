"""An arm on a wall: what its links and loads do is that of the gravity it hangs in, not of the URDF's."""

from __future__ import annotations

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.loop import LoopResult, LoopSettings, Model, close, close_loop
from hybrid_dynamics.loop.mounting import as_found, as_mounted, turned_by

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
#: Of the torque [N m].
NOISE = 0.05
#: Links that weigh other than the URDF says, and friction that follows what the shoulder carries.
WRONG = [
    Effect("link_mass", (ELBOW,), {"mass": 4.0}),
    Effect("load_dependent_friction", (SHOULDER,), {"load_coefficient": 0.1}),
    Effect("viscous_friction", (ELBOW,), {"viscous_coefficient": 1.5}),
]


def _tilted(pitch: float) -> Effect:
    return Effect("gravity_tilt", (), {"roll": 0.0, "pitch": pitch})


def _closed(*hidden: Effect) -> LoopResult:
    train = [noisy_log(hidden, seed, "train", NOISE) for seed in (1, 2)]
    return close_loop(ROBOT, train, [noisy_log(hidden, 51, "test", NOISE)])


def _right(result: LoopResult) -> bool:
    """True where all of ``WRONG`` is named and the test runs are predicted down to the noise."""
    named = {(e.effect, e.joints) for e in result.model.effects}
    error = result.diagnosis.error["test"].after.rmse
    return {(e.effect, e.joints) for e in WRONG} <= named and max(error) < 1.1 * max(result.floor.value)


@pytest.mark.parametrize("pitch", [np.pi / 2, 2.8, 0.4], ids=["on a wall", "under a ceiling", "on a ramp"])
def test_what_is_wrong_with_the_links_is_found_wherever_the_base_stands(
    pitch: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = _closed(_tilted(pitch), *WRONG)
    assert _right(result)
    tilt = next(e for e in result.model.effects if e.effect == "gravity_tilt")
    # Beyond a quarter turn the same base is turned about the other axis by half a turn first.
    assert abs(tilt.parameters["pitch"] - min(pitch, np.pi - pitch)) < 4 * tilt.std_errors["pitch"]
    # One tilt, told as it is against the level, and confirmed by the test runs.
    assert sum(e.effect == "gravity_tilt" for e in result.model.effects) == 1
    assert [e.confirmed for e in result.diagnosis.effects] == [True] * len(result.diagnosis.effects)
    if pitch < 1.0:
        return
    # Control: with columns of the gravity that the URDF has they are not.
    monkeypatch.setattr(close, "as_mounted", lambda start, gravity, settings: start)
    monkeypatch.setattr(close, "as_found", lambda start, searched, found: None)
    assert not _right(_closed(_tilted(pitch), *WRONG))


def test_a_level_arm_is_searched_once_and_from_where_it_stands() -> None:
    level, start = np.array([0.0, 0.0, -9.81]), Model(ROBOT)
    assert as_mounted(start, level, LoopSettings()) is start
    assert as_found(start, start, WRONG) is None
    assert as_found(start, start, [_tilted(0.05)]) is None


def test_a_base_is_turned_only_where_a_tilt_may_be_named_and_nothing_else_feigns_it() -> None:
    start = Model(ROBOT, (WRONG[2],), (), (0.1, 0.2))
    wall, ramp = np.array([9.81, 0.0, 0.0]), 9.81 * np.array([np.sin(0.6), 0.0, -np.cos(0.6)])
    turned = as_mounted(start, wall, LoopSettings())
    assert turned.misfit == start.misfit
    np.testing.assert_allclose(turned.completed_robot.model.gravity.linear, wall, atol=1e-9)
    assert [t.effect for t in turned_by(start, turned)] == ["gravity_tilt"]
    assert as_mounted(start, ramp, LoopSettings()) is start
    assert as_mounted(start, wall, LoopSettings(effects=("viscous_friction",))) is start
