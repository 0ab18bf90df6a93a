"""Blind cases from another engine hold what their truth says, in the size that it says."""

from typing import Any

import numpy as np
import pytest

from hybrid_dynamics.effects import Effect, family
from hybrid_dynamics.loop.model import Model, effect_from_json, effect_to_json
from hybrid_dynamics.robots import find_description
from hybrid_dynamics.study.blind import BlindSettings
from hybrid_dynamics.study.blind_logs import LogSettings, log_settings, noise_level
from hybrid_dynamics.study.blind_score import score_blind
from hybrid_dynamics.study.engine import read_text, robot_of
from hybrid_dynamics.study.foreign import RECIPES, UNKNOWN
from hybrid_dynamics.study.foreign_cases import make_foreign, plan_foreign, recorded
from hybrid_dynamics.study.mujoco_log import motions_of, read

TEXT = read_text(find_description("ur_description/urdf/ur5_joint_limited_robot.urdf"))
ROBOT = robot_of(TEXT)
SHORT = LogSettings(train=1, test=0, duration=4.0, rate=500.0, noise="none", encoder_bits=0)


@pytest.mark.parametrize("name", [r.name for r in RECIPES.values() if r.known])
def test_the_truth_of_a_known_form_predicts_its_torque(name):
    hidden = RECIPES[name].draw(np.random.default_rng(1))(ROBOT, 2, 1.0)
    ((course, tau),) = motions_of(TEXT, [hidden], SHORT, 3)
    signals = read(course, tau, [hidden], SHORT, np.zeros(6), np.random.default_rng(0))
    states = (signals["q"], course.dq, course.ddq)
    added = signals["tau"] - ROBOT.inverse_dynamics(*states)
    left = signals["tau"] - Model(ROBOT, tuple(RECIPES[name].truth(ROBOT, hidden))).predict(*states, course.time)
    # Dahl's and LuGre's memory differs by half a sample between the two integrations, a delay by its first sample,
    # and MuJoCo's friction loss turns over within a nanometre per second at rest.
    assert np.std(left) < (0.05 if name in ("dahl", "lugre", "delay", "coulomb", "gear") else 1e-6) * np.std(added)


def test_unknown_forms_have_no_truth_and_as_many_cases_hold_one_as_are_asked_for():
    strange = [r for r in UNKNOWN if r.name not in ("tanh", "lugre")]  # settings of a family
    assert all(not r.known and r.truth(ROBOT, r.draw(np.random.default_rng(0))(ROBOT, 1, 1.0)) == [] for r in strange)
    cases = plan_foreign(BlindSettings(foreign=30, unknown=10), "ur5")
    assert cases == plan_foreign(BlindSettings(foreign=30, unknown=10), "ur5")
    assert cases != plan_foreign(BlindSettings(foreign=30, unknown=10, seed=1), "ur5")
    unknown = [any(RECIPES[name] in UNKNOWN for name in case) for case in cases]
    assert sum(unknown) == 10
    assert {len(case) for case in cases} >= {1, 2, 3}
    bare = plan_foreign(BlindSettings(foreign=30, unknown=10, bare=4), "ur5")
    assert sorted(bare) == sorted([*cases, *[()] * 4])
    assert bare[-4:] != [()] * 4  # where nothing is missing is not to be known from the number


def test_two_harmonics_of_a_joint_are_two_ripples_and_one_of_them_is_half_the_truth():
    settings = BlindSettings(smallest=6.0, largest=6.0, test=1)
    log = LogSettings(train=1, test=1, duration=4.0)
    case = make_foreign(TEXT, ("two harmonics",), settings, "ur5_m002", "ur5", log)
    assert [e["effect"] for e in case.truth["effects"]] == ["torque_ripple"] * 2
    size = [1.0] * 6
    said: dict[str, Any] = {
        "effects": [e | {"indistinguishable_from": [], "confirmed": True} for e in reversed(case.truth["effects"])],
        "verdict": "explained",
        "error": {"test": {"after_confirmed": {"rmse": size}}},
        "error_moving": {"test": {"before": {"rmse": size}, "after_confirmed": {"rmse": size}}},
        "noise_floor": size,
        "not_identifiable": [
            {
                "joint": "elbow_joint",
                "why": "its torque never changes in the training runs; its effects are not sought",
            },
            {"joint": "wrist_1_joint", "why": "the joint never moves in the training runs; its effects are not sought"},
        ],
    }
    row = score_blind(case.truth, said, ROBOT, case.train, case.test)
    assert row["silent"] == "elbow_joint"
    # A refusal is an answer, too: nothing was named.
    refused = score_blind(case.truth, {"refused": "joint elbow_joint: wrong sign"}, ROBOT, case.train, case.test)
    assert refused["verdict"] == "refused"
    assert refused["outcomes"] == "missed missed"
    assert refused["rmse_after"] == refused["rmse_before"] > 1.5 * refused["rmse_true_model"]
    # Named in the other order: each is compared with its own.
    assert row["named_right"]
    assert row["nothing_wrong_named"]
    assert row["parameter_error"] < 1e-9
    half = score_blind(case.truth, said | {"effects": [said["effects"][0]]}, ROBOT, case.train, case.test)
    assert not half["named_right"]
    assert half["nothing_wrong_named"]
    # What the test runs contradicted is not named: told, but not in the model.
    wrong = said["effects"][0] | {"joints": ["elbow_joint"]}
    for confirmed in (True, False):
        more = said | {"effects": [*said["effects"], wrong | {"confirmed": confirmed}]}
        row = score_blind(case.truth, more, ROBOT, case.train, case.test)
        assert row["nothing_wrong_named"] == (not confirmed)


def test_an_effect_named_for_another_law_of_its_own_is_told_apart_from_a_wrong_name():
    settings = BlindSettings(smallest=6.0, largest=6.0, test=1)
    log = LogSettings(train=1, test=1, duration=4.0)
    case = make_foreign(TEXT, ("stribeck 1/2",), settings, "ur5_m003", "ur5", log)
    ((joint,),) = [u["joints"] for u in case.truth["unknown_forms"]]
    size = [1.0] * 6

    def score(name: str, joint: str, *listed: str) -> tuple[str, str, str]:
        own = [{"effects": [{"effect": other, "joints": [joint]}]} for other in listed]
        values = dict.fromkeys(family(name).published({}), 1.0)
        effect = effect_to_json(Effect(name, (joint,), values))
        said: dict[str, Any] = {
            "effects": [effect | {"indistinguishable_from": own, "confirmed": True}],
            "verdict": "explained",
            "error": {"test": {"after_confirmed": {"rmse": size}}},
            "error_moving": {"test": {"before": {"rmse": size}, "after_confirmed": {"rmse": size}}},
            "noise_floor": size,
        }
        row = score_blind(case.truth, said, ROBOT, case.train, case.test)
        assert not row["nothing_wrong_named"]
        return row["other_laws"], row["stand_ins"], row["wrong"]

    other = next(name for name in ROBOT.joint_names if name != joint)
    assert score("stribeck_friction", joint) == (f"stribeck_friction@{joint}", "", "")
    assert score("stribeck_friction", other) == ("", "", f"stribeck_friction@{other}")
    assert score("armature", joint) == ("", "", f"armature@{joint}")
    assert score("coulomb_friction", joint, "stribeck_friction") == ("", f"coulomb_friction@{joint}", "")
    assert score("coulomb_friction", joint, "armature") == ("", "", f"coulomb_friction@{joint}")


def test_a_case_is_as_large_as_its_truth_says_and_tells_nothing_in_its_name():
    settings = BlindSettings(smallest=4.0, largest=4.0, test=1)
    case = make_foreign(TEXT, ("coulomb",), settings, "ur5_m001", "ur5", LogSettings(train=1, test=1, duration=5.0))
    assert case.truth["size_over_floor"] == pytest.approx(4.0)
    effect = effect_from_json(case.truth["effects"][0])
    joint = ROBOT.joint_names.index(effect.joints[0])
    ratio = effect.parameters["coulomb_torque"] / case.truth["true_rmse"][joint]
    # Friction is there whenever the joint moves: its root mean square is its torque but for the rest at both ends.
    assert 4.0 <= ratio < 4.6
    again = make_foreign(TEXT, ("coulomb",), settings, "ur5_m001", "ur5", LogSettings(train=1, test=1, duration=5.0))
    np.testing.assert_array_equal(case.train[0]["tau"], again.train[0]["tau"])
    assert "coulomb" not in case.name
    assert case.truth["engine"] == "mujoco"


def test_the_noise_that_counts_is_what_the_filter_leaves():
    rng = np.random.default_rng(0)
    seen = {log_settings(BlindSettings(), rng).noise for _ in range(40)}
    assert seen == {"white", "ar1", "lowpass", "quantised"}
    effort = np.ones(2)
    white, slow = (noise_level(LogSettings(noise=kind), effort) for kind in ("white", "ar1"))
    assert np.all(slow > 1.5 * white)  # what is correlated over 20 ms passes a filter of 25 Hz
    assert np.abs(recorded(TEXT, [], SHORT)).max() < 1e-9
