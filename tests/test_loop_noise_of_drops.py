"""Whose noise a decision is judged by: of a delay's column, of a law that has gone, of a body, of the test runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop import LoopSettings, Model, augment, prune
from hybrid_dynamics.loop import complete as complete_module
from hybrid_dynamics.loop import confirm as confirm_module
from hybrid_dynamics.loop import problem as problem_module
from hybrid_dynamics.loop import trace as trace_module
from hybrid_dynamics.loop.augment import Refit, refit
from hybrid_dynamics.loop.blocks import folds_of
from hybrid_dynamics.loop.complete import _where_it_fits, complete
from hybrid_dynamics.loop.confirm import test_change as change_on_tests
from hybrid_dynamics.loop.describe import _why_not
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.find import find
from hybrid_dynamics.loop.found import Found
from hybrid_dynamics.loop.further import at_the_end, further_candidates, simplify
from hybrid_dynamics.loop.held import Held
from hybrid_dynamics.loop.identifiability import inconsistent
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.prune import keep_sure
from hybrid_dynamics.loop.trace import Gain, Judge, joined
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation.excitation import excitations

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names


def judged(effects: Sequence[Effect], **options: object) -> tuple[Judge, list[Term]]:
    settings = LoopSettings()
    train, test = excitations(ROBOT, effects, train=2, test=1, duration=8.0, rate=250.0, **options)
    judge, terms, _ = gather(Model(ROBOT), read_motion(ROBOT, train, test, settings), settings)
    return judge, terms


def plain(effect: str, joint: int, terms: Sequence[Term]) -> Term:
    return next(t for t in terms if t.effect == effect and t.joint == joint and not t.settings)


def delay_found(robot: Robot, bits: int) -> float:
    """Delay that a re-fit finds where a torque is 12 ms late and most noise is that of the encoder."""
    late = [Effect("time_delay", (), {"delay": 0.012})]
    options = {"duration": 8.0, "rate": 250.0, "torque_noise_share": 1e-4, "encoder_bits": bits}
    train, test = excitations(robot, late, train=1, test=1, **options)
    settings = LoopSettings(effects=("time_delay",))
    judge, terms, _ = gather(Model(robot), read_motion(robot, train, test, settings), settings)
    return float(refit(judge.evidence, terms).x[0])


def test_a_delay_is_right_where_the_noise_is_that_of_the_encoder(monkeypatch: pytest.MonkeyPatch) -> None:
    assert delay_found(ROBOT, 12) == pytest.approx(0.012, rel=0.02)
    # Control: with steps as long as the tangent says, noise of the column makes them too short to arrive.
    monkeypatch.setattr(augment, "UNDERSTATED", np.inf)
    assert delay_found(ROBOT, 12) < 0.9 * 0.012


def test_a_delay_of_a_heavy_arm_is_asked_at_its_own_instant(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Robot.from_urdf(find_description("ur_description/urdf/ur10_joint_limited_robot.urdf"))
    assert delay_found(robot, 13) == pytest.approx(0.012, rel=0.02)
    # Control: a column at no delay holds noise of one instant, what is left that of another: they pull it back.
    monkeypatch.setattr(problem_module, "late", lambda own, time, read: own)
    assert delay_found(robot, 13) < 0.96 * 0.012


def test_what_goes_takes_no_certainty_from_what_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    # A wrong zero goes: from then on the linear problem stands elsewhere, and so does the noise drops are judged by.
    effects = [
        Effect("position_offset", (SHOULDER,), {"offset": 0.2}),
        Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 0.4}),
    ]
    judge, terms = judged(effects)
    zero, friction = Term("position_offset", 0), plain("coulomb_friction", 0, terms)
    judge = judge.adding([zero])
    current = [zero, friction]
    judge = judge.at(current)
    monkeypatch.setattr(prune, "_forced", lambda judge, kept: {zero} & set(kept))
    worth, asked = Judge.worth, []

    def spy(judge: Judge, kept: Sequence[Term], term: Term, noise: Held | None = None, physical: bool = True) -> Gain:
        if noise is not None:
            asked.append(len(kept))
            now = judge.evidence.held(current, physical=True)
            np.testing.assert_array_equal(noise.joint_errors, now.joint_errors)
        return worth(judge, kept, term, noise, physical)

    monkeypatch.setattr(Judge, "worth", spy)
    _, kept, _, _ = keep_sure(judge, current, len(terms), lambda step: None)
    assert kept == [friction]
    assert list(dict.fromkeys(asked)) == [2, 1]


@pytest.mark.parametrize(("offset", "named"), [(0.06, True), (0.02, False)])
def test_an_offset_of_practical_size_beside_a_body_is_named(offset: float, named: bool) -> None:
    # Both are sure (17 and 6 standard errors) and the link would take them up; the smaller is a fifth of a floor.
    effects = [
        Effect("link_mass", (ELBOW,), {"mass": 2.5}),
        Effect("torque_offset", (SHOULDER,), {"offset": offset}),
    ]
    judge, terms = judged(effects)
    body, constant = Term("link_mass", 1), plain("torque_offset", 0, terms)
    judge = judge.adding([body])
    judge = judge.at([body])
    _, completed = complete(judge, [body], terms)
    assert (completed == [body, constant]) is named
    # Control: what is not there is not named on any joint.
    assert not [t for t in completed if t not in (body, constant)]


@pytest.mark.parametrize("where", [SHOULDER, ELBOW])
def test_what_comes_in_beside_a_body_goes_to_the_joint_that_has_it(monkeypatch: pytest.MonkeyPatch, where: str) -> None:
    hidden = [Effect("link_mass", (ELBOW,), {"mass": 2.5}), Effect("torque_offset", (where,), {"offset": 0.06})]
    judge, terms = judged(hidden)
    body, own = Term("link_mass", 1), ROBOT.joint_names.index(where)
    judge = judge.adding([body])
    right, wrong = (plain("torque_offset", joint, terms) for joint in (own, 1 - own))

    def came_first(_: Judge, chosen: list[Term], *__: object) -> list[Term]:
        return chosen if wrong in chosen else [*chosen, wrong]

    with monkeypatch.context() as patch:
        # The joint that asked first has it not.
        patch.setattr(complete_module, "_together", came_first)
        assert complete(judge.at([body]), [body], terms)[1] == [body, right]
    places = [("torque_offset", 0), ("torque_offset", 1)]
    assert _where_it_fits(judge, [body, right], right, terms, places) == [body, right]
    # Control: beside what acts on one joint alone there is nothing that could have taken it up, and it is not asked.
    friction = plain("viscous_friction", 0, terms)
    assert _where_it_fits(judge, [friction, wrong], wrong, terms, places) == [friction, wrong]


def test_a_name_that_costs_a_little_is_not_moved_to_where_it_is_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    judge, terms = judged([Effect("link_mass", (ELBOW,), {"mass": 2.5})])
    body, places = Term("link_mass", 1), [("coulomb_friction", 0), ("coulomb_friction", 1)]
    judge = judge.adding([body])
    here, there = (plain("coulomb_friction", joint, terms) for joint in (0, 1))
    real = Evidence.held

    def costing(evidence: Evidence, chosen: Sequence[Term], *args: Any, **options: Any) -> Held:
        held = real(evidence, chosen, *args, **options)
        return replace(held, score=1.01 * held.score) if here in chosen else held

    monkeypatch.setattr(Evidence, "held", costing)
    # On the other joint it is nothing, and predicts as well as none.
    assert judge.evidence.held([body, there]).score < judge.evidence.held([body, here]).score
    assert _where_it_fits(judge, [body, here], here, terms, places) == [body, here]


def test_a_name_that_spoils_one_far_run_is_contradicted() -> None:
    # Right where it was learned, far off in one test run: its own error there is no noise that excuses it.
    judge, _ = judged([])
    spring = Effect("joint_spring", (SHOULDER,), {"stiffness": 2.0, "rest_position": 0.0}, {"shape": "linear"})
    tests = judge.evidence.runs
    full, bare = Model(ROBOT).adding([spring]), Model(ROBOT)
    change = change_on_tests(judge, tests, full, bare, 1)
    assert change.contradicts
    assert change.error < 0.2 * change.relative
    # Control: the other way round it is what the runs ask for.
    other = change_on_tests(judge, tests, bare, full, 1)
    assert not other.contradicts
    assert other.relative < 0
    assert np.all(change_on_tests(judge, tests, bare, bare, 1).per_joint == 0.0)


def test_a_joint_whose_floor_is_tiny_does_not_speak_for_the_others() -> None:
    spring = Effect("joint_spring", (SHOULDER,), {"stiffness": 2.0, "rest_position": 0.0}, {"shape": "linear"})
    # What comes with it at the elbow is wrong: about as much as the noise there, many times what its floor was said to
    # be.
    drag = Effect("viscous_friction", (ELBOW,), {"viscous_coefficient": 0.02})
    judge, _ = judged([spring])
    blind = replace(judge, floor=judge.floor * np.array([1.0, 1e-4]))
    blind = replace(blind, evidence=blind.evidence.weigh(blind.floor))
    full, bare = Model(ROBOT).adding([spring, drag]), Model(ROBOT)
    change = change_on_tests(blind, judge.evidence.runs, full, bare, 1)
    assert change.per_joint[0] < -0.5
    assert change.per_joint[1] > 0.2
    assert not change.contradicts
    assert change.relative < 0
    # Control: what spoils one joint and helps none is contradicted.
    assert change_on_tests(blind, judge.evidence.runs, Model(ROBOT).adding([drag]), bare, 1).contradicts


def test_a_joint_ends_worse_only_where_the_test_can_tell(monkeypatch: pytest.MonkeyPatch) -> None:
    judge, _ = judged([])
    block, rate = judge.settings.block, 50.0

    def worse(times: int, off: float) -> list[bool]:
        """Of a test of ``times`` thrice a block, what is left now this and now that way; the elbow ``off`` by so
        much of it."""
        rows = int(block * rate)
        left, moved = np.tile(np.repeat([1.0, 1.0, -1.0], rows), times)[:, None] * np.ones(2), np.array([0.0, off])
        model = Model(ROBOT).adding([Effect("torque_offset", (ELBOW,), {"offset": off})])
        monkeypatch.setattr(confirm_module, "moving_errors", lambda m, _: [left + bool(m.effects) * moved])
        test: Any = SimpleNamespace(time=np.arange(len(left)) / rate, mask=np.ones(left.shape, bool))
        return [bool(w) for w in confirm_module.ends_worse(judge, Model(ROBOT), model, [test])]

    # Worse by 29 +- 42 %; the same of a long test is 29 +- 11 %; and what is far off shows in little.
    assert worse(1, 0.3) == [False, False]
    assert worse(10, 0.3) == [False, True]
    assert worse(1, 3.0) == [False, True]
    # Control: what is as sure, and hardly worse, is not worse.
    assert worse(1000, 0.03) == [False, False]


def test_a_name_that_spoils_its_own_joint_is_contradicted_whatever_the_others_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    judge, terms = judged([])
    block, rate = judge.settings.block, 50.0
    constant, full = plain("torque_offset", 1, terms), Model(ROBOT)

    def harms(times: int, off: float, term: Term = constant, moving: int = 1000, loud: float = 1.0) -> bool:
        """As above, of the elbow alone: the shoulder is now far better, now far worse with the name."""
        rows = int(block * rate)
        left = loud * np.tile(np.repeat([1.0, 1.0, -1.0], rows), times)[:, None] * np.ones(2)
        without = Model(ROBOT).adding([Effect("torque_offset", (ELBOW,), {"offset": 0.0})])
        elsewhere = 3.0 * np.resize(np.repeat([1.0, 0.0], rows), len(left))[:, None] * np.array([1.0, 0.0])
        moved = np.array([0.0, loud * off])
        monkeypatch.setattr(
            confirm_module, "moving_errors", lambda m, _: [left + moved - elsewhere if m is full else left + elsewhere]
        )
        mask = np.arange(len(left))[:, None] < np.array([len(left), moving])
        test: Any = SimpleNamespace(time=np.arange(len(left)) / rate, mask=mask)
        if times == 1 and loud == 1.0:
            assert not change_on_tests(judge, [test], full, without, 11).contradicts, "among all joints it drowns"
        change = confirm_module._harm_to_its_joint(judge, [test], full, without, term, 11)
        assert change is None or (change.alone and change.contradicts and change.relative > 0)
        return change is not None

    # Ten times as much left in five seconds, by seven standard errors; 4 times as much in 1.5 s, by 1.5 of them.
    assert harms(3, 2.5)
    assert not harms(1, 1.5)
    # A third more: 2.6 standard errors are little where eleven are asked; of a long test it is sure.
    assert not harms(10, 0.3)
    assert harms(1000, 0.3)
    # A hundredth more is sure, too, and no harm.
    assert not harms(10000, 0.015)
    # Nor is what stays far below the floor, or shows in a handful of rows.
    assert not harms(3, 2.5, loud=1e-3 * float(judge.floor[1]))
    assert not harms(3, 2.5, moving=10)
    # Controls: what helps; a rotor is asked as friction is; a link, whose doing shows on other joints, is not.
    assert not harms(1000, -0.3)
    assert harms(3, 2.5, plain("armature", 1, terms))
    assert not harms(3, 2.5, Term("link_mass", 1))


def test_an_effect_that_helps_its_joint_is_not_contradicted_by_another_joint(monkeypatch: pytest.MonkeyPatch) -> None:
    judge, terms = judged([])
    friction, body = plain("viscous_friction", 1, terms), Term("link_mass", 1)
    judge = judge.adding([body])
    said = confirm_module.TestChange(0.2, 0.01, True, np.array([0.4, -0.1]))
    monkeypatch.setattr(confirm_module, "test_change", lambda *_: said)
    fitted = refit(judge.evidence, [friction, body])
    found = Found([friction, body], fitted.x, [], [], [], judge.over(fitted.evidence), Model(ROBOT))
    confirmed = confirm_module.confirm(judge, Model(ROBOT), found.model(found.terms), found, judge.evidence.runs)
    assert confirmed.changes[body].contradicts
    assert not confirmed.changes[friction].contradicts
    assert body in confirmed.refused
    # Control: where its own joint is not better with it, what it does elsewhere counts.
    said = replace(said, per_joint=np.array([0.4, 0.0]))
    assert (
        confirm_module.confirm(judge, Model(ROBOT), found.model(found.terms), found, judge.evidence.runs)
        .changes[friction]
        .contradicts
    )


def _names(model: Model) -> list[Term]:
    return [e.term(ROBOT).as_finding for e in model.effects]


def test_what_spoils_its_own_joint_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    judge, terms = judged([])
    friction, constant = plain("viscous_friction", 1, terms), plain("torque_offset", 0, terms)
    fitted = refit(judge.evidence, [friction, constant])
    found = Found([friction, constant], fitted.x, [], [], [], judge.over(fitted.evidence), Model(ROBOT))
    full, silent = found.model(found.terms), confirm_module.TestChange(0.0, 1.0, False, np.zeros(2))
    monkeypatch.setattr(confirm_module, "test_change", lambda *_: silent)
    monkeypatch.setattr(confirm_module, "_unknown", lambda *_: None)
    harm = confirm_module.TestChange(7.0, 1.0, True, np.zeros(2), True)
    monkeypatch.setattr(confirm_module, "_harm_to_its_joint", lambda *given: harm if given[4] == friction else None)
    said = confirm_module.confirm(judge, Model(ROBOT), full, found, judge.evidence.runs)
    assert said.refused == (friction,)
    # What is told of it is what its own joint says.
    assert said.changes[friction] == harm
    told_apart: dict[str, Any] = {"indistinguishable_from": []}
    why = _why_not(ROBOT, friction, harm, [], told_apart, 2, "")
    assert why == "its joint is predicted better without it (+700.0 % mean square error with it)"
    assert _why_not(ROBOT, friction, replace(harm, alone=False), [], told_apart, 2, "").startswith("the test runs are")
    # The name that does the greatest harm goes first: without it the other may be right.
    other = replace(silent, relative=0.3, contradicts=True)

    def told(judge: Judge, tests: object, full: Model, without: Model, names: int) -> confirm_module.TestChange:
        return other if friction in _names(full) and constant not in _names(without) else silent

    monkeypatch.setattr(confirm_module, "test_change", told)
    assert confirm_module.confirm(judge, Model(ROBOT), full, found, judge.evidence.runs).refused == (friction,)
    # Control: where none does, none is.
    monkeypatch.setattr(confirm_module, "test_change", lambda *_: silent)
    monkeypatch.setattr(confirm_module, "_harm_to_its_joint", lambda *_: None)
    assert confirm_module.confirm(judge, Model(ROBOT), full, found, judge.evidence.runs).refused == ()


def test_runs_in_other_poses_are_not_predicted_from_each_other() -> None:
    # Whole runs are held out where each could be known from the rest; else parts of every run.
    judge, _ = judged([])
    first, second = judge.evidence.runs
    near = folds_of([first, second], LoopSettings())
    assert near.number == 2
    assert [set(near.blocks.run[own]) for own in near.own] == [{0}, {1}]
    far = folds_of([first, replace(second, q=second.q + 10.0)], LoopSettings())
    assert far.number == LoopSettings().time_folds
    assert all(set(far.blocks.run[own]) == {0, 1} for own in far.own)


def test_a_longer_step_stays_within_what_physics_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    # A coarse encoder makes steps long, and every one is tried at twice that; friction that drives must not come of it.
    effects = [
        Effect("time_delay", (), {"delay": 0.02}),
        Effect("viscous_friction", (SHOULDER,), {"viscous_coefficient": 0.02}),
    ]
    monkeypatch.setattr(augment, "UNDERSTATED", -np.inf)
    judge, terms = judged(effects, encoder_bits=12)
    late = [Term("time_delay"), *(t for t in terms if t.family().everywhere and not t.settings)]
    judge = judge.adding(late)
    x, layout = refit(judge.evidence, late).x, judge.evidence.layout(late)
    assert judge.evidence.constraints(layout).satisfied(x)


def test_a_spring_that_pushes_away_is_none_whatever_the_data_wants() -> None:
    away = [Effect("joint_spring", (SHOULDER,), {"stiffness": -2.0, "rest_position": 3.0}, {"shape": "linear"})]
    judge, _ = judged(away)
    springs = {s: Term("joint_spring", 0, (("shape", s),)) for s in ("linear", "sine")}
    judge = judge.adding(list(springs.values()))
    judge = judge.at([springs["linear"]])
    assert prune._forced(judge, [springs["linear"]]) == {springs["linear"]}
    # Control: what pulls back as softly is a spring, and a sine may have its rest anywhere.
    back = [replace(away[0], parameters={"stiffness": 2.0, "rest_position": 3.0})]
    other, _ = judged(back)
    other = other.adding(list(springs.values()))
    assert refit(other.evidence, [springs["linear"]]).x[0] == pytest.approx(2.0, rel=0.05)
    for some in (judge, other):
        assert not prune._forced(some.at([springs["sine"]]), [springs["sine"]])


def test_a_law_at_the_end_of_its_range_stands_for_something_else() -> None:
    def at(velocity: float) -> Term:
        return Term("stribeck_friction", 0, (("stribeck_velocity", velocity),))

    assert at_the_end([at(0.01), at(0.1), at(0.99), at(1.0)]) == [at(0.01), at(0.99), at(1.0)]
    assert at_the_end([Term("viscous_friction", 0)]) == []


def test_where_a_spring_rests_is_no_offset_beside_it() -> None:
    effects = [Effect("joint_spring", (SHOULDER,), {"stiffness": 2.0, "rest_position": 0.4}, {"shape": "linear"})]
    judge, terms = judged(effects)
    springs = {s: Term("joint_spring", 0, (("shape", s),)) for s in ("linear", "sine")}
    judge = judge.adding(list(springs.values()))
    constant = plain("torque_offset", 0, terms)
    assert joined([constant], springs["linear"]) == [springs["linear"]]
    judge = judge.at([springs["linear"]])
    assert complete(judge, [springs["linear"]], terms)[1] == [springs["linear"]]
    # Control: a spring on a crank has no mean torque, so a constant beside it is another cause.
    assert joined([constant], springs["sine"]) == [constant, springs["sine"]]


def test_in_the_end_plain_effects_are_as_sure_as_all_joints_ask_for() -> None:
    friction = Effect("viscous_friction", (ELBOW,), {"viscous_coefficient": 0.4})
    judge, terms = judged([friction])
    plainest = [t for t in terms if t.family().everywhere and not t.settings]
    level = judge.level(judge.evidence.n, len(judge.evidence.blocks))
    there, kept = prune.without_noise(judge, plainest, sure=True)
    sizes = prune.in_errors(there, kept, refit(there.evidence, kept).x)
    assert plain("viscous_friction", 1, terms) in kept
    assert min(sizes.values()) >= level > 1.0
    # Control: what is merely no result by itself stays otherwise.
    there, loose = prune.without_noise(judge, plainest)
    assert min(prune.in_errors(there, loose, refit(there.evidence, loose).x).values()) >= 1.0
    assert len(loose) > len(kept)


def test_a_curved_law_is_asked_against_what_it_may_stand_for() -> None:
    wanted = {"coulomb_torque": 0.4, "static_torque": 0.9, "stribeck_velocity": 0.15}
    judge, terms = judged([Effect("stribeck_friction", (ELBOW,), wanted)])
    names = ("coulomb_friction", "viscous_friction", "nonlinear_viscous_friction")
    chosen = [plain(name, 1, terms) for name in names]
    offered = [t for t in further_candidates(judge, chosen)[1] if t.effect == "stribeck_friction" and t.joint == 1]
    fitted = [float(t.options["stribeck_velocity"]) for t in offered]
    assert any(v == pytest.approx(0.15, rel=0.1) for v in fitted)
    # Control: where nothing curved is named, only the grid that a search starts from.
    other, terms = judged([Effect("viscous_friction", (ELBOW,), {"viscous_coefficient": 0.4})])
    _, plainly = further_candidates(other, [plain("viscous_friction", 1, terms)])
    assert {t.options["stribeck_velocity"] for t in plainly if t.effect == "stribeck_friction"} <= {0.03, 0.1, 0.3}


@pytest.mark.parametrize(("second", "spared"), [(1.05, True), (1.3, False)])
def test_what_is_simpler_spares_every_joint(second: float, spared: bool) -> None:
    judge, _ = judged([])
    judge = replace(judge, floor=np.ones(2))

    def held(*squares: float) -> Held:
        return SimpleNamespace(joint_errors=np.array(squares) * judge.evidence.samples)  # type: ignore[return-value]

    # The first joint gains as much as the second loses: on the whole they are as good.
    assert judge.spares(held(0.5, second), held(1.0, 1.0)) is spared
    # Below the floor a share of the floor counts: nothing else is known there.
    assert judge.spares(held(0.5, 0.1 + (second - 1.0)), held(0.5, 0.1)) is spared
    # And what the starting model was known to be off by is no news, on the joint where it was.
    known = replace(judge, misfit=np.array([0.0, 0.6]))
    assert known.spares(held(0.5, second), held(1.0, 1.0))
    assert known.spares(held(second, 0.5), held(1.0, 1.0)) is spared


def test_a_plainer_effect_is_no_excuse_for_what_it_leaves() -> None:
    spring = {"stiffness": 2.0, "rest_position": 0.4}
    judge, terms = judged([Effect("joint_spring", (SHOULDER,), spring, {"shape": "linear"})])
    term, constant = Term("joint_spring", 0, (("shape", "linear"),)), plain("torque_offset", 0, terms)
    judge = judge.adding([term])
    judge = judge.at([term])
    assert simplify(judge, [term], terms)[1] == [term]
    # Control: a constant torque is given back to the offset.
    other, terms = judged([Effect("torque_offset", (SHOULDER,), {"offset": 0.8})])
    other = other.adding([term])
    other = other.at([term])
    assert simplify(other, [term], terms)[1] == [constant]


def test_what_holds_no_special_case_costs_no_refit_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each re-fit takes all laws anew; a model of twenty names was re-fitted twenty times to ask nothing."""
    effects = [Effect("viscous_friction", (name,), {"viscous_coefficient": 0.8}) for name in (SHOULDER, ELBOW)]
    judge, terms = judged([*effects, Effect("torque_offset", (SHOULDER,), {"offset": 0.8})])
    chosen = [
        plain("viscous_friction", 0, terms),
        plain("viscous_friction", 1, terms),
        plain("torque_offset", 0, terms),
    ]
    asked: list[Sequence[Term]] = []

    def counted(evidence: Evidence, own: Sequence[Term], rounds: int = 3) -> Refit:
        asked.append(own)
        return refit(evidence, own, rounds)

    monkeypatch.setattr(trace_module, "refit", counted)
    assert simplify(judge, chosen, terms)[1] == chosen
    assert asked == [chosen]


def test_another_form_of_what_was_looked_for_is_asked_too() -> None:
    # Only this joint's row feels the other joint; from the beginning couplings of both rows are looked for.
    coupled = {"viscous_coefficient": 0.0, "coulomb_torque": 0.5, "armature": 0.0}
    form = {"from_joint": ELBOW, "rows": "own", "sign_of": "partner"}
    judge, terms = judged([Effect("joint_coupling", (SHOULDER,), coupled, form)])
    assert "own" not in {t.options.get("rows") for t in terms}
    found = find(judge, terms, lambda step: None).terms
    assert ("joint_coupling", 0, "own") in [(t.effect, t.joint, t.options.get("rows")) for t in found]


def test_what_takes_a_little_of_much_is_not_plainly_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    judge, terms = judged([Effect("viscous_friction", (SHOULDER,), {"viscous_coefficient": 1.0})])
    friction = plain("viscous_friction", 0, terms)
    judge = judge.at([friction])
    assert judge.plainly_needed([friction], friction, 1.0, 1.0)
    monkeypatch.setattr(Judge, "nibbles", lambda *_: True)
    assert not judge.plainly_needed([friction], friction, 1.0, 1.0)


@pytest.mark.parametrize("told", [False, True])
def test_a_parameter_that_differs_between_runs_is_told_where_it_matters_or_the_runs_were_found_to_differ(
    told: bool,
) -> None:
    # Surely different, and less than a floor apart.
    train = [
        noisy_log([Effect("viscous_friction", (ELBOW,), {"viscous_coefficient": c})], k, "train", 0.3)
        for k, c in ((1, 0.5), (2, 0.6))
    ]
    settings = LoopSettings()
    logs = read_motion(ROBOT, train, [], settings)
    judge, terms, _ = gather(Model(ROBOT), logs, settings)
    friction = plain("viscous_friction", 1, terms)
    judge = judge.at([friction])
    found = inconsistent(judge, [friction], judge.evidence.fit([friction]), [friction] if told else [])
    if not told:
        assert found == {}
        return
    (entry,) = found[friction]
    values = [run["value"] for run in entry["runs"]]
    assert values == pytest.approx([0.5, 0.6], abs=3 * max(run["std_error"] for run in entry["runs"]))
