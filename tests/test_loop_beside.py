"""What is estimated, told and never named: a constant torque beside all links, and friction that is not sure enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.small_arm import URDF, arm, heavier_links

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.effects.base import HELD
from hybrid_dynamics.effects.together import together
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.export.source import Source
from hybrid_dynamics.loop import LoopSettings, Model, close_loop, prune
from hybrid_dynamics.loop import beside as beside_module
from hybrid_dynamics.loop import confirm as confirm_module
from hybrid_dynamics.loop import find as find_module
from hybrid_dynamics.loop.augment import model_of, refit
from hybrid_dynamics.loop.beside import EXPECTED, beside_links, beside_names
from hybrid_dynamics.loop.diagnosis import errors_of
from hybrid_dynamics.loop.found import Found
from hybrid_dynamics.loop.held import Held
from hybrid_dynamics.loop.model import load_model
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.excitation import excitations

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
#: The same arm for runs in few poses.
FEW_POSES = Robot.from_text(URDF.replace('lower="-2.5" upper="2.5"', 'lower="0.6" upper="1.4"'), "few poses")


def judged(effects: list[Effect]) -> tuple[Judge, list[Term], list[Run]]:
    """Evidence of one run in few poses, the term of all links, and runs in all poses."""
    settings = LoopSettings()
    train, _ = excitations(FEW_POSES, effects, train=1, test=0, duration=8.0, rate=250.0)
    _, test = excitations(ROBOT, effects, train=0, test=2, duration=8.0, rate=250.0)
    logs = read_motion(ROBOT, train, test, settings)
    judge, terms, _ = gather(Model(ROBOT), logs, settings)
    return judge, [t for t in terms if t.family().all_links], logs.test


def test_what_a_search_had_found_is_held_within_its_size_where_that_is_more() -> None:
    judge, (every,), _ = judged([Effect("torque_offset", (SHOULDER,), {"offset": 9.0})])
    size = judge.evidence.problem.torque_size[0]
    places = {t.joint: t.place for t in beside_links(judge, [every])[1]}
    expected = EXPECTED * size
    for found, within in (
        ({}, expected),
        ({places[0]: 9.0}, 9.0),
        ({places[0]: 1e-3}, expected),
        ({places[1]: 9.0}, expected),
    ):
        _, beside = beside_links(judge, [every], found)
        held = {t.joint: t.options[HELD] for t in beside}
        assert held[0] == pytest.approx(within, rel=5e-3)
    # The fit follows: held as near as others are, part of the offset goes into the links.
    values = []
    for found in ({}, {places[0]: 9.0}):
        there, beside = beside_links(judge, [every], found)
        model = model_of(there.evidence, [every, *beside], False)
        values += [
            e.parameters["offset"] for e in model.effects if e.effect == "torque_offset" and e.joints == (SHOULDER,)
        ]
    assert abs(values[1] - 9.0) < abs(values[0] - 9.0)


def errors(judge: Judge, chosen: list[Term], beside: list[Term], test: list[Run]) -> tuple[Model, float]:
    """Completed model, and its error [N m] at the shoulder in all poses."""
    fitted = refit(judge.evidence.adding(beside), chosen)
    found = Found(chosen, fitted.x, [], [], [], judge.over(fitted.evidence), judge.evidence.base, beside)
    model = found.model(chosen)
    return model, errors_of(model, test)["rmse"][0]


@pytest.mark.parametrize("offset", [1.5, -1.5])
def test_an_offset_beside_the_links_keeps_other_poses_right(offset: float) -> None:
    judge, chosen, test = judged([heavier_links(0.15), Effect("torque_offset", (SHOULDER,), {"offset": offset})])
    judge, beside = beside_links(judge, chosen)
    assert [(t.effect, t.joint) for t in beside] == [("torque_offset", 0), ("torque_offset", 1)]
    model, error = errors(judge, chosen, beside, test)
    own = [e for e in model.effects if not e.is_finding]
    assert [e.joints for e in own] == [(SHOULDER,), (ELBOW,)]
    for effect, true in zip(own, (offset, 0.0), strict=True):
        assert effect.parameters["offset"] == pytest.approx(true, abs=2 * effect.std_errors["offset"])
    # Control: without it the links take it up, and what they weigh elsewhere is wrong by about its size.
    _, without = errors(judge, chosen, [], test)
    assert without > 0.4 * abs(offset)
    assert error < 0.5 * without


def test_where_there_is_none_it_stays_within_its_error() -> None:
    judge, chosen, test = judged([heavier_links(0.15)])
    judge, beside = beside_links(judge, chosen)
    model, error = errors(judge, chosen, beside, test)
    for effect in (e for e in model.effects if not e.is_finding):
        assert abs(effect.parameters["offset"]) < 2 * effect.std_errors["offset"]
    # What it costs is no more than what the data leaves open.
    (shoulder, _) = (e.std_errors["offset"] for e in model.effects if not e.is_finding)
    assert error < shoulder


def test_beside_single_causes_nothing_is_estimated() -> None:
    judge, (every,), _ = judged([heavier_links(0.15)])
    single = [t for t in judge.evidence.terms if t.effect in ("viscous_friction", "torque_offset")]
    assert beside_links(judge, single) == (judge, [])
    named = [t for t in single if t.effect == "torque_offset" and t.joint == 0]
    assert [t.joint for t in beside_links(judge, [every, *named])[1]] == [1]
    # It is no part of the model without the links.
    judge, held = beside_links(judge, [every])
    fitted = refit(judge.evidence, [every, *single])
    found = Found([every, *single], fitted.x, [], [], [], judge.over(fitted.evidence), judge.evidence.base, held)
    assert [e.is_finding for e in found.model([every]).effects] == [True, False, False]
    assert all(e.is_finding for e in found.model(single).effects)
    assert len(found.model(single).effects) == len(single)


def test_it_is_told_kept_and_not_named(tmp_path: Path) -> None:
    hidden = [heavier_links(0.15), Effect("torque_offset", (SHOULDER,), {"offset": 0.3})]
    train, _ = excitations(FEW_POSES, hidden, train=2, test=0, duration=8.0, rate=250.0)
    _, test = excitations(ROBOT, hidden, train=0, test=1, duration=8.0, rate=250.0)
    result = close_loop(ROBOT, train, test, LoopSettings(effects=("inertial_parameters", "torque_offset")))
    assert [e.effect.effect for e in result.diagnosis.effects] == ["inertial_parameters"]
    kept = [e for e in result.model.effects if not e.is_finding]
    assert [(e.effect, e.joints) for e in kept] == [("torque_offset", (SHOULDER,)), ("torque_offset", (ELBOW,))]
    (note,) = [line for line in result.diagnosis.notes if "no finding" in line]
    for effect in kept:
        assert f"torque_offset of {effect.joints[0]} {effect.parameters['offset']:.3g} +- " in note
    result.model.save(tmp_path / "model.json")
    again = load_model(tmp_path / "model.json", ROBOT)
    assert [e.settings for e in again.effects if not e.is_finding] == [e.settings for e in kept]
    run = test[0]
    zero = np.zeros_like(run["q"])
    np.testing.assert_allclose(again.predict(run["q"], zero, zero), result.model.predict(run["q"], zero, zero))


@pytest.mark.parametrize("moved", [0.0, 1.0])
def test_what_has_changed_since_is_a_finding(moved: float) -> None:
    # The model of the last calibration holds an offset that was none: what is added to it is named, or it is not there.
    held = Effect("torque_offset", (SHOULDER,), {"offset": 0.3}, {HELD: 1.5}, {"offset": 0.2})
    start = Model(ROBOT, (heavier_links(0.15), held))
    hidden = [heavier_links(0.15), Effect("torque_offset", (SHOULDER,), {"offset": 0.3 + moved})]
    train, test = excitations(ROBOT, hidden, train=2, test=1, duration=8.0, rate=250.0)
    result = close_loop(ROBOT, train, test, start=start)
    found = [e.effect for e in result.diagnosis.effects]
    assert [(e.effect, e.joints, dict(e.settings)) for e in found] == [("torque_offset", (SHOULDER,), {})] * bool(moved)
    for effect in found:
        assert effect.parameters["offset"] == pytest.approx(moved, abs=3 * effect.std_errors["offset"])
        (change,) = [line for line in result.diagnosis.notes if "since the starting model" in line]
        assert change.startswith(f"torque_offset of {SHOULDER}: offset changed from 0.3 to 1.")
    assert result.model.effects[: len(start.effects)] == start.effects


@pytest.mark.parametrize(("joints", "whose"), [((), "all joints"), ((SHOULDER,), SHOULDER)])
def test_gains_multiply_and_so_they_are_told(joints: tuple[str, ...], whose: str) -> None:
    start = Model(ROBOT, (Effect("torque_gain", joints, {"gain": 1.2}),))
    train, test = excitations(
        ROBOT, [Effect("torque_gain", joints, {"gain": 1.8})], train=2, test=1, duration=8.0, rate=250.0
    )
    result = close_loop(ROBOT, train, test, start=start)
    (change,) = [e.effect for e in result.diagnosis.effects]
    assert (change.effect, change.joints) == ("torque_gain", joints)
    assert change.parameters["gain"] == pytest.approx(1.5, rel=0.01)
    (told,) = [line for line in result.diagnosis.notes if "since the starting model" in line]
    assert told.startswith(f"torque_gain of {whose}: gain changed from 1.2 to 1.")
    assert float(told.split(" to ")[1].split()[0]) == pytest.approx(1.8, rel=0.01)
    # As one effect they read the torque as the two do one after the other.
    (whole,) = together(result.model.effects, ROBOT)
    assert whole.parameters["gain"] == pytest.approx(1.2 * change.parameters["gain"])


def test_the_size_it_is_held_within_is_positive() -> None:
    with pytest.raises(InputError, match=r"held_within is 0\.0; expected a number > 0"):
        Effect("torque_offset", (ELBOW,), {"offset": 0.1}, {HELD: 0.0})


@pytest.mark.parametrize(
    ("settings", "told"), [({HELD: 0.2}, "torque_offset (elbow, no finding)"), ({}, "torque_offset (elbow)")]
)
def test_an_export_says_what_is_no_finding(settings: dict[str, float], told: str) -> None:
    model = Model(ROBOT, (Effect("torque_offset", (ELBOW,), {"offset": 0.1}, settings),))
    head = Source(model, Path("arm.urdf")).head("c")
    assert any(line.strip().startswith(f"{told}: offset 0.1 N m") for line in head)


DRY = Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 1.0})
VISCOUS = Effect("viscous_friction", (ELBOW,), {"viscous_coefficient": 0.4})


def offered(hidden: list[Effect], named: list[Term]) -> tuple[Judge, list[Term]]:
    """The judge of two runs at ``named``, and what may be named."""
    settings = LoopSettings()
    train, test = excitations(ROBOT, hidden, train=2, test=1, duration=8.0, rate=250.0)
    judge, terms, _ = gather(Model(ROBOT), read_motion(ROBOT, train, test, settings), settings)
    return judge.adding(named).at(named), terms


def unsure(hidden: list[Effect], named: list[Term], found: Sequence[Term] = ()) -> tuple[Judge, list[Term]]:
    """What is estimated beside ``named``, of what is ``hidden`` in two runs; ``found``: too unsure to be kept."""
    judge, terms = offered(hidden, named)
    return beside_names(judge, named, terms, found)


def test_what_held_out_rows_miss_is_estimated_and_not_named() -> None:
    named = [DRY.term(ROBOT)]
    judge, beside = unsure([DRY, VISCOUS], named)
    (held,) = (t for t in beside if t.effect == "viscous_friction")
    assert held.joint == 1
    fitted = refit(judge.evidence, named)
    found = Found(named, fitted.x, [], [], [], judge, judge.evidence.base, beside)
    model = found.model(named)
    (effect,) = (e for e in model.effects if e.effect == "viscous_friction")
    assert effect.parameters["viscous_coefficient"] == pytest.approx(0.4, rel=0.05)
    assert not effect.is_finding
    assert [e.effect for e in found.named(model)] == ["coulomb_friction"]
    # Held within a tenth of the joint's torque: the parameter that makes so much of it.
    run = judge.evidence.runs[0]
    share = held.options[HELD] * np.sqrt(np.mean(run.dq[:, 1] ** 2) / np.mean(run.tau[:, 1] ** 2))
    assert share == pytest.approx(0.1, rel=0.3)


def test_where_nothing_is_missed_or_nothing_is_named_nothing_is_estimated() -> None:
    named = [DRY.term(ROBOT)]
    assert unsure([DRY], named)[1] == []
    assert unsure([DRY, VISCOUS], [*named, VISCOUS.term(ROBOT)])[1] == []
    assert unsure([VISCOUS], [])[1] == []


def test_beside_all_links_everything_plain_is_in_where_something_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Least squares has it on every joint; left out, the links take it up, and other motions are predicted wrongly."""
    monkeypatch.setattr(beside_module, "_missed", lambda *_: False)
    heavier = heavier_links(0.1)
    named = [heavier.term(ROBOT)]
    hidden = [heavier, DRY, VISCOUS]
    _, found = unsure(hidden, named)
    assert ("viscous_friction", 1) in {(t.effect, t.joint) for t in found}
    assert all(HELD in t.options for t in found)
    # What has a name already does not come twice; where nothing is left nothing comes.
    joint = DRY.term(ROBOT).joint
    again = unsure(hidden, [*named, DRY.term(ROBOT)])[1]
    assert ("coulomb_friction", joint) not in {(t.effect, t.joint) for t in again}
    assert ("coulomb_friction", joint) in {(t.effect, t.joint) for t in found}
    assert unsure([heavier], named)[1] == []
    # Controls: beside single causes each is asked for; and held-out rows have the last word.
    assert unsure([DRY, VISCOUS], [DRY.term(ROBOT)])[1] == []
    monkeypatch.setattr(Judge, "as_good", lambda *_: False)
    assert unsure(hidden, named)[1] == []


def test_where_most_joints_are_left_everything_plain_is_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few seconds prove little: where hardly a joint is explained, what every arm has predicts better than nothing."""
    monkeypatch.setattr(beside_module, "_missed", lambda *_: False)
    rough = Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 0.4})
    twist = Effect("torque_offset", (SHOULDER,), {"offset": 0.5})
    named = [rough.term(ROBOT)]
    both = {(t.effect, t.joint) for t in unsure([rough, twist, VISCOUS], named)[1]}
    assert {("torque_offset", 0), ("viscous_friction", 1)} <= both
    # Control: one joint of two is left, and each is asked for by the rule by which a search takes it.
    assert unsure([rough, VISCOUS], named)[1] == []
    monkeypatch.setattr(Judge, "as_good", lambda *_: False)
    assert unsure([rough, twist, VISCOUS], named)[1] == []


def test_one_joint_does_not_keep_the_plain_effects_of_another_out(monkeypatch: pytest.MonkeyPatch) -> None:
    heavier = heavier_links(0.1)
    named = [heavier.term(ROBOT)]
    rough = [Effect(DRY.effect, (joint,), DRY.parameters) for joint in (SHOULDER, ELBOW)]
    judge, terms = offered([heavier, *rough], named)
    answers = iter([False, False])
    monkeypatch.setattr(Judge, "as_good", lambda *_: next(answers, True))
    # All of it, and then the first joint's, are refused: each of these is asked for, and the other joint's together.
    _, rest = beside_module._as_on_every_arm(judge, named, prune.on_every_joint(terms))
    assert {("coulomb_friction", 0), ("coulomb_friction", 1)} <= {(t.effect, t.joint) for t in rest}


def test_all_that_is_missing_is_asked_for_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Through the links each can stand for another's: refused one by one, they may all be there."""
    heavier = heavier_links(0.1)
    named = [heavier.term(ROBOT)]
    rough = [Effect(DRY.effect, (joint,), DRY.parameters) for joint in (SHOULDER, ELBOW)]
    judge, terms = offered([heavier, *rough], named)
    plain = prune.on_every_joint(terms)
    all_of_it = len(named) + len(beside_module.plain_beside(judge, named, plain)[1])
    asked: list[int] = []

    def as_good(_: Judge, new: Held, __: Held) -> bool:
        asked.append(max(len(x) for x in new.coordinates))
        return len(asked) == 1

    monkeypatch.setattr(Judge, "as_good", as_good)
    _, rest = beside_module._as_on_every_arm(judge, named, plain)
    assert asked == [named[0].size + all_of_it - 1]
    assert {("coulomb_friction", 0), ("coulomb_friction", 1)} <= {(t.effect, t.joint) for t in rest}


def test_what_one_joint_gains_together_pays_for_no_other_s_loss() -> None:
    """A torque of the elbow that is this way in one run and that way in the other is predicted worse by a constant."""
    settings = LoopSettings()
    dry = Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 1.5})
    thick = Effect("viscous_friction", (SHOULDER,), {"viscous_coefficient": 0.5})
    train, test = excitations(ROBOT, [dry, thick], train=2, test=1, duration=8.0, rate=250.0)
    for run, twist in zip(train, (-0.3, 0.3), strict=True):
        run.signals["tau"][:, 1] += twist
    named = [thick.term(ROBOT)]
    judge, terms, _ = gather(Model(ROBOT), read_motion(ROBOT, train, test, settings), settings)
    judge = judge.adding(named).at(named)
    plain = prune.on_every_joint(terms)
    there, missing = beside_module.plain_beside(judge, named, plain)
    before, whole = (there.evidence.held([*named, *more], physical=True) for more in ([], missing))
    assert there.as_good(whole, before), "on the whole it is better"
    _, rest = beside_module._as_on_every_arm(judge, named, plain)
    assert ("coulomb_friction", 0) in {(t.effect, t.joint) for t in rest}
    assert ("torque_offset", 1) not in {(t.effect, t.joint) for t in rest}


def test_what_physics_holds_at_nothing_is_not_estimated(monkeypatch: pytest.MonkeyPatch) -> None:
    heavier = heavier_links(0.1)
    named = [heavier.term(ROBOT)]
    judge, terms = offered([heavier], named)
    monkeypatch.setattr(Judge, "above_floor", lambda *_: np.ones(2, bool))
    monkeypatch.setattr(Judge, "as_good", lambda *_: True)
    judge, rest = beside_module._as_on_every_arm(judge, named, prune.on_every_joint(terms))
    # There is none: noise makes a little of some, and of the others less than none.
    assert len(rest) < len(prune.on_every_joint(terms))
    x = refit(judge.evidence, [*named, *rest]).x
    assert np.all(np.abs(x[len(x) - len(rest) :]) > 1e-4 * np.array([t.options[HELD] for t in rest]))


@pytest.mark.parametrize("settings", [{}, {HELD: 1.5}])
def test_an_estimate_of_the_starting_model_may_become_less(settings: dict[str, float]) -> None:
    known = [Effect(e.effect, (ELBOW,), e.parameters, settings) for e in (DRY, VISCOUS)]
    train, test = excitations(ROBOT, [], train=2, test=1, duration=8.0, rate=250.0)
    start = Model(ROBOT, tuple(known))
    judge, terms, _ = gather(start, read_motion(ROBOT, train, test, LoopSettings()), LoopSettings())
    own = [next(t for t in terms if t.effect == e.effect and t.joint == 1) for e in known]
    assert all(map(judge.evidence.in_base, own))
    # None of it is there any more: all of it goes.
    gone = [-next(iter(e.parameters.values())) for e in known]
    assert judge.evidence.fit(own) == pytest.approx(gone, rel=0.05)


def test_what_was_let_go_of_comes_back_together_where_it_is_missed() -> None:
    named, rough = [DRY.term(ROBOT)], Term("coulomb_friction", 1)
    lost = [rough, VISCOUS.term(ROBOT)]
    hidden = [DRY, VISCOUS, Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 0.3})]
    # In the order and with the settings in which they had been found: a search would take the viscous friction first.
    _, beside = unsure(hidden, named, lost)
    assert [replace(t, settings=()) for t in beside[:2]] == lost
    assert all(HELD in t.options for t in beside)
    assert unsure(hidden, named)[1][0].effect == "viscous_friction"
    # Control: where nothing is missed nothing comes back, and what a name makes already does not either.
    assert unsure([DRY], named, lost)[1] == []
    uneven = Effect(
        "asymmetric_coulomb_friction", (ELBOW,), {"coulomb_torque_positive": 0.5, "coulomb_torque_negative": 0.1}
    )
    lost = [rough, Term("torque_offset", 1), VISCOUS.term(ROBOT)]
    _, beside = unsure([DRY, VISCOUS, uneven], [*named, uneven.term(ROBOT)], lost)
    assert {t.effect for t in beside} == {"viscous_friction"}


@pytest.mark.parametrize(("sure", "verdict"), [(True, "explained"), (False, "partly_explained")])
def test_an_arm_is_not_explained_by_what_has_no_name(monkeypatch: pytest.MonkeyPatch, sure: bool, verdict: str) -> None:
    def doubting(judge: Judge, current: list[Term], **given: bool) -> tuple[Judge, list[Term]]:
        return prune.without_noise(judge, [t for t in current if sure or t.joint != 1], **given)

    monkeypatch.setattr(find_module, "without_noise", doubting)
    monkeypatch.setattr(find_module, "complete", lambda judge, chosen, *given: (judge, list(chosen)))
    train, test = excitations(ROBOT, [DRY, VISCOUS], train=2, test=1, duration=8.0, rate=250.0)
    result = close_loop(ROBOT, train, test)
    assert result.diagnosis.verdict == verdict
    told = [line for line in result.diagnosis.notes if "too unsure to be named" in line]
    assert [f"viscous_friction of {ELBOW} 0." in line for line in told] == ([] if sure else [True])
    # With a name or without, the test runs are predicted as well.
    after = result.diagnosis.error_moving["test"].after_confirmed
    assert after is not None
    assert after.rmse[1] < 1.1 * result.diagnosis.noise_floor_high[1]


TWIST = Effect("torque_offset", (ELBOW,), {"offset": 0.5})


@pytest.mark.parametrize("refusing", [False, True], ids=["it predicts better", "it does not"])
@pytest.mark.parametrize("wrong", ["torque_offset", "inertial_parameters"])
def test_what_is_contradicted_leaves_its_place_to_friction(
    monkeypatch: pytest.MonkeyPatch, wrong: str, refusing: bool
) -> None:
    right = DRY.term(ROBOT)
    judge, terms = offered([DRY, VISCOUS, TWIST], [right])
    lost = next(t for t in terms if t.effect == wrong and t.joint in (None, 1))
    named = [right, lost]
    judge = judge.adding(named).at(named)
    found = Found(named, refit(judge.evidence, named).x, [], [], [], judge, judge.evidence.base)
    full = found.model(named)
    change = confirm_module.TestChange

    def asked(_: Judge, __: object, model: Model, without: Model, names: int) -> confirm_module.TestChange:
        # The tests speak against the wrong name, and of what comes in its place as they are told to.
        here, there = ({e.effect for e in m.effects if e.is_finding} for m in (model, without))
        if names == 1 and here == there:
            return change(0.5 if refusing else -0.5, 0.01, False, np.zeros(2))
        against = wrong in here - there
        return change(0.5 * against, 0.01, against, np.full(2, 0.5 * against))

    monkeypatch.setattr(confirm_module, "test_change", asked)
    said = confirm_module.confirm(judge, Model(ROBOT), full, found, judge.evidence.runs, terms)
    assert said.refused == (lost,)
    assert [(e.effect, e.joints) for e in said.model.effects if e.is_finding] == [("coulomb_friction", (SHOULDER,))]
    own = {(e.effect, e.joints) for e in said.model.effects if not e.is_finding}
    # What is contradicted does not come back without a name; what stood in its place besides does.
    expected = {("viscous_friction", (ELBOW,)), ("torque_offset", (ELBOW,))} - {(wrong, (ELBOW,))}
    assert (expected <= own) == bool(own) == (not refusing)
    assert (wrong, (ELBOW,)) not in own
    # Control: what is not contradicted stands as it was found.
    monkeypatch.setattr(confirm_module, "test_change", lambda *_: change(0.0, 0.01, False, np.zeros(2)))
    again = confirm_module.confirm(judge, Model(ROBOT), full, found, judge.evidence.runs, terms)
    assert again.model.effects == full.effects


def test_what_comes_in_that_place_makes_no_joint_worse_than_it_began(monkeypatch: pytest.MonkeyPatch) -> None:
    right = DRY.term(ROBOT)
    judge, terms = offered([DRY, VISCOUS], [right])
    found = Found([right], refit(judge.evidence, [right]).x, [], [], [], judge, judge.evidence.base)
    model, base = found.model([right]), Model(ROBOT)
    change = confirm_module.TestChange
    for worse, taken in ((0.0, True), (0.2, False)):

        def asked(_: object, __: object, new: Model, old: Model, ___: int, worse: float = worse) -> object:
            grown = worse if old is base and new is not model else 0.0
            return change(-0.5, 0.01, False, np.array([0.0, grown]))

        monkeypatch.setattr(confirm_module, "test_change", asked)
        runs = judge.evidence.runs
        _, other = confirm_module._filled(judge, base, found, [right], model, runs, terms)
        assert (other is not model) == taken
