"""The loop on exact runs: it names what was planted and nothing else, and says what it cannot tell."""

import json

import numpy as np
import pytest

from hybrid_dynamics.cli.words import headline
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.effects.inertia import to_body, to_dynamic
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop import LoopSettings, Model, close_loop
from hybrid_dynamics.loop.diagnosis import Diagnosis
from hybrid_dynamics.loop_report.report import report_html
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation.excitation import excitation, excitations

SHORT = {"duration": 8.0}
BODY = {
    "mass": 0.8, "com_x": 0.03, "com_y": -0.02, "com_z": 0.1, "inertia_xx": 0.004, "inertia_xy": 0.0,
    "inertia_yy": 0.004, "inertia_xz": 0.0, "inertia_yz": 0.0, "inertia_zz": 0.003,
}  # fmt: skip


@pytest.fixture(scope="module")
def panda() -> Robot:
    return Robot.from_urdf(find_description("panda.urdf"), lock=("panda_finger_joint1", "panda_finger_joint2"))


def heavier_link(robot: Robot, joint: int) -> Effect:
    own = np.asarray(robot.model.inertias[robot.joint_ids[joint]].toDynamicParameters())
    return Effect("link_inertia", (robot.joint_names[joint],), to_body(own + to_dynamic(BODY)))


def named(diagnosis: dict) -> list[tuple[str, tuple[str, ...]]]:
    return [(e["effect"], tuple(e["joints"])) for e in diagnosis["effects"]]


PLANTED = {
    "viscous_friction": ("panda_joint2", {"viscous_coefficient": 2.0}),
    "coulomb_friction": ("panda_joint4", {"coulomb_torque": 1.5}),
    "torque_offset": ("panda_joint5", {"offset": -0.2}),
    "armature": ("panda_joint6", {"armature": 0.06}),
}


@pytest.mark.parametrize("name", [*PLANTED, "payload", "link_inertia", "gravity_tilt", "nothing"])
def test_each_family_planted_alone_is_named_and_nothing_else(name, panda):
    if name in PLANTED:
        joint, parameters = PLANTED[name]
        effects = [Effect(name, (joint,), parameters)]
    elif name == "payload":
        effects = [Effect("payload", (), BODY)]
    elif name == "link_inertia":
        effects = [heavier_link(panda, 3)]
    elif name == "gravity_tilt":
        effects = [Effect("gravity_tilt", (), {"roll": 0.03, "pitch": -0.02})]
    else:
        effects = []
    train, test = excitations(panda, effects, train=3, test=1, **SHORT)
    result = close_loop(panda, train, test)
    diagnosis = result.diagnosis.to_json()
    assert named(diagnosis) == [(e.effect, e.joints) for e in effects]
    assert diagnosis["verdict"] == ("explained" if effects else "nothing_missing")
    after = np.array(diagnosis["error_moving"]["test"]["after"]["rmse"])
    # The completed model is as good as the true one on runs neither has seen.
    truth = Model(panda, tuple(effects))
    run = result.test[0]
    error = run.tau - run.smooth(truth.predict(run.motion.q, run.motion.dq, run.motion.ddq))
    exact = np.sqrt((error**2 * run.mask).sum(axis=0) / run.mask.sum(axis=0))
    assert np.all(after <= 1.05 * exact)
    if name in PLANTED or name == "gravity_tilt":
        for parameter in diagnosis["effects"][0]["parameters"]:
            true = effects[0].parameters[parameter["name"]]
            assert parameter["value"] == pytest.approx(true, rel=0.02)
            assert abs(parameter["value"] - true) < 6 * parameter["std_error"]
    if name == "payload":
        values = {p["name"]: p["value"] for p in diagnosis["effects"][0]["parameters"]}
        assert values["mass"] == pytest.approx(BODY["mass"], rel=0.01)
        assert values["com_z"] == pytest.approx(BODY["com_z"], rel=0.02)
        other = diagnosis["effects"][0]["indistinguishable_from"][0]["effects"]
        assert other == [{"effect": "link_inertia", "joints": ["panda_joint7"]}]


def test_effects_that_mask_each_other_are_separated_with_the_same_bytes_every_time(panda):
    effects = [
        Effect("gravity_tilt", (), {"roll": 0.02, "pitch": 0.02}),
        Effect("torque_offset", ("panda_joint2",), {"offset": 2.0}),
        Effect("coulomb_friction", ("panda_joint2",), {"coulomb_torque": 1.5}),
        Effect("viscous_friction", ("panda_joint2",), {"viscous_coefficient": 1.5}),
    ]
    train, test = excitations(panda, effects, train=3, test=1, **SHORT)
    first = close_loop(panda, train, test)
    assert set(named(first.diagnosis.to_json())) == {(e.effect, e.joints) for e in effects}
    assert json.dumps(close_loop(panda, train, test).diagnosis.to_json()) == json.dumps(first.diagnosis.to_json())
    page = report_html(first)
    assert page == report_html(first)
    assert "gravity_tilt" in page
    # One step further, from the completed model, nothing is missing.
    again = close_loop(panda, train, test, start=first.model)
    assert again.diagnosis.to_json()["verdict"] == "nothing_missing"


def test_friction_that_grows_with_the_load_is_told_from_plain_friction(panda):
    effects = [
        Effect("payload", (), BODY),
        Effect("load_dependent_friction", ("panda_joint2",), {"load_coefficient": 0.08}),
        Effect("coulomb_friction", ("panda_joint4",), {"coulomb_torque": 1.5}),
    ]
    train, test = excitations(panda, effects, train=3, test=1, **SHORT)
    for run in (*train, *test):
        assert np.isfinite(run["tau"]).all()
    diagnosis = close_loop(panda, train, test).diagnosis.to_json()
    assert set(named(diagnosis)) == {(e.effect, e.joints) for e in effects}
    values = {e["effect"]: e["parameters"][0]["value"] for e in diagnosis["effects"]}
    assert values["load_dependent_friction"] == pytest.approx(0.08, rel=0.05)
    assert values["payload"] == pytest.approx(BODY["mass"], rel=0.02)


@pytest.mark.parametrize("width", [{}, {"sign_width": 0.02}], ids=["sharp", "a width that is no candidate"])
def test_friction_of_the_starting_model_that_became_less_is_named_and_stays_friction(width, panda, tmp_path):
    friction = Effect("coulomb_friction", ("panda_joint4",), {"coulomb_torque": 3.0}, width)
    worn_in = Effect("coulomb_friction", ("panda_joint4",), {"coulomb_torque": 2.2}, width)
    train, test = excitations(panda, [worn_in], train=3, test=1, **SHORT)
    result = close_loop(panda, train, test, start=Model(panda, (friction,)))
    assert named(result.diagnosis.to_json()) == [("coulomb_friction", ("panda_joint4",))]
    change = result.diagnosis.to_json()["effects"][0]["parameters"][0]
    assert change["value"] == pytest.approx(-0.8, rel=0.02)
    told = next(n for n in result.diagnosis.to_json()["notes"] if "since the starting model" in n)
    assert told.startswith("coulomb_friction of panda_joint4: coulomb_torque changed from 3 to 2.")
    assert result.diagnosis.effects[0].in_all["coulomb_torque"] == pytest.approx(
        {"start": 3.0, "now": 3.0 + change["value"]}
    )
    assert Diagnosis.from_json(result.diagnosis.to_json()).to_json() == result.diagnosis.to_json()
    assert "Coulomb friction 3 → 2.2 N m on panda_joint4" in headline(result.diagnosis.to_json())
    # The sum is still friction: the saved model is accepted.
    result.model.save(tmp_path / "model.json")
    assert Model.load(tmp_path / "model.json", panda).effects == result.model.effects
    # Torque that would need friction to drive is no friction that became less.
    pushing = [4.0 * np.sign(np.gradient(run["q"], axis=0)) * (np.arange(7) == 3) for run in (*train, *test)]
    driven = [run.with_signals(tau=run["tau"] - push) for run, push in zip((*train, *test), pushing, strict=True)]
    wrong = close_loop(panda, driven[:3], driven[3:], start=Model(panda, (friction,))).diagnosis.to_json()
    left = [e["parameters"][0]["value"] for e in wrong["effects"] if e["joints"] == ["panda_joint4"]]
    assert all(value >= -3.0 - 1e-9 for value in left)
    assert wrong["verdict"] != "explained"


def test_friction_of_the_starting_model_that_follows_the_load_carries_a_new_payload_too(panda):
    friction = [
        Effect("load_dependent_friction", ("panda_joint2",), {"load_coefficient": 0.15}),
        Effect("load_dependent_friction", ("panda_joint4",), {"load_coefficient": 0.15}),
    ]
    heavy = dict(BODY, mass=2.5)
    train, test = excitations(panda, [*friction, Effect("payload", (), heavy)], train=3, test=1, **SHORT)
    diagnosis = close_loop(panda, train, test, start=Model(panda, tuple(friction))).diagnosis.to_json()
    assert named(diagnosis) == [("payload", ())]
    assert diagnosis["effects"][0]["parameters"][0]["value"] == pytest.approx(2.5, rel=0.01)
    assert diagnosis["verdict"] == "explained"


def with_outliers(run, joints, torque, seconds, at=4.0):
    """``run`` with ``torque`` (of the noise's order times many) on ``joints`` for ``seconds``."""
    tau = run["tau"].copy()
    moment = (run.time >= at) & (run.time < at + seconds)
    tau[np.ix_(moment, joints)] += torque
    return run.with_signals(tau=tau)


def test_an_outlier_segment_is_told_and_left_out_of_the_fit(panda):
    effect = Effect("viscous_friction", ("panda_joint2",), {"viscous_coefficient": 2.0})
    train, test = excitations(panda, [effect], train=3, test=1, **SHORT)
    everywhere = list(range(7))
    diagnosis = close_loop(
        panda, [with_outliers(train[0], everywhere, 40.0, 0.1), *train[1:]], test
    ).diagnosis.to_json()
    assert named(diagnosis) == [("viscous_friction", ("panda_joint2",))]
    assert diagnosis["effects"][0]["parameters"][0]["value"] == pytest.approx(2.0, rel=0.02)
    assert diagnosis["verdict"] == "explained"
    told = [note for note in diagnosis["notes"] if "outlier segment" in note]
    assert len(told) == 1
    assert "run train_1: around 4.0" in told[0]
    # What is reported of the training runs holds the outlier segment.
    rmse = {k: np.array(diagnosis["error"][k]["after"]["rmse"]) for k in ("train", "test")}
    assert np.all(rmse["train"] > rmse["test"])


@pytest.mark.parametrize(
    ("joints", "seconds"), [([1], 0.1), (list(range(7)), 2.0)], ids=["one joint only", "a lasting push"]
)
def test_what_is_no_outlier_segment_is_not_left_out(joints, seconds, panda):
    train, test = excitations(panda, train=3, test=1, **SHORT)
    diagnosis = close_loop(
        panda, [with_outliers(train[0], joints, 40.0, seconds), *train[1:]], test
    ).diagnosis.to_json()
    assert not any("outlier segment" in note for note in diagnosis["notes"])


def test_first_joint_rotor_and_link_cannot_be_told_apart_and_it_says_so(panda):
    effect = Effect("armature", ("panda_joint1",), {"armature": 0.2})
    train, test = excitations(panda, [effect], train=3, test=1, **SHORT)
    entry = close_loop(panda, train, test).diagnosis.to_json()["effects"][0]
    assert entry["effect"] == "armature"
    others = {tuple(o["effects"][0]["joints"]): o for o in entry["indistinguishable_from"]}
    assert "same torque" in others[("panda_joint1",)]["why"]
    assert "No motion" in others[("panda_joint1",)]["motion_that_would_tell"]


def test_a_payload_turned_between_runs_is_inconsistent_not_averaged_in_silence(panda):
    turned = dict(BODY, com_x=-0.08)
    one = [excitation(panda, [Effect("payload", (), dict(BODY, com_x=0.08))], name=f"a{k}", **SHORT) for k in range(2)]
    two = [excitation(panda, [Effect("payload", (), turned)], name=f"b{k}", **SHORT) for k in range(2)]
    diagnosis = close_loop(panda, [one[0], two[0]], [one[1], two[1]]).diagnosis.to_json()
    assert named(diagnosis) == [("payload", ())]
    disagreeing = {d["parameter"]: d["runs"] for d in diagnosis["effects"][0]["inconsistent_between_runs"]}
    assert "com_x" in disagreeing
    assert "mass" not in disagreeing
    values = {r["run"]: r["value"] for r in disagreeing["com_x"]}
    assert values["a0"] == pytest.approx(0.08, abs=0.002)
    assert values["b0"] == pytest.approx(-0.08, abs=0.002)
    # Wrong-cause control: the same payload in all runs is consistent.
    same = close_loop(
        panda, [one[0], one[1]], [excitation(panda, [Effect("payload", (), dict(BODY, com_x=0.08))], name="c", **SHORT)]
    )
    assert "inconsistent_between_runs" not in same.diagnosis.to_json()["effects"][0]


def test_runs_that_disagree_by_little_are_told_with_the_parameter(panda):
    """A few millimetres: surely better fitted run by run, though hardly any joint gains a squared floor."""
    heavy = dict(BODY, mass=1.0, com_x=0.0, com_z=0.08)
    runs = [
        excitation(panda, [Effect("payload", (), dict(heavy, com_y=y))], name=f"r{k}", duration=10.0)
        for k, y in enumerate((0.003, -0.003))
    ]
    diagnosis = close_loop(panda, runs, []).diagnosis.to_json()
    assert named(diagnosis) == [("payload", ())]
    assert any("the runs disagree" in note for note in diagnosis["notes"])
    assert [d["parameter"] for d in diagnosis["effects"][0]["inconsistent_between_runs"]] == ["com_y"]


def test_one_run_alone_and_a_joint_that_stands(panda):
    effects = [Effect("viscous_friction", ("panda_joint3",), {"viscous_coefficient": 3.0})]
    run = excitation(panda, effects, still=(4,), duration=12.0)
    diagnosis = close_loop(panda, [run], []).diagnosis.to_json()
    assert named(diagnosis) == [("viscous_friction", ("panda_joint3",))]
    assert any("one training run only" in note for note in diagnosis["notes"])
    assert any("no test run is given" in note for note in diagnosis["notes"])
    assert [x["joint"] for x in diagnosis["not_identifiable"]] == ["panda_joint5"]


def test_runs_of_one_second(panda):
    effects = [Effect("viscous_friction", ("panda_joint2",), {"viscous_coefficient": 8.0})]
    train, test = excitations(panda, effects, train=4, test=1, duration=1.0)
    diagnosis = close_loop(panda, train, test).diagnosis.to_json()
    assert ("viscous_friction", ("panda_joint2",)) in named(diagnosis)


def test_what_no_effect_explains_is_described_not_named(panda):
    train, test = excitations(panda, train=3, test=1, **SHORT)

    def ripple(run):
        tau = run["tau"].copy()
        tau[:, 3] += 2.0 * np.sin(3.0 * run["q"][:, 3])
        return run.with_signals(tau=tau)

    settings = LoopSettings(effects=("viscous_friction", "coulomb_friction", "armature", "torque_offset"))
    diagnosis = close_loop(panda, [ripple(r) for r in train], [ripple(r) for r in test], settings).diagnosis.to_json()
    assert diagnosis["verdict"] in ("unexplained", "partly_explained")
    assert [u["joint"] for u in diagnosis["unexplained"]] == ["panda_joint4"]
    assert "q4" in diagnosis["unexplained"][0]["expression"]
    assert diagnosis["unexplained"][0]["share_of_residual_variance"] > 0.9


def test_torque_of_the_wrong_sign_or_unit_is_refused_in_one_line(panda):
    train, test = excitations(panda, [Effect("payload", (), BODY)], train=2, test=1, **SHORT)

    def scaled(run, factor, joints):
        tau = run["tau"].copy()
        tau[:, joints] *= factor
        return run.with_signals(tau=tau)

    with pytest.raises(InputError, match=r"joint panda_joint4: the measured torque \(tau4\) has the wrong sign"):
        close_loop(panda, [scaled(r, -1, [3]) for r in train], test)
    with pytest.raises(InputError, match=r"measured torque is 1\.\d+e\+03 times the model's on joint 1"):
        close_loop(panda, [scaled(r, 1000.0, slice(None)) for r in train], test)
    with pytest.raises(InputError, match="convert degrees to radians"):
        close_loop(panda, [r.with_signals(q=np.degrees(r["q"])) for r in train], test)
    with pytest.raises(InputError, match="no training run is given"):
        close_loop(panda, [], test)
    with pytest.raises(InputError, match="no joint moves"):
        close_loop(panda, [excitation(panda, still=range(7), **SHORT)], test)
    with pytest.raises(InputError, match="the name is given twice"):
        close_loop(panda, [train[0], train[0]], test)
