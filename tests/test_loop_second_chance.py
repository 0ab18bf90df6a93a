"""What the search let go of, or could not be sure of by its coefficient alone, gets the look that it deserves."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop import LoopSettings, Model, prune
from hybrid_dynamics.loop import find as find_module
from hybrid_dynamics.loop import search as search_module
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.search import Step
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation.excitation import excitations

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names


def judged(effects: Sequence[Effect]) -> tuple[Judge, list[Term]]:
    settings = LoopSettings()
    train, test = excitations(ROBOT, effects, train=2, test=1, duration=8.0, rate=250.0)
    judge, terms, _ = gather(Model(ROBOT), read_motion(ROBOT, train, test, settings), settings)
    return judge, terms


def silent(step: Step) -> None:
    assert step.terms is not None


@pytest.mark.parametrize(("returns", "named"), [(2, ["joint_spring"]), (0, [])])
def test_what_an_unsure_effect_kept_out_is_asked_when_that_goes(
    monkeypatch: pytest.MonkeyPatch, returns: int, named: list[str]
) -> None:
    spring = {"stiffness": 2.0, "rest_position": 0.4}
    judge, _ = judged([Effect("joint_spring", (SHOULDER,), spring, {"shape": "linear"})])
    proxy, cause = Term("position_offset", 0, ()), Term("joint_spring", 0, (("shape", "linear"),))
    judge = judge.adding([proxy, cause])
    judge = judge.at([proxy])
    really: Callable[..., tuple[Judge, list[Term], set[str], list[Step]]] = prune.keep_sure

    def without_proxy(
        judge: Judge, current: Sequence[Term], looked: int, report: Callable[[Step], None]
    ) -> tuple[Judge, list[Term], set[str], list[Step]]:
        return really(judge, [t for t in current if t != proxy], looked, report)

    monkeypatch.setattr(find_module, "keep_sure", without_proxy)
    monkeypatch.setattr(find_module, "MOST_RETURNS", returns)
    _, kept, _, _ = find_module._surely(judge, [proxy], [proxy, cause], 2, silent)
    assert [t.effect for t in kept] == named


def test_nothing_is_asked_again_where_nothing_is_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    judge, terms = judged([])
    proxy = Term("joint_spring", 0, (("shape", "linear"),))
    judge = judge.adding([proxy])
    judge = judge.at([proxy])
    asked: list[Sequence[Term]] = []

    def refined(judge: Judge, chosen: Sequence[Term], *rest: object) -> tuple[Judge, list[Term], list[Step]]:
        asked.append(chosen)
        return judge, list(chosen), []

    monkeypatch.setattr(find_module, "_refined", refined)
    _, kept, _, _ = find_module._surely(judge, [proxy], [*terms, proxy], len(terms), silent)
    assert kept == []
    assert asked == []


@pytest.mark.parametrize("replacing", [True, False])
def test_a_search_may_be_told_to_add_only(monkeypatch: pytest.MonkeyPatch, replacing: bool) -> None:
    judge, terms = judged([Effect("viscous_friction", (ELBOW,), {"viscous_coefficient": 0.4})])
    tried: list[bool] = []
    monkeypatch.setattr(search_module, "_replace", lambda *given: tried.append(True))
    _, steps = search_module.search(judge, terms, silent, replacing=replacing)
    assert [(t.effect, t.joint) for t in steps[-1].terms] == [("viscous_friction", 1)]
    assert bool(tried) is replacing


@pytest.mark.parametrize(("size", "sure"), [(2.0, True), (0.5, True), (0.5, False)])
def test_friction_that_held_out_rows_surely_miss_stays(
    monkeypatch: pytest.MonkeyPatch, size: float, sure: bool
) -> None:
    friction = Effect("viscous_friction", (ELBOW,), {"viscous_coefficient": 0.4})
    judge, terms = judged([friction])
    plainest = [t for t in terms if t.family().everywhere and not t.settings]
    # No coefficient by itself is as sure as all joints ask for, or is one at all.
    monkeypatch.setattr(prune, "in_errors", lambda judge, current, x: dict.fromkeys(current, size))
    _, kept = prune.without_noise(judge, plainest, sure)
    assert [(t.effect, t.joint) for t in kept] == [("viscous_friction", 1)]
    # Control: what the held-out rows do not miss goes, however it was called.
    other, _ = judged([])
    assert prune.without_noise(other, plainest, sure)[1] == []


def test_offsets_on_many_joints_are_given_back_to_the_one_wrong_zero_behind_them() -> None:
    robot = Robot.from_urdf(find_description("ur_description/urdf/ur5_robot.urdf"))
    offsets = [Term("torque_offset", j, ()) for j in (1, 2, 3)]
    zero, decoy = Term("position_offset", 1, ()), Term("time_delay", None, ())

    def replaced(effects: Sequence[Effect]) -> list[Term] | None:
        settings = LoopSettings()
        train, test = excitations(robot, effects, train=2, test=1, duration=8.0, rate=100.0)
        judge, _, _ = gather(Model(robot), read_motion(robot, train, test, settings), settings)
        judge = judge.adding([*offsets, zero, decoy])
        judge = judge.at(offsets)
        before = judge.evidence.held(offsets, physical=True)
        return search_module._replace(judge, offsets, [*offsets, zero, decoy], before, set())

    lift = robot.joint_names[1]
    assert replaced([Effect("position_offset", (lift,), {"offset": 0.02})]) == [zero]
    # Control: constant torques on three joints are no wrong zero.
    constant = [
        Effect("torque_offset", (robot.joint_names[j],), {"offset": t}) for j, t in ((1, 2.0), (2, -1.5), (3, 0.6))
    ]
    assert replaced(constant) is None
