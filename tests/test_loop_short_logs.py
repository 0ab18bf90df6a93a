"""Short and coarse logs: what a few seconds show, what rounding hides, and what a flexible law must not stand for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop import LoopResult, LoopSettings, Model, close_loop
from hybrid_dynamics.loop import floor as floor_module
from hybrid_dynamics.loop import search as search_module
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.blackbox import Learnable
from hybrid_dynamics.loop.floor import examine
from hybrid_dynamics.loop.prepare import gather, read_motion, torque_step
from hybrid_dynamics.loop.search import search
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.loop_report.rest import state_of
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation.excitation import excitation, excitations
from hybrid_dynamics.trajectory import Trajectory


@pytest.fixture(scope="module")
def panda() -> Robot:
    return Robot.from_urdf(find_description("panda.urdf"), lock=("panda_finger_joint1", "panda_finger_joint2"))


def named(result: LoopResult) -> set[tuple[str, tuple[str, ...]]]:
    return {(e.effect.effect, e.effect.joints) for e in result.diagnosis.effects}


def coulomb(robot: Robot, joints: tuple[int, ...], share: float) -> list[Effect]:
    """Coulomb friction of ``share`` of the effort limit."""
    torque = share * robot.effort_limits
    return [Effect("coulomb_friction", (robot.joint_names[j],), {"coulomb_torque": float(torque[j])}) for j in joints]


@pytest.mark.slow
def test_small_friction_of_all_joints_is_named_from_one_run_of_five_seconds(panda: Robot) -> None:
    # One to two floors on each joint: together they are beyond doubt, each alone is not.
    effects = coulomb(panda, tuple(range(7)), 0.002)
    train = [excitation(panda, effects, name="short", duration=5.0, seed=1)]
    test = [excitation(panda, effects, name="test", split="test", duration=5.0, seed=2)]
    found = named(close_loop(panda, train, test))
    truth = {(e.effect, e.joints) for e in effects}
    assert found <= truth
    assert len(found) >= 5


@pytest.mark.slow
def test_friction_of_two_neighbours_is_not_called_a_coupling(panda: Robot) -> None:
    effects = coulomb(panda, (2, 3), 0.02)
    train = [excitation(panda, effects, name="short", duration=5.0, seed=3)]
    test = [excitation(panda, effects, name="test", split="test", duration=5.0, seed=4)]
    assert named(close_loop(panda, train, test)) == {(e.effect, e.joints) for e in effects}


def in_steps(run: Trajectory, step: np.ndarray) -> Trajectory:
    """``run`` with its torque rounded to multiples of ``step`` (n,) [N m]; inf: it always reads zero."""
    seen = np.isfinite(step)
    tau = np.zeros_like(run["tau"])
    tau[:, seen] = np.round(run["tau"][:, seen] / step[seen]) * step[seen]
    return replace(run, signals={**run.signals, "tau": tau})


def test_a_torque_in_wide_steps_or_none_at_all_makes_no_bodies(panda: Robot) -> None:
    # Steps ten times as wide as the noise, and a wrist whose sensor is too coarse to see anything.
    name = panda.joint_names[1]
    effects = [Effect("viscous_friction", (name,), {"viscous_coefficient": 12.0})]
    step = 0.01 * panda.effort_limits
    step[6] = np.inf
    runs = excitations(panda, effects, train=2, test=1, duration=6.0, torque_noise_share=0.0005)
    train, test = ([in_steps(run, step) for run in part] for part in runs)
    recorded = torque_step(train)
    assert np.allclose(recorded[:6], step[:6])
    assert np.isinf(recorded[6])
    result = close_loop(panda, train, test)
    assert named(result) == {("viscous_friction", (name,))}
    assert any("panda_joint7 never changes" in note for note in result.diagnosis.notes)
    # What a joint in motion needs, and nothing is known of, is not explained.
    assert result.diagnosis.verdict == "partly_explained"
    assert [(e["joint"], e["why"].partition(" in the")[0]) for e in result.diagnosis.not_identifiable] == [
        ("panda_joint7", "its torque never changes")
    ]
    assert state_of(result.diagnosis.to_json(), 6)[1] == "its torque never changes"
    # The floor knows what rounding takes away.
    assert np.all(np.asarray(result.diagnosis.noise_floor)[:6] >= 0.99 * step[:6] / np.sqrt(12))
    # Control: with noise wider than the steps, these are part of it.
    assert np.all(torque_step([excitation(panda, effects, duration=2.0)]) == 0.0)


def test_what_one_step_rounds_away_is_no_alarm() -> None:
    """A torque that hardly leaves one step: what is rounded away follows the motion, and says nothing of the robot."""
    train, test = excitations(arm(), [], train=2, test=1, duration=8.0, torque_noise_share=0.0)
    logs = read_motion(arm(), train, test, LoopSettings())
    step, joint = 2.0, 1

    def alarm(law: float, within: float) -> bool:
        left = []
        for run in logs.train:
            torque = step * (0.4 + 0.3 * np.sin(3.0 * run.q)) + law * np.cos(2.0 * run.q)
            left.append(np.round(torque / step) * step - torque + law * np.cos(2.0 * run.q))
        mask = [run.mask for run in logs.train]
        floor = examine(logs.train, left, mask, np.zeros(2), np.full(2, within), LoopSettings())
        return bool(floor.motion_dependent[joint] or floor.cannot_tell[joint])

    assert not alarm(0.0, step / 2)
    # Controls: the same is seen where steps are not known of, and more than half a step where they are.
    assert alarm(0.0, 0.0)
    assert alarm(3.0, step / 2)


@pytest.mark.parametrize(("share", "p_value", "told"), [(0.3, 0.2, True), (0.04, 0.2, False), (0.3, 1e-9, False)])
def test_what_held_out_rows_follow_by_chance_perhaps_is_no_all_clear(
    share: float, p_value: float, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither alarm nor all-clear where a black box removes much and so few samples leave that to chance."""
    monkeypatch.setattr(floor_module, "learnable", lambda *some, **more: Learnable((), share, p_value, share))
    train, _ = excitations(arm(), [], train=2, test=1, duration=8.0)
    logs = read_motion(arm(), train, train, LoopSettings())
    rng = np.random.default_rng(3)
    left = [rng.normal(size=run.tau.shape) for run in logs.train]
    floor = examine(logs.train, left, [run.mask for run in logs.train], np.zeros(2), np.zeros(2), LoopSettings())
    assert floor.cannot_tell.tolist() == [told, told]
    assert floor.unproven.tolist() == [share if told else 0.0] * 2
    assert floor.motion_dependent.tolist() == [p_value < 0.01] * 2


def test_half_a_step_is_rounded_away_only_where_the_torque_hardly_leaves_one(panda: Robot) -> None:
    train, test = excitations(panda, [], train=1, test=1, duration=6.0, torque_noise_share=0.0)
    spread = train[0]["tau"].std(axis=0)
    for share in (0.2, 5.0):
        coarse = [in_steps(run, share * spread) for run in train]
        logs = read_motion(panda, coarse, test, LoopSettings())
        recorded = np.isfinite(logs.step) & (logs.step > 0)
        half = np.sqrt(logs.variance) < 0.5 * logs.step
        np.testing.assert_allclose(logs.rounded_away[half], logs.step[half] / 2)
        np.testing.assert_allclose(logs.rounded_away[~half], logs.step[~half] / np.sqrt(12.0))
        assert recorded.any()
        assert not half.any() if share < 1 else half[recorded].any()


def test_a_refit_from_the_tangent_of_another_model_still_lowers_the_error(panda: Robot) -> None:
    effects = [Effect("torque_gain", (panda.joint_names[1],), {"gain": 1.2})]
    train, test = excitations(panda, effects, train=1, test=1, duration=4.0)
    settings = LoopSettings(effects=("torque_gain", "coulomb_friction"))
    logs = read_motion(panda, train, test, settings)
    judge, terms, _ = gather(Model(panda), logs, settings)
    evidence = judge.evidence
    chosen = [Term("torque_gain", 1), *(t for t in terms if t.effect == "coulomb_friction" and not t.settings)]
    bare = evidence.squared_error(evidence.problem.base_target)
    # As a search leaves it that has just looked at something far away.
    far = [Effect("torque_gain", (panda.joint_names[1],), {"gain": 40.0})]
    evidence = evidence.tangent(far, evidence.problem.left(far), [chosen[0]], np.array([39.0]))
    fitted = refit(evidence, chosen)
    evidence, x = fitted.evidence, fitted.x
    assert x[0] == pytest.approx(0.2, rel=0.02)
    assert evidence.squared_error(evidence.residuals(chosen, x)) < 0.5 * bare


def test_a_refused_change_that_takes_the_place_of_another_is_tried_once(monkeypatch: pytest.MonkeyPatch) -> None:
    # One friction for each direction holds plain Coulomb friction and would take its place, but is refused.
    robot = arm()
    elbow = robot.joint_names[1]
    wanted = {"coulomb_torque_positive": 3.0, "coulomb_torque_negative": 0.5}
    effects = [Effect("asymmetric_coulomb_friction", (elbow,), wanted)]
    train, test = excitations(robot, effects, train=2, test=1, duration=4.0)
    families = ("coulomb_friction", "asymmetric_coulomb_friction")
    settings = LoopSettings(effects=families)
    judge, terms, _ = gather(Model(robot), read_motion(robot, train, test, settings), settings)
    plain = next(t for t in terms if t.effect == "coulomb_friction" and t.joint == 1 and not t.settings)
    tried: list[frozenset[Term]] = []

    def refuse(judge: Judge, current: Sequence[Term], trial: Sequence[Term]) -> None:
        assert frozenset(trial) not in tried
        tried.append(frozenset(trial))

    monkeypatch.setattr(search_module, "take", refuse)
    _, steps = search(judge, terms, lambda step: None, [plain])
    assert [step.action for step in steps] == ["stop"]
    assert any({t.effect for t in trial} == {"asymmetric_coulomb_friction"} for trial in tried)


def test_a_log_in_which_every_torque_that_says_something_is_silent_is_refused() -> None:
    train, test = excitations(arm(), (), train=2, test=1, duration=8.0, rate=200.0, still=[0])
    dead = [run.with_signals(tau=np.column_stack([run["tau"][:, 0], 0.3 + 0 * run["tau"][:, 1]])) for run in train]
    with pytest.raises(InputError, match="torque of every joint that moves never changes in the training runs"):
        close_loop(arm(), dead, test)
    assert close_loop(arm(), train, test).diagnosis.verdict == "nothing_missing"
