"""The park: errors by regime, a black box on top of a model, honest errors of parameters, effects added to logs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.errors import ConfigError
from hybrid_dynamics.files import write_json, write_text
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop.diagnosis import predict_run
from hybrid_dynamics.loop.model import effect_to_json
from hybrid_dynamics.loop.process import ProcessSettings, process
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.excitation import excitations
from hybrid_dynamics.study.layout import AddedFiles, DatasetFiles
from hybrid_dynamics.study.park import AddedSettings, ParkSettings, add_effects, draw_added, generate_added, score_added
from hybrid_dynamics.study.park.added import COLUMNS as ADDED_COLUMNS
from hybrid_dynamics.study.park.arm import explained_share, scatter
from hybrid_dynamics.study.park.black_box import corrections
from hybrid_dynamics.study.park.collect import collect_park
from hybrid_dynamics.study.park.regimes import REGIMES, regime_of
from hybrid_dynamics.study.park.tables import COLUMNS
from hybrid_dynamics.trajectory import Trajectory

LINK = """<link name="{0}"><inertial><origin xyz="0 0 -0.3"/><mass value="3"/>
<inertia ixx="0.05" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.02"/></inertial></link>"""
JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="0 0 {3}"/>
<axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5" velocity="3" effort="60"/></joint>"""
VISCOUS = Effect("viscous_friction", ("shoulder",), {"viscous_coefficient": 3.0})
COULOMB = Effect("coulomb_friction", ("elbow",), {"coulomb_torque": 2.0})


@pytest.fixture(scope="module")
def robot() -> Robot:
    links = LINK.format("upper"), LINK.format("lower")
    joints = JOINT.format("shoulder", "base", "upper", "0"), JOINT.format("elbow", "upper", "lower", "-0.6")
    text = f'<robot name="arm"><link name="base"/>{"".join((*links, *joints))}</robot>'
    return Robot.from_text(text, "arm")


def logs(robot: Robot, *effects: Effect, train: int = 2, test: int = 1, **options: Any) -> list[Trajectory]:
    learned, held = excitations(robot, effects, train=train, test=test, duration=8.0, rate=200.0, **options)
    return [*learned, *held]


def test_share_of_the_explainable_that_is_explained() -> None:
    assert explained_share(10.0, 1.0, 1.0) == 1.0
    assert explained_share(10.0, 10.0, 1.0) == 0.0
    assert explained_share(5.0, 3.0, 0.0) == pytest.approx(0.64)
    assert explained_share(5.0, 7.0, 3.0) < 0
    assert np.isnan(explained_share(1.0, 1.0, 2.0))


def test_regimes_of_a_motion_that_is_known(robot: Robot) -> None:
    """A joint that turns round by a sine, and one that stands: how long each regime lasts follows from the sine."""
    time = np.arange(0, 20, 0.01)
    q = np.column_stack([np.sin(2 * np.pi * 0.2 * time), np.zeros_like(time)])
    log = excitations(robot, train=1, test=0, duration=20.0, rate=100.0)[0][0]
    run = process(type(log)("sine", "test", time, {"q": q, "tau": q}), robot, ProcessSettings())
    regime = regime_of(run, standing=0.02, turn=0.1, slow=0.25)
    assert np.all(regime[:, 1] == REGIMES.index("standing"))
    speed = 2 * np.pi * 0.2
    shares = {name: float((regime[:, 0] == k).mean()) for k, name in enumerate(REGIMES)}
    # Two reversals a period of 5 s; a speed v is passed within asin(v / speed) of the reversal.
    below = {v: 2 / np.pi * np.arcsin(v / speed) for v in (0.02, 0.25 * speed)}
    assert shares["standing"] == pytest.approx(below[0.02], abs=0.01)
    assert shares["reversal"] == pytest.approx(2 * 0.2 / 5 - below[0.02], abs=0.01)
    assert shares["slow"] == pytest.approx(below[0.25 * speed] - 2 * 0.2 / 5, abs=0.02)
    assert sum(shares.values()) == pytest.approx(1.0)


def test_black_box_learns_a_law_without_a_name_and_leaves_noise_alone(robot: Robot) -> None:
    runs = [process(log, robot, ProcessSettings()) for log in logs(robot, train=3)]
    rng = np.random.default_rng(0)
    law = [2 * np.sin(run.q.sum(axis=1)) * np.sign(run.dq[:, 0]) for run in runs]
    noise = [rng.normal(0, 0.1, run.q.shape) for run in runs]
    left = [np.column_stack([own, 0 * own]) + more for own, more in zip(law, noise, strict=True)]
    [found] = corrections(runs[:3], left[:3], runs[3:])
    after = left[3] - found
    assert np.sqrt((after[:, 0] ** 2).mean()) < 0.6 * np.sqrt((left[3][:, 0] ** 2).mean())
    # White noise on the other joint: nothing to gain, and nothing lost by trying.
    assert np.sqrt((after[:, 1] ** 2).mean()) < 1.02 * np.sqrt((left[3][:, 1] ** 2).mean())


def test_scatter_of_parameters_tells_whether_their_errors_are_honest(robot: Robot) -> None:
    """The same friction in every run: runs are apart by their standard errors. Another one in each: by far more."""
    same = logs(robot, VISCOUS, COULOMB, train=5)
    model = Model(robot, (VISCOUS, COULOMB))
    table = scatter("arm", robot, model, same, LoopSettings(), parts=3)
    assert list(table["parameter"]) == ["viscous_coefficient", "coulomb_torque"]
    assert (table["runs"] == 6).all()
    # chi² of 5 degrees of freedom lies within 0.3 and 16.7 in 99 % of the cases: the root of a fifth, 0.25 and 1.8.
    assert table["scatter"].between(0.25, 1.8).all()
    other = [
        run
        for k, c in enumerate((1.0, 2.0, 3.0, 4.0))
        for run in excitations(
            robot,
            [Effect("viscous_friction", ("shoulder",), {"viscous_coefficient": c}), COULOMB],
            train=1,
            test=0,
            duration=8.0,
            rate=200.0,
            seed=k,
        )[0]
    ]
    wrong = scatter("arm", robot, model, other, LoopSettings(), parts=3)
    assert wrong["scatter"][0] > 10
    assert wrong["run_spread"][0] == pytest.approx(np.std([1, 2, 3, 4], ddof=1), rel=0.05)


def test_a_run_that_leaves_a_parameter_open_is_no_witness_of_it(robot: Robot) -> None:
    """A joint that turns one way only: offset and Coulomb friction are one constant there, and neither has a value."""
    model = Model(robot, (VISCOUS, COULOMB, Effect("torque_offset", ("elbow",), {"offset": 0.5})))
    both_ways = logs(robot, *model.effects, train=3, test=0)
    time = both_ways[0].time
    ramp = 0.2 * time + 0.02 * np.sin(3.0 * time)
    q = np.column_stack([both_ways[0]["q"][:, 0], ramp - ramp[-1] / 2])
    dq = np.gradient(q, time, axis=0)
    tau = model.predict(q, dq, np.gradient(dq, time, axis=0), time)
    one_way = Trajectory("one way", "train", time, {"q": q, "tau": tau})
    table = scatter("arm", robot, model, [*both_ways, one_way], LoopSettings(), parts=3).set_index("parameter")
    assert table["runs"].to_dict() == {"viscous_coefficient": 4, "coulomb_torque": 3, "offset": 3}
    # Values of an open direction would be apart by newton metres.
    assert table["run_spread"]["offset"] < 0.1
    assert table["run_spread"]["coulomb_torque"] < 0.1


def test_an_added_effect_is_the_torque_it_says(robot: Robot) -> None:
    """What is added is the effect's own torque; the noise and everything else of the log stay as they are."""
    base = Model(robot, (VISCOUS,))
    [log] = logs(robot, VISCOUS, train=1, test=0)
    [with_friction] = add_effects(base, [COULOMB], [log])
    more = with_friction["tau"] - log["tau"]
    assert np.all(more[:, 0] == 0)
    moving = np.abs(np.gradient(log["q"][:, 1], log.dt)) > 0.3
    assert np.abs(more[moving, 1]).min() == pytest.approx(2.0)
    assert np.abs(more[moving, 1]).max() == pytest.approx(2.0)
    gain = Effect("torque_gain", ("elbow",), {"gain": 1.1})
    [louder] = add_effects(base, [gain], [log])
    np.testing.assert_allclose(louder["tau"], log["tau"] * [1.0, 1.1])


@pytest.mark.parametrize("hidden", AddedSettings().families)
def test_an_added_effect_has_the_size_that_was_asked_for(robot: Robot, hidden: str) -> None:
    base, runs, floor = Model(robot, (VISCOUS,)), logs(robot, VISCOUS, train=2, test=0), np.array([0.2, 0.1])
    effect = draw_added(robot, base, hidden, runs, floor, 4.0, np.random.default_rng(3))
    before, after = (
        [process(r, robot, ProcessSettings()) for r in part] for part in (runs, add_effects(base, [effect], runs))
    )
    change = np.concatenate([b.tau - a.tau for a, b in zip(before, after, strict=True)])
    size = float((np.sqrt((change**2).mean(axis=0)) / floor).max())
    # A gain multiplies the recorded torque, noise included; its size is that of the model's torque.
    assert size == pytest.approx(4.0, rel=0.05)


def test_cases_hide_their_content_and_start_with_nothing(robot: Robot) -> None:
    base, runs = Model(robot), logs(robot, train=1, test=0)
    settings = AddedSettings(families=("viscous_friction", "torque_offset"), sizes=(3.0, 10.0))
    cases = list(generate_added(robot, base, runs, np.array([0.2, 0.1]), settings, "arm"))
    assert [case.name for case in cases] == [f"arm_{k:03d}" for k in range(5)]
    assert cases[0].truth["effects"] == []
    np.testing.assert_array_equal(cases[0].logs[0]["tau"], runs[0]["tau"])
    sizes = sorted((c.truth["effects"][0]["effect"], c.truth["size_over_floor"]) for c in cases[1:])
    assert sizes == [(f, s) for f in ("torque_offset", "viscous_friction") for s in (3.0, 10.0)]
    again = list(generate_added(robot, base, runs, np.array([0.2, 0.1]), settings, "arm"))
    for one, two in zip(cases, again, strict=True):
        np.testing.assert_array_equal(one.logs[0]["tau"], two.logs[0]["tau"])


def diagnosis(*entries: dict[str, Any]) -> dict[str, Any]:
    errors = {"before": {"rmse": [2.0, 2.0]}, "after": {"rmse": [1.0, 1.0]}}
    return {"effects": list(entries), "verdict": "partly_explained", "error": {"test": errors}}


def entry(effect: Effect, error: float, **more: Any) -> dict[str, Any]:
    out = effect_to_json(effect)
    for parameter in out["parameters"]:
        parameter["std_error"] = error
    return {**out, "confirmed": True, **more}


def friction(joint: str, value: float) -> Effect:
    return Effect("coulomb_friction", (joint,), {"coulomb_torque": value})


def test_score_of_an_added_effect() -> None:
    truth = {"case": "a_001", "dataset": "a", "effects": [effect_to_json(COULOMB)], "size_over_floor": 3.0}
    nothing = diagnosis()
    row = score_added(truth, diagnosis(entry(friction("elbow", 1.9), 0.1)), nothing)
    assert tuple(row) == ADDED_COLUMNS
    assert (row["detected"], row["named_right"], row["others"]) == (True, True, 0)
    assert (row["parameter"], row["true"], row["found"], row["std_error"]) == ("coulomb_torque", 2.0, 1.9, 0.1)
    # The wrong joint, another family, and a name that the test runs contradict are not it.
    wrong = score_added(truth, diagnosis(entry(friction("shoulder", 2.0), 0.1)), nothing)
    assert (wrong["detected"], wrong["named_right"], wrong["others"]) == (True, False, 1)
    contradicted = score_added(truth, diagnosis(entry(friction("elbow", 2.0), 0.1, confirmed=False)), nothing)
    assert (contradicted["detected"], contradicted["named_right"]) == (False, False)
    twin = [{"effects": [effect_to_json(COULOMB)], "why": "alike", "motion_that_would_tell": "none"}]
    told = score_added(truth, diagnosis(entry(VISCOUS, 0.1, indistinguishable_from=twin)), nothing)
    assert told["named_right"]
    # What stands there without anything added is neither found nor new; what is found counts from there.
    control = diagnosis(entry(friction("elbow", 2.0), 0.1), entry(VISCOUS, 0.1))
    same = score_added(truth, control, control)
    assert (same["detected"], same["named_right"], same["others"], same["others_without"]) == (False, False, 1, 1)
    more = score_added(truth, diagnosis(entry(friction("elbow", 4.1), 0.1)), control)
    assert more["named_right"]
    assert more["found"] == pytest.approx(2.1)
    assert more["std_error"] == pytest.approx(0.1 * np.sqrt(2))


def test_an_arm_that_cannot_be_had_is_left_out_of_the_tables(tmp_path: Path) -> None:
    for arm, provenance in (("here", "recorded"), ("gone", "absent")):
        folder = DatasetFiles(arm, tmp_path).park
        folder.mkdir(parents=True)
        write_json(folder / "summary.json", {"dataset": arm, "provenance": provenance})
    for table in ("joints", "regimes", "parameters"):
        write_text(DatasetFiles("here", tmp_path).park / f"{table}.csv", "dataset,joint,floor\nhere,1,0.5\n")
    AddedFiles("gone", tmp_path).folder.mkdir(parents=True)
    write_text(AddedFiles("gone", tmp_path).scores, ",".join(ADDED_COLUMNS) + "\n")
    (tmp_path / "reports").mkdir()
    assert collect_park(["here", "gone"], ["gone"], tmp_path / "reports", tmp_path) == ["gone"]
    assert list(pd.read_csv(tmp_path / "reports" / "park.csv")["dataset"]) == ["here"]
    assert tuple(pd.read_csv(tmp_path / "reports" / "added.csv").columns) == ADDED_COLUMNS
    assert collect_park(["gone"], [], tmp_path / "reports", tmp_path) == ["gone"]
    assert tuple(pd.read_csv(tmp_path / "reports" / "park.csv").columns) == COLUMNS


def test_settings_out_of_range_are_named() -> None:
    for make, message in (
        (lambda: ParkSettings(parts=1), "park.parts is 1"),
        (lambda: ParkSettings(slow=1.5), "park.slow is 1.5"),
        (lambda: AddedSettings(sizes=(0.0,)), "added.sizes is"),
        (lambda: AddedSettings(repeats=0), "added.repeats is 0"),
    ):
        with pytest.raises(ConfigError, match=message):
            make()


def test_rigid_body_of_the_model_is_what_predict_run_smooths(robot: Robot) -> None:
    """A model that is right leaves only noise at the loop's bandwidth: the baseline that all columns share."""
    [log] = logs(robot, VISCOUS, train=1, test=0, torque_noise_share=0.0, encoder_bits=0)
    run = process(log, robot, ProcessSettings())
    right, wrong = (predict_run(Model(robot, effects), run) - run.tau for effects in ((VISCOUS,), ()))
    assert np.sqrt((right**2).mean()) < 0.02 * np.sqrt((wrong**2).mean())
