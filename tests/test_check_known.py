"""A log against a completed model: what the model knows is no fault, and what it hits only read otherwise is one."""

from dataclasses import replace

import numpy as np
import pytest
from tests.small_arm import HIDDEN, arm

from hybrid_dynamics.check import checked_log, told_by_model
from hybrid_dynamics.check.findings import Finding
from hybrid_dynamics.check.known import check_known
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop import LoopSettings, close_loop
from hybrid_dynamics.loop import close as close_module
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.excitation import excitation, excitations
from hybrid_dynamics.trajectory import Trajectory

#: A turntable.
TABLE = (
    '<robot name="table"><link name="base"/><link name="top"><inertial><mass value="3"/><inertia ixx="0.05" iyy="0.05" '
    'izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="turn" type="revolute"><parent link="base"/>'
    '<child link="top"/><axis xyz="0 0 1"/><limit lower="-2.5" upper="2.5" velocity="10" effort="20"/></joint></robot>'
)
#: A strong spring against gravity, a base on a wall, and readings that are off: none of it is in the URDF.
SPRING = Effect("joint_spring", ("elbow",), {"stiffness": 25.0, "rest_position": 0.4}, {"shape": "linear"})
WALL = Effect("gravity_tilt", (), {"roll": 0.0, "pitch": np.pi / 2})
READINGS = (
    Effect("position_offset", ("shoulder",), {"offset": 0.3}),
    Effect("torque_gain", ("elbow",), {"gain": 1.8}),
    Effect("time_delay", (), {"delay": 0.09}),
)


def log(*effects: Effect, seed: int = 1, duration: float = 8.0) -> Trajectory:
    return excitation(arm(), effects, seed=seed, duration=duration, rate=200.0)


def doubts(model: Model, run: Trajectory) -> list[str]:
    """What is found but limits; refused: its line."""
    try:
        return [f.code for f in checked_log(model, run)[1] if not f.code.startswith("beyond")]
    except InputError as error:
        return [str(error)]


@pytest.mark.parametrize("effects", [HIDDEN, (SPRING,), (WALL,), READINGS], ids=["friction", "spring", "wall", "read"])
@pytest.mark.parametrize("duration", [3.0, 12.0])
def test_what_the_model_knows_is_no_fault(effects, duration):
    run = log(*effects, duration=duration)
    assert doubts(Model(arm(), effects), run) == []
    for name, signs in {"tau": (-1.0, 1.0), "q": (1.0, -1.0)}.items():
        (line,) = doubts(Model(arm(), effects), run.with_signals(**{name: run[name] * signs}))
        assert "sign" in line, "the control"


def test_a_base_that_stands_otherwise_than_the_models_is_refused():
    (line,) = doubts(Model(arm()), log(WALL, *HIDDEN))
    assert line.startswith("the base does not stand as the model says: gravity is found at ")
    assert "run close-loop on logs of this one" in line


@pytest.mark.parametrize("seed", range(6))
def test_columns_of_a_small_arm_in_another_order_are_refused(seed):
    """Two joints in parallel: a robot with springs and tools could explain some of these logs, its model cannot."""
    run, model = log(*HIDDEN, seed=seed), Model(arm(), HIDDEN)
    assert doubts(model, run) == []
    for signals in (("q", "tau"), ("tau",), ("q",)):
        (line,) = doubts(model, run.with_signals(**{s: run[s][:, ::-1] for s in signals}))
        assert "exchange the columns" in line or "wrong sign" in line or "turned round" in line, line


def test_what_a_model_lacks_is_no_fault():
    """A payload and a spring that came later: the prediction is off, and the log is right."""
    inertia = {f"inertia_{i}": 0.0 for i in ("xx", "xy", "yy", "xz", "yz", "zz")}
    later = (Effect("payload", (), {"mass": 2.0, "com_x": 0.0, "com_y": 0.0, "com_z": 0.1, **inertia}), SPRING)
    for seed in range(4):
        for effects in (later, later[:1], later[1:]):
            assert not any(" " in line for line in doubts(Model(arm(), HIDDEN), log(*HIDDEN, *effects, seed=seed)))


def test_a_constant_torque_and_one_that_is_missing_say_nothing():
    run = log(*HIDDEN)
    swapped = run.with_signals(q=run["q"][:, ::-1])
    still = swapped.with_signals(tau=np.full_like(run["tau"], 2.0))
    bare = Trajectory("bare", "test", run.time, {"q": swapped["q"]})
    assert doubts(Model(arm(), HIDDEN), still) == doubts(Model(arm(), HIDDEN), bare) == []


def test_positions_in_another_unit_are_told_to_a_model():
    run, model = log(*HIDDEN), Model(arm(), HIDDEN)
    (found,) = told_by_model(model, [run.with_signals(q=np.deg2rad(run["q"]))], [run])
    assert (found.code, found.suggestion) == ("degrees", {"units": {"q": "rad"}})
    assert found.text.startswith("positions are 0.0175 times what the model knows of them")
    assert "in radians, and read as degrees" in found.text


@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_runs_of_another_gain_are_no_test_of_a_model(factor):
    run, model = log(*HIDDEN), Model(arm(), HIDDEN)
    weak = replace(run.with_signals(tau=factor * run["tau"]), name="weak")
    (found,) = told_by_model(model, [run, weak], [run])
    assert (found.code, found.severity, found.run) == ("torque_unit", "hard", "weak")
    times = float(found.text.removeprefix("measured torques are ").partition(" times what the model knows of them")[0])
    assert times == pytest.approx(factor, rel=0.02)
    assert found.suggestion["gain"]["tau"][0] == pytest.approx(1 / factor, rel=0.02)
    # What is predicted along a log does not depend on its torque.
    assert "torque_unit" not in doubts(model, weak)
    # A joint's own gain, or a payload, is for close-loop to name.
    one = replace(run.with_signals(tau=run["tau"] * [1.0, factor]), name="one")
    assert told_by_model(model, [one], [run]) == []


def test_where_the_model_was_not_taught_a_torque_of_the_other_sign_is_no_fault_of_the_log():
    """A spring that was learnt on one side of where it rests may be another one on the other side; of positions that
    are turned round, and are there for being turned, it is a warning."""
    run, model = log(*HIDDEN), Model(arm(), HIDDEN)
    away = replace(run, name="away").with_signals(q=run["q"] + [0.0, 10.0])
    turned_round = run.with_signals(tau=run["tau"] * [1.0, -1.0])
    assert [f.code for f in told_by_model(model, [turned_round], [run])] == ["torque_sign"]
    assert told_by_model(model, [turned_round], [away]) == []
    # What the model knows a zero to be off by is no other place.
    moved = Model(arm(), (*HIDDEN, Effect("position_offset", ("elbow",), {"offset": 3.0})))
    offset = run.with_signals(q=run["q"] - [0.0, 3.0])
    reversed_ = offset.with_signals(tau=run["tau"] * [1.0, -1.0])
    assert [f.code for f in told_by_model(moved, [reversed_], [offset])] == ["torque_sign"]
    # Of the other joint, which was there, it is told.
    assert [f.joint for f in told_by_model(model, [run.with_signals(tau=run["tau"] * [-1.0, 1.0])], [away])] == [
        "shoulder"
    ]
    mirrored = run.with_signals(q=run["q"] * [1.0, -1.0])
    (found,) = told_by_model(model, [mirrored], [away])
    assert (found.code, found.severity, found.suggestion) == ("position_sign", "warning", {})
    # Where the model was learnt it is certain.
    (found,) = told_by_model(model, [mirrored], [run])
    assert (found.code, found.severity) == ("position_sign", "hard")
    assert found.suggestion["sign"]["q"] == [1, -1]


def test_a_law_alike_on_both_sides_that_was_learnt_on_one_refuses_no_run_on_the_other():
    """A spring that grows stiffer, learnt as a linear one that rests elsewhere: turned round, the run is where it was
    learnt (a blind case of a UR10e)."""
    linear = Effect("joint_spring", ("turn",), {"stiffness": 60.0, "rest_position": 0.5}, {"shape": "linear"})
    table = Robot.from_text(TABLE, "table.urdf")
    run = excitation(table, [], duration=8.0, rate=200.0)
    here = run.with_signals(q=0.2 * (run["q"] - run["q"].min()) / np.ptp(run["q"]) + 0.8)
    here = here.with_signals(tau=60.0 * (here["q"] - 0.5))
    there = replace(here, name="there").with_signals(q=-here["q"], tau=-here["tau"])
    (found,) = told_by_model(Model(table, (linear,)), [there], [here])
    assert (found.code, found.severity) == ("position_sign", "warning")
    assert "not learnt where the joint is" in found.text
    assert not any(words in found.text for words in ("flip", "read wrongly"))
    # Control: learnt on both sides the log is what is wrong.
    both = here.with_signals(q=1.5 * np.sin(here.time)[:, None])
    assert [f.severity for f in told_by_model(Model(table, (linear,)), [there], [both])] == ["hard"]


def test_a_load_or_worn_friction_of_the_only_joint_is_no_gain():
    table = Robot.from_text(TABLE, "table.urdf")
    rubbing = [Effect("viscous_friction", ("turn",), {"viscous_coefficient": v}) for v in (2.0, 6.0)]
    worn = excitation(table, rubbing[1:], duration=8.0, rate=200.0)
    assert told_by_model(Model(table, tuple(rubbing[:1])), [worn], [worn]) == []


@pytest.mark.parametrize("signals", [("q", "tau"), ("q",), ("tau",)])
def test_a_test_run_that_the_training_runs_model_hits_read_otherwise_only_is_refused(signals):
    train, (test,) = excitations(arm(), HIDDEN, train=2, test=1, duration=8.0, rate=200.0)
    settings = LoopSettings(effects=("viscous_friction", "coulomb_friction"))
    assert close_loop(arm(), train, [test], settings).diagnosis.verdict == "explained"
    other = test.with_signals(**{s: test[s][:, ::-1] for s in signals})
    with pytest.raises(InputError, match=r"exchange|wrong sign|turned round"):
        close_loop(arm(), train, [other], settings)
    with pytest.raises(
        InputError, match=r"run test_1: measured torques are (0.2|0.199) times .* one of the two is read wrongly"
    ):
        close_loop(arm(), train, [test.with_signals(tau=0.2 * test["tau"])], settings)


def test_what_only_looks_turned_round_is_a_note(monkeypatch):
    train, (test,) = excitations(arm(), HIDDEN, train=1, test=1, duration=8.0, rate=200.0)
    settings = LoopSettings(effects=("viscous_friction", "coulomb_friction"))
    doubt = Finding("position_sign", "warning", "it looks like the position turned round", run="test_1")
    monkeypatch.setattr(close_module, "told_by_model", lambda *given: [doubt])
    assert doubt.line in close_loop(arm(), train, [test], settings).diagnosis.notes
    monkeypatch.setattr(close_module, "told_by_model", lambda *given: [replace(doubt, severity="hard")])
    with pytest.raises(InputError, match="turned round"):
        close_loop(arm(), train, [test], settings)


@pytest.mark.parametrize("size", [0.0, 1e-10])
def test_a_torque_that_nobody_measured_is_no_fault_and_divides_by_nothing(size):
    run, model = log(*HIDDEN), Model(arm(), HIDDEN)
    tau = run["tau"].copy()
    tau[:, 1] = size
    with np.errstate(all="raise"):
        assert check_known(model, [run.with_signals(tau=tau)]) == []
        # Control: of the other joint it is told what is wrong.
        (finding,) = check_known(model, [run.with_signals(tau=tau * (-1.0, 1.0))])
    assert "sign" in finding.line
