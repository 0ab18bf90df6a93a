"""One link changed beyond belief gives way to all links near the URDF's; a block that really is there stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.small_arm import heavier_links
from tests.test_loop_beside import ELBOW, FEW_POSES, ROBOT, SHOULDER, errors, judged

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.effects.inertia import link_parameters, to_body
from hybrid_dynamics.loop import LoopSettings
from hybrid_dynamics.loop import widen as widen_module
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.beside import beside_links
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.trace import Gain, Judge
from hybrid_dynamics.loop.widen import BELIEVED, beyond_belief, widened
from hybrid_dynamics.simulation.excitation import excitations
from hybrid_dynamics.types import Array


def first_link(judge: Judge) -> list[Term]:
    """The model that a search would end with if one link stood for everything."""
    return [t for t in judge.evidence.terms if t.effect == "link_inertia" and t.joint == 0]


def changed(judge: Judge, chosen: list[Term]) -> float:
    return beyond_belief(judge, chosen, refit(judge.evidence, chosen).x)


@pytest.mark.parametrize(
    "hidden",
    [
        Effect("torque_offset", (SHOULDER,), {"offset": -8.0}),
        Effect("joint_spring", (SHOULDER,), {"stiffness": 15.0, "rest_position": 0.0}, {"shape": "linear"}),
    ],
    ids=["offset", "spring"],
)
def test_a_link_that_no_such_link_is_gives_way_to_all_links(hidden: Effect) -> None:
    judge, (every,), test = judged([hidden])
    single = first_link(judge)
    assert changed(judge, single) > BELIEVED
    assert widened(judge, single)[1] == [every]
    # In the poses of the run both are right; in others the one link is not.
    _, before = errors(judge, single, [], test)
    judge, beside = beside_links(judge, [every])
    _, after = errors(judge, [every], beside, test)
    assert after < 0.9 * before


@pytest.mark.parametrize("times", [1.0, 5.0, 10.0])
def test_a_block_that_is_there_stays_however_heavy(times: float) -> None:
    body = to_body(link_parameters(ROBOT, 0) * (1 + times))
    judge, _, _ = judged([Effect("link_inertia", (SHOULDER,), body)])
    single = first_link(judge)
    assert (changed(judge, single) > BELIEVED) == (times > 1)
    assert widened(judge, single)[1] == single


def test_a_change_that_is_believed_is_not_asked() -> None:
    # An offset that all links and a constant would explain better, but the link is one that could be.
    judge, (every,), _ = judged([Effect("torque_offset", (SHOULDER,), {"offset": -3.0})])
    single = first_link(judge)
    assert changed(judge, single) < BELIEVED
    judge = judge.at(single)
    judge, beside = beside_links(judge, [every])
    together = [every, *beside]
    assert judge.evidence.held(together, physical=True).score < judge.evidence.held(single, physical=True).score
    assert widened(judge, single)[1] == single


def test_all_links_are_not_asked_again() -> None:
    judge, chosen, _ = judged([Effect("torque_offset", (SHOULDER,), {"offset": -8.0})])
    assert widened(judge, chosen)[1] == chosen


def two_links(judge: Judge) -> list[Term]:
    """A model of two single bodies."""
    return [t for t in judge.evidence.terms if t.effect in ("link_inertia", "payload")]


def test_several_bodies_that_are_there_stay() -> None:
    body = to_body(link_parameters(ROBOT, 0) * 1.5)
    payload = to_body(link_parameters(ROBOT, 1) * 0.5)
    judge, _, _ = judged([Effect("link_inertia", (SHOULDER,), body), Effect("payload", (), payload)])
    bodies = two_links(judge)
    assert len(bodies) == 2
    assert changed(judge, bodies) < BELIEVED
    assert widened(judge, bodies)[1] == bodies


def test_several_bodies_that_stand_for_a_constant_give_way() -> None:
    judge, (every,), test = judged([heavier_links(0.15), Effect("torque_offset", (SHOULDER,), {"offset": -3.0})])
    bodies = two_links(judge)
    assert changed(judge, bodies) < BELIEVED
    assert widened(judge, bodies)[1] == [every]
    _, before = errors(judge, bodies, [], test)
    judge, beside = beside_links(judge, [every])
    _, after = errors(judge, [every], beside, test)
    assert after < 0.9 * before


def hidden_ripple(*joints: str) -> list[Effect]:
    """A link half as heavy again and ripple of ``joints``, which no friction and no link makes."""
    body = Effect("link_inertia", (SHOULDER,), to_body(link_parameters(ROBOT, 0) * 1.5))
    ripple = {"harmonic": 6.0, "amplitude": 0.5, "phase": 0.3}
    return [body, *(Effect("torque_ripple", (joint,), ripple) for joint in joints)]


def rippled(*joints: str) -> tuple[Judge, list[Term]]:
    """Evidence of :func:`hidden_ripple`, and the link's body."""
    judge, _, _ = judged(hidden_ripple(*joints))
    return judge, first_link(judge)


def test_where_most_joints_are_left_all_links_are_as_likely_as_one() -> None:
    judge, single = rippled(SHOULDER, ELBOW)
    held = judge.evidence.held(single, physical=True)
    assert judge.mostly_left(held)
    every = [t for t in judge.evidence.terms if t.family().all_links]
    there, beside = beside_links(judge, every)
    # They predict no better: nothing but the burden of proof is another.
    assert not judge.news(there.evidence.held([*every, *beside], physical=True), held).surer_than(1.0)
    assert widened(judge, single)[1] == every
    # Control: one joint is left of two, and the link that could be is not asked.
    judge, single = rippled(SHOULDER)
    assert judge.above_floor(judge.evidence.held(single, physical=True)).tolist() == [True, False]
    assert widened(judge, single)[1] == single


def test_links_that_the_starting_model_has_identified_take_no_body_s_place() -> None:
    judge, single = rippled(SHOULDER, ELBOW)
    assert [t.effect for t in widened(judge, single)[1]] == ["inertial_parameters"]
    known = replace(judge.evidence.base, effects=(heavier_links(0.0),))
    settings = LoopSettings()
    train, _ = excitations(FEW_POSES, hidden_ripple(SHOULDER, ELBOW), train=1, test=0, duration=8.0, rate=250.0)
    there, _, _ = gather(known, read_motion(ROBOT, train, train, settings), settings)
    assert there.mostly_left(there.evidence.held(first_link(there), physical=True))
    assert widened(there, first_link(there))[1] == first_link(there)


def test_where_no_link_is_named_all_links_come_in_as_any_effect_does() -> None:
    ripple = {"harmonic": 6.0, "amplitude": 0.5, "phase": 0.3}
    # All links are off by a little, and none so much that it was named.
    judge, (every,), _ = judged([heavier_links(0.15), Effect("torque_ripple", (SHOULDER,), ripple)])
    friction = [t for t in judge.evidence.terms if t.effect == "viscous_friction"]
    assert judge.mostly_left(judge.evidence.held(friction, physical=True))
    assert widened(judge, friction, judge.evidence.terms)[1] == [*friction, every]
    # Control: where more is asked of an effect, more is asked of them (their gain is 2.5 errors).
    strict = replace(judge, settings=replace(judge.settings, gain_in_errors=3.0))
    assert widened(strict, friction, judge.evidence.terms)[1] == friction
    # Control: what all links leave is not surely less than what friction does.
    judge, _ = rippled(SHOULDER, ELBOW)
    assert judge.mostly_left(judge.evidence.held(friction, physical=True))
    assert widened(judge, friction, judge.evidence.terms)[1] == friction
    # Control: beside no name there is nothing that could have stood for them.
    assert widened(judge, [], judge.evidence.terms)[1] == []


def test_a_link_that_is_off_by_more_than_plausible_must_be_surer(monkeypatch: pytest.MonkeyPatch) -> None:
    # Ripple takes the links further than they are off (1.3 plausible changes), and they gain six errors.
    ripple = {"harmonic": 6.0, "amplitude": 0.12, "phase": 0.3}
    judge, (every,), _ = judged([heavier_links(0.15), Effect("torque_ripple", (ELBOW,), ripple)])
    friction = [t for t in judge.evidence.terms if t.effect == "viscous_friction"]
    assert widened(judge, friction, judge.evidence.terms)[1] == [*friction, every]
    # Four errors, were they asked of any effect, would be nearly seven of such links.
    strict = replace(judge, settings=replace(judge.settings, gain_in_errors=4.0))
    assert widened(strict, friction, judge.evidence.terms)[1] == friction
    monkeypatch.setattr(widen_module, "PLAUSIBLE", np.inf)
    assert widened(strict, friction, judge.evidence.terms)[1] == [*friction, every]
    # Beyond belief no gain is enough.
    monkeypatch.setattr(widen_module, "BELIEVED", 1.0)
    assert widened(judge, friction, judge.evidence.terms)[1] == friction


def test_constant_torques_of_most_joints_may_be_weight(monkeypatch: pytest.MonkeyPatch) -> None:
    ripple = {"harmonic": 6.0, "amplitude": 0.08, "phase": 0.3}
    # All links are off by a little, ripple has no name, and more is asked of an effect than all links gain.
    off = [heavier_links(0.12), *(Effect("torque_ripple", (joint,), ripple) for joint in (SHOULDER, ELBOW))]
    judge, (every,), _ = judged(off)
    judge = replace(judge, settings=replace(judge.settings, gain_in_errors=3.5))
    constant = [t for t in judge.evidence.terms if t.effect == "torque_offset"]
    # Two may well be what two sensors' zeros are off by; on an arm of more joints they would not be most.
    assert widened(judge, constant, judge.evidence.terms)[1] == constant
    monkeypatch.setattr(widen_module, "FEWEST", 2)
    assert widened(judge, constant, judge.evidence.terms)[1] == [*constant, every]
    # Control: one of two joints is not most of them, and friction is not what links weigh.
    assert widened(judge, constant[:1], judge.evidence.terms)[1] == constant[:1]
    friction = [t for t in judge.evidence.terms if t.effect == "viscous_friction"]
    assert widened(judge, friction, judge.evidence.terms)[1] == friction
    # Control: links that are off by more than could be.
    monkeypatch.setattr(widen_module, "PLAUSIBLE", 0.3)
    assert widened(judge, constant, judge.evidence.terms)[1] == constant


def test_constant_torques_that_are_there_stay_beside_what_links_could_only_stand_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(widen_module, "FEWEST", 2)
    ripple = {"harmonic": 6.0, "amplitude": 0.3, "phase": 0.3}
    hidden = [Effect("torque_offset", (joint,), {"offset": 1.0}) for joint in (SHOULDER, ELBOW)]
    judge, _, _ = judged([*hidden, *(Effect("torque_ripple", (joint,), ripple) for joint in (SHOULDER, ELBOW))])
    constant = [t for t in judge.evidence.terms if t.effect == "torque_offset"]
    assert judge.mostly_left(judge.evidence.held(constant, physical=True))
    assert widened(judge, constant, judge.evidence.terms)[1] == constant
    # Control: what keeps the links out is how far they would have to be off.
    monkeypatch.setattr(widen_module, "PLAUSIBLE", np.inf)
    assert widened(judge, constant, judge.evidence.terms)[1] != constant


def test_friction_that_is_missing_on_both_sides_speaks_for_none() -> None:
    body = Effect("link_inertia", (SHOULDER,), to_body(link_parameters(ROBOT, 0) * 1.5))
    rough = [Effect("viscous_friction", (joint,), {"viscous_coefficient": 0.3}) for joint in (SHOULDER, ELBOW)]
    judge, _, _ = judged([body, *rough])
    single = first_link(judge)
    plain = [t for t in judge.evidence.terms if t.effect == "viscous_friction"]
    assert judge.mostly_left(judge.evidence.held(single, physical=True))
    assert widened(judge, single, plain)[1] == single


def test_what_rounding_takes_away_speaks_for_no_model() -> None:
    body = to_body(link_parameters(ROBOT, 0) * 6)
    judge, (every,), _ = judged([Effect("link_inertia", (SHOULDER,), body)])
    single = first_link(judge)
    judge = judge.at(single).adding([every])
    held = judge.evidence.held
    new, old = held([every], physical=True), held(single, physical=True)
    whole = judge.gain(new, old)
    known = judge.news(new, old)
    assert (known.total, known.error) == (whole.total, whole.error)
    # Both joints have changed by less than their steps: nothing is known of either.
    nothing = replace(judge, misfit=np.full(2, 1.1 * np.sqrt(np.abs(whole.per_joint).max()))).news(new, old)
    assert (nothing.total, nothing.error) == (0.0, 0.0)
    # One of them has: the other alone counts.
    rounded = np.array([1.1 * np.sqrt(abs(whole.per_joint[0])), 0.0])
    other = replace(judge, misfit=rounded).news(new, old)
    expected = judge.gain(new, old, joints=np.array([False, True]))
    assert other.total == expected.total
    assert other.total != whole.total


def test_links_that_only_follow_a_torque_rounded_to_nothing_replace_no_body(monkeypatch: pytest.MonkeyPatch) -> None:
    body = to_body(link_parameters(ROBOT, 0) * 6)
    judge, (every,), _ = judged([Effect("link_inertia", (SHOULDER,), body)])
    single = first_link(judge)
    monkeypatch.setattr(Judge, "gain", lambda *_, joints=None, **__: Gain(*_gain_of(joints)))
    assert widened(judge, single)[1] == [every]
    # Where the steps of the torque are as large, the gain is of none.
    assert widened(replace(judge, misfit=np.ones(2)), single)[1] == single


def _gain_of(joints: NDArray[np.bool_] | None) -> tuple[float, float, Array, int]:
    """A gain that is sure, all of it on the second joint, of (.5 N m)^2."""
    counts = joints is None or bool(joints[1])
    return 1e5 * counts, 1.0, np.array([0.0, 0.25]), 10


def test_links_that_would_have_to_be_others_do_not_stand_for_what_has_no_name(monkeypatch: pytest.MonkeyPatch) -> None:
    # The links are right, and ripple of both joints is left: in few poses they would make its torque, and twice as
    # heavy as they are they would be far off elsewhere.
    judge, (every,), _ = judged(hidden_ripple(SHOULDER, ELBOW)[1:])
    friction = [t for t in judge.evidence.terms if t.effect == "viscous_friction"]
    assert judge.mostly_left(judge.evidence.held(friction, physical=True))
    assert widened(judge, friction, judge.evidence.terms)[1] == friction
    # Control: by their gain alone, nearly three errors, they would have come in.
    monkeypatch.setattr(widen_module, "PLAUSIBLE", np.inf)
    assert widened(judge, friction, judge.evidence.terms)[1] == [*friction, every]
