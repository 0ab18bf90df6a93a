"""An arm on a wall: what its links and loads do is that of the gravity it hangs in, not of the URDF's."""

from __future__ import annotations

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect, family, gravity_tilt, predict
from hybrid_dynamics.loop import LoopResult, LoopSettings, Model, close, close_loop
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.mounting import as_found, as_mounted, held_upright, turned_by
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.trajectory import Trajectory

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


def _along(pitch: float) -> np.ndarray:
    """Gravity (3,) in the frame of a base that is turned by ``pitch`` [rad]."""
    return 9.81 * np.array([np.sin(pitch), 0.0, -np.cos(pitch)])


@pytest.mark.parametrize(("off", "upright"), [(0.0, True), (2.0, True), (-2.5, True), (4.5, False), (-20.0, False)])
def test_a_wall_is_upright_unless_gravity_is_found_far_from_it(off: float, upright: bool) -> None:
    found = _along(np.pi / 2 + np.deg2rad(off))
    turned = as_mounted(Model(ROBOT), found, LoopSettings())
    expected = _along(np.pi / 2) if upright else found
    np.testing.assert_allclose(turned.completed_robot.model.gravity.linear, expected, atol=1e-9)


def test_a_tilt_that_a_search_held_to_the_wall_found_all_the_same_is_searched_from_there() -> None:
    start = Model(ROBOT)
    wall = as_mounted(start, _along(np.pi / 2), LoopSettings())
    assert as_found(start, wall, [_tilted(np.pi / 2 - np.deg2rad(0.5))]) is None
    leaning = as_found(start, wall, [_tilted(np.pi / 2 - np.deg2rad(3.0))])
    assert leaning is not None
    gravity = leaning.completed_robot.model.gravity.linear
    np.testing.assert_allclose(gravity, _along(np.pi / 2 - np.deg2rad(3.0)), atol=1e-9)


def test_that_a_base_is_held_upright_is_noted() -> None:
    start = Model(ROBOT)
    (note,) = held_upright(start, as_mounted(start, _along(np.pi / 2), LoopSettings()))
    assert "half a degree" in note
    assert held_upright(start, as_mounted(start, _along(np.pi / 2 + 0.2), LoopSettings())) == []
    assert held_upright(start, start) == []


@pytest.mark.parametrize("pitch", [np.pi / 2, 1.2, -0.3])
def test_the_angle_of_a_wall_is_as_sure_as_the_direction_of_gravity(pitch: float) -> None:
    (term,) = family("gravity_tilt").terms(ROBOT, np.ones(2, bool), {})
    robot = ROBOT.copy()
    robot.model.gravity.linear = _along(pitch)
    jacobian = term.family().jacobian(np.zeros(3), robot, term)
    assert np.all(np.isfinite(jacobian))
    # Turned about y by a small angle, gravity moves by that angle times its size.
    step = _along(pitch + 1e-4) - _along(pitch - 1e-4)
    assert (jacobian @ step)[1] == pytest.approx(2e-4, rel=1e-3)


def test_only_a_base_on_a_wall_or_a_ceiling_is_held_to_it() -> None:
    (term,) = family("gravity_tilt").terms(ROBOT, np.ones(2, bool), {})
    for pitch, held in ((0.0, False), (np.pi / 2, True), (-np.pi / 2, True), (np.pi, True), (1.2, False)):
        robot = ROBOT.copy()
        robot.model.gravity.linear = _along(pitch).round(12)
        assert (term.prior_scale(robot)[0] < 0.1) == held
        # That it stands upright is known: nothing of it is left open by runs that say no more.
        assert term.family().open_scale(robot, term)[0] > 1.0


@pytest.mark.parametrize("seed", range(3))
def test_in_few_poses_links_that_weigh_otherwise_do_not_turn_the_wall(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of joints that hardly move a tilt and the first moments of the links make one torque: the tilt is open by what
    they may weigh otherwise, and by no more than a wall may lean where it is held to that."""

    def error(train: Trajectory) -> float:
        """Standard error [rad] of the angle of the base, all links identified with it."""
        settings = LoopSettings(effects=("gravity_tilt", "inertial_parameters"))
        start = as_mounted(Model(ROBOT), _along(np.pi / 2), settings)
        judge, terms, _ = gather(start, read_motion(start.completed_robot, [train], [], settings), settings)
        chosen = [next(t for t in terms if t.effect == name) for name in settings.effects or ()]
        (tilt, *_) = refit(judge.adding(chosen).evidence, chosen).model().effects[len(start.effects) :]
        return tilt.std_errors["pitch"]

    whole = noisy_log([], seed, "train", 0.0)
    q = 0.3 + 0.15 * whole["q"]
    dq = np.gradient(q, whole.time, axis=0)
    tau = predict(ROBOT, [_tilted(np.pi / 2), WRONG[0]], q, dq, np.gradient(dq, whole.time, axis=0), whole.time)
    noise = NOISE * np.random.default_rng(seed).normal(size=q.shape)
    few = Trajectory("few", "train", whole.time, {"q": q, "dq": dq, "tau": tau + noise})
    assert error(few) < 1.2 * gravity_tilt.UPRIGHT
    monkeypatch.setattr(gravity_tilt, "UPRIGHT", 0.5)
    assert error(few) > np.deg2rad(2.0)
