"""Lines that random swaps of operators had left unnoticed (``tests/operator_swaps.py``), against their definitions."""

from types import SimpleNamespace

import numpy as np
import pytest
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect, Term, family, predict
from hybrid_dynamics.effects.expression import compile_law
from hybrid_dynamics.effects.inertia import links_with_mass
from hybrid_dynamics.effects.joint_spring import _part, _rest
from hybrid_dynamics.effects.settings import _spans
from hybrid_dynamics.effects.state import State
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop.blackbox import LAGS, shift_test, state_features
from hybrid_dynamics.loop.contact import _since
from hybrid_dynamics.loop.floor import _parts
from hybrid_dynamics.loop.outliers import outlier_segments
from hybrid_dynamics.loop.placeholders import times_in_torque
from hybrid_dynamics.loop.process import ProcessSettings, process
from hybrid_dynamics.simulation.sensors import true_run
from hybrid_dynamics.trajectory import Trajectory


def test_a_spring_rests_where_its_torque_is_nothing_also_beyond_its_knots():
    knots = (-1.0, -0.3, 0.4, 1.0)
    for held in (0.7, -9.0, 9.0):
        x = np.array([5.0, 0.5, 8.0, held])
        rest = _rest(x, knots)
        torque = sum(s * _part(np, rest, knots, k) for k, s in enumerate(x[:-1])) - held
        assert torque == pytest.approx(0.0, abs=1e-9)
    assert _rest(np.array([5.0, 0.5, 8.0, -9.0]), knots) < knots[0]
    assert _rest(np.array([5.0, 0.5, 8.0, 9.0]), knots) > knots[-1]
    # What is published says the same torque.
    kind, term = family("joint_spring"), Term("joint_spring", 1, (("knots", knots), ("shape", "piecewise")))
    for held in (-9.0, -1.0, 9.0):
        x = np.array([5.0, 0.5, 8.0, held])
        np.testing.assert_allclose(kind.coordinates_of(kind.parameters_of(x, arm(), term), arm(), term), x)


@pytest.mark.parametrize(
    "text", ["load(q1)", "eval(q1)", "sin(q1, q2)", "sin(q1, x=q2)", "q1.real", "sin", "1e999*q1", "True*q1", "'a'"]
)
def test_an_expression_calls_nothing_but_its_few_functions(text):
    assert compile_law("sin(q1)") is not None
    with pytest.raises(InputError, match="is not allowed"):
        compile_law(text)


def test_links_with_mass_are_those_that_weigh_and_that_a_moving_joint_carries():
    robot = arm()
    assert links_with_mass(robot, np.array([True, False])) == [0, 1]
    assert links_with_mass(robot, np.array([False, True])) == [1]
    assert links_with_mass(robot, np.array([False, False])) == []
    robot.model.inertias[robot.joint_ids[1]].mass = 0.0
    assert links_with_mass(robot, np.array([True, True])) == [0]


def test_spans_are_pairs_that_rise():
    assert _spans(((0.0, 1.0), (2.0, 3.5)))
    for wrong in ((), [(0.0, 1.0)], ((1.0, 0.0),), ((0.0, 1.0, 2.0),), ((0.0, 1.0), (3.0, 2.0)), "ab"):
        assert not _spans(wrong)


def test_a_coupling_without_a_rotor_needs_no_acceleration():
    kind = family("joint_coupling")
    values = {"viscous_coefficient": 2.0, "coulomb_torque": 0.0, "armature": 0.0}
    q, dq = np.zeros((2, 5)), np.array([np.linspace(0.1, 1.0, 5), np.linspace(-1.0, -0.2, 5)])
    torque = kind.law(np, State(q, dq, joint=0, partner=1), values, {})
    np.testing.assert_allclose(torque, 2.0 * dq[1])
    ddq = np.array([np.zeros(5), np.full(5, 3.0)])
    heavier = kind.law(np, State(q, dq, ddq, joint=0, partner=1), {**values, "armature": 0.5}, {})
    np.testing.assert_allclose(heavier - torque, 0.5 * 3.0)


def test_a_coupling_is_drawn_between_neighbours():
    robot = arm()
    for seed in range(6):
        term = family("joint_coupling").draw_term(robot, np.array([True, True]), np.random.default_rng(seed))
        assert (term.joint, term.options["from_joint"]) == (0, "elbow")


def test_earlier_speeds_are_so_many_windows_of_the_filter_old():
    time = np.arange(400) * 0.01
    q = np.column_stack([np.sin(time), np.cos(2 * time)])
    dq = np.column_stack([np.cos(time), -2 * np.sin(2 * time)])
    run = SimpleNamespace(time=time, q=q, dq=dq, ddq=np.zeros_like(q), cutoff=5.0)
    features = state_features(run, 1)
    for k, windows in enumerate(LAGS):
        rows = round(windows / 5.0 / 0.01)
        np.testing.assert_allclose(features[rows:, 6 + k], dq[:-rows, 1])
        np.testing.assert_allclose(features[:rows, 6 + k], dq[0, 1])


def test_a_prediction_is_judged_by_what_varies_and_what_goes_against_it_has_no_say():
    rng = np.random.default_rng(0)
    one, other = rng.normal(size=(2, 3000))
    seen = [np.ones(3000, bool)]
    plain = shift_test([one], [0.3 * one + other], seen)
    assert plain < 1e-6
    assert shift_test([one + 7.0], [0.3 * one + other - 4.0], seen) == pytest.approx(plain, rel=1e-6, abs=1e-12)
    assert shift_test([one], [-one], seen) == 1.0
    assert 0.001 < shift_test([one], [other], seen) <= 1.0


def test_a_moment_is_told_by_its_time_since_the_run_began():
    run = SimpleNamespace(time=np.array([12.0, 12.5, 13.0]), began=10.0)
    assert [_since(run, row) for row in (0, 2, 9)] == [2.0, 3.0, 3.0]


def test_parts_of_a_run_in_which_all_joints_move_are_of_the_same_length():
    run = SimpleNamespace(time=np.arange(90) * 0.01, mask=np.ones((90, 2), bool), cutoff=5.0)
    assert np.bincount(_parts(run, 3)).tolist() == [30, 30, 30]
    assert _parts(run, 3).tolist() == sorted(_parts(run, 3).tolist())


def test_a_run_that_begins_late_has_the_same_outliers():
    rng = np.random.default_rng(3)
    time = np.arange(2000) * 0.01
    residual, ddq = rng.normal(size=(2000, 5)), rng.normal(size=(2000, 5))
    residual[1000:1010] += 40.0
    seen = np.ones((2000, 5), bool)
    found = [outlier_segments(0, time + later, ddq, residual, seen, pad=0.05) for later in (0.0, 100.0)]
    assert len(found[0]) == 1
    assert [(s.start, s.stop) for s in found[0]] == [(s.start, s.stop) for s in found[1]]


def test_friction_of_which_half_is_in_the_torque_is_in_it_half():
    time = np.arange(4000) * 0.005
    q = np.column_stack([0.6 * np.sin(1.3 * time), 0.5 * np.sin(2.1 * time + 1.0)])
    dq = np.gradient(q, time, axis=0)
    ddq = np.gradient(dq, time, axis=0)
    real = Effect("coulomb_friction", ("elbow",), {"coulomb_torque": 1.0})
    run = process(
        Trajectory("r", "train", time, {"q": q, "tau": predict(arm(), [real], q, dq, ddq, time)}),
        arm(),
        ProcessSettings(),
    )
    told = [Effect("coulomb_friction", ("elbow",), {"coulomb_torque": c}) for c in (2.0, 1.0, 0.5)]
    np.testing.assert_allclose([times_in_torque(arm(), [t], [run])[0] for t in told], [0.5, 1.0, 2.0], rtol=0.02)


def test_a_true_run_has_the_derivatives_of_its_speed():
    time = np.arange(21) * 0.1
    speed = np.column_stack([time**2, 3.0 * time])
    rollout = SimpleNamespace(time=time, q=np.zeros((21, 2)), dq=speed, tau=np.ones((20, 2)))
    run = true_run(rollout, "r", "train", record_every=2)
    at = time[2:-1:2]
    np.testing.assert_allclose(run["ddq"], np.column_stack([2 * at, np.full(len(at), 3.0)]), atol=1e-9)
    np.testing.assert_allclose(run["dddq"], np.tile([2.0, 0.0], (len(at), 1)), atol=1e-9)
