"""Blind cases of any family: as large as they say by what they alone explain, plausible, scored effect by effect."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.two_links import two_links

from hybrid_dynamics.effects import Effect, catalogue, family
from hybrid_dynamics.effects.inertia import link_parameters
from hybrid_dynamics.loop.model import Model, effect_from_json, effect_to_json
from hybrid_dynamics.loop.process import ProcessSettings, process
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.study.alone import alone, alone_sizes
from hybrid_dynamics.study.blind import BlindSettings
from hybrid_dynamics.study.blind_logs import LogSettings, log_settings, measured_level, noise_level, noisy
from hybrid_dynamics.study.blind_score import _stands_in, coverage_of, outcomes_of
from hybrid_dynamics.study.mixed_cases import make_mixed, plan_mixed
from hybrid_dynamics.study.park.added import add_effects, draw_added
from hybrid_dynamics.study.plausible import plausible
from hybrid_dynamics.trajectory import Trajectory

ROBOT = two_links()
ARM = Robot.from_urdf(find_description("ur_description/urdf/ur5_joint_limited_robot.urdf"))
CONF = Path(__file__).parents[1] / "conf/blind"
FAMILIES = ("viscous_friction", "coulomb_friction", "torque_offset", "armature", "torque_ripple")
STAND_INS = (("torque_offset", "offset"), ("coulomb_friction", "coulomb_torque"))
LOG = LogSettings(train=2, test=1, duration=6.0, rate=250.0, noise="ar1", velocity=True)


def test_all_families_are_planned_equally_often_one_to_four_at_once():
    settings = BlindSettings(families=FAMILIES, mixed=40, bare=5)
    cases = plan_mixed(ROBOT, settings)
    assert cases == plan_mixed(ROBOT, settings)
    assert len(cases) == 45
    assert cases.count(()) == 5
    assert {len(case) for case in cases} == {0, 1, 2, 3, 4}
    counts = [sum(case.count(name) for case in cases) for name in FAMILIES]
    assert max(counts) - min(counts) <= 1


def test_the_full_study_is_what_it_says():
    full = yaml.safe_load((CONF / "full.yaml").read_text("utf-8"))
    own, robots = full["blind"], len(full["blind_robots"])
    per_robot = own["mixed"] + own["foreign"] + 2 * own["bare"] + own["single"] + own["pairs"] + own["nothing"]
    assert robots * per_robot == 400
    assert 2 * (own["foreign"] + own["bare"]) >= per_robot
    assert 3 * own["unknown"] >= per_robot
    # What is drawn is every entry of the catalogue but the law that is a text (make params writes a new one there).
    assert set(own["families"]) == set(catalogue(everything=True)) - {"symbolic_torque"}
    assert {name for name in catalogue(everything=True) if not family(name).hidden} == {"symbolic_torque"}
    development = yaml.safe_load((CONF / "development.yaml").read_text("utf-8"))["blind"]
    assert robots * (development["mixed"] + development["foreign"] + 2 * development["bare"]) == 120
    assert 3 * development["unknown"] >= 120 // robots
    assert development["seed"] != own["seed"]


@pytest.fixture(scope="module")
def log() -> Trajectory:
    """A run of the UR5, as it is."""
    how = LogSettings(train=1, test=1, duration=6.0)
    return make_mixed(ARM, (), BlindSettings(families=FAMILIES), "arm_x001", how).train[0]


@pytest.mark.parametrize("name", yaml.safe_load((CONF / "full.yaml").read_text("utf-8"))["added"]["families"])
def test_every_family_can_be_added_to_a_recorded_log_in_the_size_that_is_asked_for(name, log):
    base, floor = Model(ARM), 5e-4 * ARM.effort_limits
    effect = draw_added(ARM, base, name, [log], floor, 3.0, np.random.default_rng(2))
    (more,) = add_effects(base, [effect], [log])
    size = np.sqrt(np.mean((more["tau"] - log["tau"]) ** 2, axis=0)) / floor
    assert 2.4 < size.max() < 4.5  # not yet behind the loop's filter


def test_short_logs_are_drawn_where_they_are_asked_for():
    rng = np.random.default_rng(0)
    totals = [own.train * own.duration for _ in range(60) if (own := log_settings(BlindSettings(), rng))]
    assert min(totals) >= 29.0
    short = [log_settings(BlindSettings(short_logs=True), rng) for _ in range(60)]
    assert any(own.train * own.duration < 15 for own in short)
    assert all(5 <= own.duration <= 30 for own in short)


def test_a_case_is_logged_as_it_is_asked_for_and_its_effects_are_as_large_as_they_say():
    settings = BlindSettings(families=FAMILIES, smallest=5.0, largest=5.0)
    case = make_mixed(ROBOT, ("viscous_friction", "torque_offset"), settings, "arm_x001", LOG)
    again = make_mixed(ROBOT, ("viscous_friction", "torque_offset"), settings, "arm_x001", LOG)
    np.testing.assert_array_equal(case.train[0]["tau"], again.train[0]["tau"])
    assert [len(case.train), len(case.test)] == [2, 1]
    assert case.train[0].dt == pytest.approx(1 / 250)
    assert "dq" in case.train[0]
    effects = [effect_from_json(e) for e in case.truth["effects"]]
    assert [e.effect for e in effects] == ["viscous_friction", "torque_offset"]
    runs = [process(t, ROBOT, ProcessSettings()) for t in case.train]
    # The motion is controlled, not prescribed, and joints at rest do not count.
    assert alone_sizes(ROBOT, effects, runs, np.array(case.truth["true_rmse"])) == pytest.approx([5.0, 5.0], rel=0.35)


def test_what_others_can_make_counts_for_none_of_them():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 1000))
    assert alone(3 * a, [], 2) == pytest.approx(3.0, rel=0.1)
    assert alone(3 * a, [a[:, None]], 2) < 1e-9
    assert alone(3 * a + b, [a[:, None]], 2) == pytest.approx(1.0, rel=0.1)


def test_what_no_arm_has_is_not_hidden():
    assert plausible(ROBOT, [Effect("torque_gain", ("elbow",), {"gain": 1.2})])
    com = dict(
        zip(("com_x", "com_y", "com_z"), link_parameters(ROBOT, 1)[1:4] / link_parameters(ROBOT, 1)[0], strict=True)
    )
    for shift, there in ((0.1, True), (0.3, False)):
        assert plausible(ROBOT, [Effect("link_com", ("elbow",), com | {"com_z": com["com_z"] + shift})]) == there
    assert not plausible(ROBOT, [Effect("torque_gain", ("elbow",), {"gain": 3.0})])
    assert not plausible(ROBOT, [Effect("time_delay", (), {"delay": 0.1})])
    assert not plausible(ROBOT, [Effect("load_dependent_friction", ("elbow",), {"load_coefficient": 4.0})])
    assert not plausible(ROBOT, [Effect("viscous_friction", ("elbow",), {"viscous_coefficient": -1.0})])


def said(effect: Effect, *listed: list[Effect]) -> dict[str, Any]:
    others = [{"effects": [{"effect": e.effect, "joints": list(e.joints)} for e in group]} for group in listed]
    return effect_to_json(effect) | {"confirmed": True, "indistinguishable_from": others}


def test_an_effect_is_named_listed_or_missed_and_a_set_counts_as_a_whole():
    offset = Effect("torque_offset", ("elbow",), {"offset": 1.0})
    spring = Effect("joint_spring", ("elbow",), {"stiffness": 1.0, "rest_position": 0.0}, {"shape": "linear"})
    gain = Effect("torque_gain", ("elbow",), {"gain": 1.2})
    place = [(e.effect, e.joints) for e in (offset, spring, gain)]
    assert outcomes_of(place[:1], [said(offset)]) == ["named"]
    assert outcomes_of(place[1:2], [said(offset, [spring])]) == ["listed"]
    assert outcomes_of(place[2:], [said(offset, [spring])]) == ["missed"]
    # Two together are one explanation: half of it was not there.
    assert outcomes_of(place[1:2], [said(offset, [spring, gain])]) == ["missed"]
    assert outcomes_of(place[1:], [said(offset, [spring, gain])]) == ["listed", "listed"]
    # One of two alike.
    assert outcomes_of([place[0], place[0]], [said(offset)]) == ["named", "missed"]


def test_a_name_that_lists_what_was_hidden_stands_in_for_it():
    offset, coulomb = (Effect(f, ("elbow",), {p: 1.0}) for f, p in STAND_INS)
    hidden = [("asymmetric_coulomb_friction", ("elbow",))]
    both = {"coulomb_torque_positive": 1.0, "coulomb_torque_negative": 0.5}
    whole = Effect("asymmetric_coulomb_friction", ("elbow",), both)
    named = [said(offset, [whole]), said(coulomb)]
    assert _stands_in(("torque_offset", ("elbow",)), hidden, named)
    assert not _stands_in(("coulomb_friction", ("elbow",)), hidden, named)
    # What is named itself needs nobody to stand in for it.
    assert not _stands_in(("torque_offset", ("elbow",)), hidden, [*named, said(whole)])


def test_a_log_in_steps_is_as_rough_as_its_steps_where_the_torque_hardly_changes():
    log = LogSettings(rate=500.0, noise="quantised", noise_share=0.1)
    time = np.arange(5000)[:, None] / 500.0
    effort, rng = np.ones(1), np.random.default_rng(0)
    still, moving = 0.1 * np.sin(0.5 * time), 20 * np.sin(3 * time)
    assert measured_level([0.1 * still], [noisy(0.1 * still, log, effort, rng)], log, effort) == 0.05 * 12**0.5
    rough, fine = (measured_level([tau], [noisy(tau, log, effort, rng)], log, effort)[0] for tau in (still, moving))
    white = noise_level(log, effort)[0]
    assert fine == pytest.approx(white, rel=0.4)
    assert rough > 1.8 * white


def test_parameters_are_counted_within_two_of_their_standard_errors():
    true = {"effects": [effect_to_json(Effect("torque_offset", ("elbow",), {"offset": 1.0}))]}
    for error, within in ((0.1, 1), (0.04, 0)):
        found = Effect("torque_offset", ("elbow",), {"offset": 1.1}, std_errors={"offset": error})
        assert coverage_of(true, {"effects": [said(found)]}) == [(1, within)]
    other = Effect("torque_offset", ("shoulder",), {"offset": 1.1}, std_errors={"offset": 0.1})
    assert coverage_of(true, {"effects": [said(other)]}) == [(0, 0)]
    # A phase repeats.
    ripple = {"amplitude": 1.0, "harmonic": 9.0, "phase": 3.1}
    hidden = {"effects": [effect_to_json(Effect("torque_ripple", ("elbow",), ripple))]}
    turned = Effect("torque_ripple", ("elbow",), ripple | {"phase": -3.1}, std_errors={"phase": 0.05})
    assert coverage_of(hidden, {"effects": [said(turned)]}) == [(1, 1)]
