"""The loop's parts: processing, constrained least squares, model.json."""

import json
import sys

import numpy as np
import pinocchio as pin
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect, Term, family
from hybrid_dynamics.effects.inertia import is_physical, pseudo_inertia
from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.loop import LoopSettings, Model, ProcessSettings, process
from hybrid_dynamics.loop.augment import effects_of, refit
from hybrid_dynamics.loop.diagnosis import predict_run
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.process import thinned
from hybrid_dynamics.loop.solve import FARTHEST, TRIES, Constraints, _inside, _solve_cones, solve, solve_bounded
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation.excitation import excitations
from hybrid_dynamics.trajectory import Trajectory


@pytest.fixture(scope="module")
def panda() -> Robot:
    return Robot.from_urdf(find_description("panda.urdf"), lock=("panda_finger_joint1", "panda_finger_joint2"))


def _sines(rate: float, seconds: float = 6.0) -> Trajectory:
    time = np.arange(round(seconds * rate)) / rate
    q = np.sin(np.outer(time, 1.0 + 0.5 * np.arange(7)))
    return Trajectory("sines", "train", time, {"q": q, "tau": q})


@pytest.mark.parametrize("rate", [94.0, 200.0, 500.0, 1000.0])
def test_torque_and_columns_pass_the_same_filter(rate, panda):
    run = process(_sines(rate), panda, ProcessSettings())
    # The torque is the position here, so the filtered torque must be the filtered column.
    np.testing.assert_allclose(run.tau, run.q, atol=2e-5)
    assert 1 / np.diff(run.time).mean() >= min(rate, 100.0) - 1
    w = 1.0 + 0.5 * np.arange(7)
    np.testing.assert_allclose(
        run.smooth(run.motion.dq), run.smooth(w * np.cos(np.outer(run.motion.time, w))), atol=2e-3
    )


@pytest.mark.parametrize(
    ("rate", "step", "keep"),
    [(50, 1, 1), (100, 1, 1), (250, 1, 2), (500, 1, 5), (999.99, 5, 2), (1000, 5, 2), (2000, 10, 2), (700, 1, 7)],
)
def test_rows_are_a_hundred_a_second_and_states_two_hundred_where_whole_numbers_allow(rate, step, keep):
    assert thinned(rate, 200.0, 100.0) == (step, keep)


@pytest.mark.parametrize("rate", [250.0, 1000.0, 2500.0])
def test_a_torque_up_to_the_cut_off_is_filtered_as_the_prediction_of_fewer_states_is(rate, panda):
    time = np.arange(round(3 * rate)) / rate
    pulse = 2 * np.pi * np.array([0.5, 2.0, 5.0, 10.0, 15.0, 20.0, 25.0])
    torque = np.sin(np.outer(time, pulse))
    slow = _sines(rate, 3.0)["q"]
    run = process(Trajectory("fast", "train", time, {"q": slow, "tau": torque}), panda, ProcessSettings())
    predicted = np.sin(np.outer(run.motion.time, pulse))
    # Of the same window at fewer instants, the part that folds back: two thousandths of the pass band at most.
    np.testing.assert_allclose(run.smooth(predicted), run.tau, atol=2e-3)


def test_what_a_model_predicts_of_a_run_is_computed_once_in_a_row(panda, monkeypatch):
    settings = LoopSettings()
    run = process(_sines(200.0), panda, settings.process)
    load = Term("load_dependent_friction", 3)
    late = Effect("time_delay", (), {"delay": 0.01}, {"response": "delay"})
    grease, more = (Effect("viscous_friction", ("panda_joint4",), {"viscous_coefficient": v}) for v in (0.5, 0.6))
    rotor, heavier = (Effect("armature", ("panda_joint4",), {"armature": v}) for v in (0.1, 0.2))
    evidence = Evidence.of(Model(panda), [run], [load], settings)
    asked = []
    newton_euler = Robot.inverse_dynamics

    def count(robot, *states):
        asked.append(len(states[0]))
        return newton_euler(robot, *states)

    monkeypatch.setattr(Robot, "inverse_dynamics", count)
    one = evidence.problem.left([grease, rotor, late])
    evidence.at([grease, rotor, late], [load])
    assert len(asked) == 1
    # Friction leaves the rigid body as it is.
    other = evidence.problem.left([more, rotor, late])
    assert len(asked) == 1
    heavy = evidence.problem.left([more, heavier, late])
    assert len(asked) == 2
    again = evidence.problem.left([grease, rotor, late])
    assert len(asked) == 2
    np.testing.assert_array_equal(one, again)
    for effects, left in (
        ([grease, rotor, late], one),
        ([more, rotor, late], other),
        ([more, heavier, late], heavy),
    ):
        np.testing.assert_array_equal(left[0], run.tau - predict_run(Model(panda, tuple(effects)), run))


def test_standing_rows_are_marked_over_the_whole_window(panda):
    run = process(_sines(500.0), panda, ProcessSettings(slow_speed=0.1))
    assert np.all(np.abs(run.dq[run.mask]) >= 0.1 - 1e-3)
    slow = np.abs(run.dq) < 0.05
    assert slow.any()
    assert not run.mask[slow].any()


def test_processing_refuses_short_and_uneven_runs(panda):
    short = _sines(500.0, 0.3)
    with pytest.raises(InputError, match=r"run sines: lasts 0.30 s .* expected at least"):
        process(short, panda, ProcessSettings())
    time = _sines(500.0).time.copy()
    time[100:] += 0.001
    uneven = Trajectory("uneven", "train", time, {"q": np.zeros((len(time), 7)), "tau": np.zeros((len(time), 7))})
    with pytest.raises(InputError, match="run uneven: time stamps are not uniform"):
        process(uneven, panda, ProcessSettings())
    with pytest.raises(ConfigError, match="cutoff is 0"):
        ProcessSettings(cutoff=0)
    with pytest.raises(ConfigError, match="floor_share is -1"):
        LoopSettings(floor_share=-1)
    with pytest.raises(ConfigError, match="effect 'magic' is unknown"):
        LoopSettings(effects=("magic",))


def test_bounds_are_kept_and_the_optimum_is_found():
    rng = np.random.default_rng(0)
    rows, target = rng.normal(size=(20, 60, 6)), rng.normal(size=(20, 60))
    a, b = rows.swapaxes(1, 2) @ rows, np.einsum("mti,mt->mi", rows, target)
    lower = np.array([0.0, 0.0, 0.0, -np.inf, -np.inf, 0.05])
    found = solve_bounded(a, b, lower)
    assert len(np.unique(found <= lower, axis=0)) > 3, "several sets of bounds are active"
    for m, x in enumerate(found):
        gradient = a[m] @ x - b[m]
        assert np.all(x >= lower - 1e-12)
        # Karush-Kuhn-Tucker: zero gradient inside, none pointing inwards at a bound.
        inside = x > lower + 1e-9
        np.testing.assert_allclose(gradient[inside], 0, atol=1e-8)
        assert np.all(gradient[~inside] >= -1e-8)
        np.testing.assert_array_equal(solve_bounded(a[[m]], b[[m]], lower)[0], x)


def test_impossible_bodies_are_pulled_back_to_possible_ones():
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(400, 10))
    true = np.array([2.0, 0.1, 0.0, 0.2, 0.05, 0.0, 0.06, -0.01, 0.0, 0.03])
    offset = np.zeros(10)
    a = 1e4 * rows.T @ rows
    assert is_physical(true)
    np.testing.assert_allclose(solve(a, a @ true, Constraints(np.full(10, -np.inf), ((0, offset),))), true, atol=1e-9)
    impossible = true * np.array([1, 1, 1, 1, 1, 1, 1, 1, 1, 6.0])
    x = solve(a, a @ impossible, Constraints(np.full(10, -np.inf), ((0, offset),)))
    assert is_physical(x)
    assert not is_physical(impossible)
    assert np.linalg.norm(x - impossible) < 0.2


def test_model_json_holds_the_model(tmp_path, panda):
    effects = (
        Effect(
            "coulomb_friction",
            ("panda_joint2",),
            {"coulomb_torque": 3.0},
            {"sign_width": 0.03},
            {"coulomb_torque": 0.1},
        ),
        Effect("gravity_tilt", (), {"roll": 0.02, "pitch": -0.01}),
    )
    model = Model(panda, effects)
    model.save(tmp_path / "model.json")
    again = Model.load(tmp_path / "model.json", panda)
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 20, 7))
    np.testing.assert_array_equal(again.predict(q, dq, ddq), model.predict(q, dq, ddq))
    assert again.effects[0].std_errors == {"coulomb_torque": 0.1}
    text = (tmp_path / "model.json").read_text()
    value = json.loads(text)
    value["joints"][0] = "other"
    (tmp_path / "model.json").write_text(json.dumps(value))
    with pytest.raises(InputError, match="made for joints other"):
        Model.load(tmp_path / "model.json", panda)
    (tmp_path / "model.json").write_text(text.replace('"effects"', '"effect"', 1))
    with pytest.raises(InputError, match=r"model\.json: top level: "):
        Model.load(tmp_path / "model.json", panda)
    with pytest.raises(InputError, match="no such file"):
        Model.load(tmp_path / "none.json", panda)


def test_a_tilt_beside_free_inertias_keeps_the_size_of_gravity(panda):
    # Heavier links everywhere: gravity of another size would explain that as well, but no angle could publish it.
    heavier = panda.copy()
    for joint in heavier.joint_ids:
        heavier.model.inertias[joint] = pin.Inertia.FromDynamicParameters(
            1.2 * heavier.model.inertias[joint].toDynamicParameters()
        )
    train, _ = excitations(heavier, (), train=2, test=1, duration=8.0)
    settings = LoopSettings()
    runs = [process(t, panda, settings.process) for t in train]
    terms = [s for n in ("gravity_tilt", "inertial_parameters") for s in family(n).terms(panda, np.ones(7, bool), {})]
    evidence = Evidence.of(Model(panda), runs, terms, settings)
    fitted = refit(evidence, terms)
    evidence, x = fitted.evidence, fitted.x
    linear = evidence.residuals(terms, x)
    model = evidence.base.adding(effects_of(evidence, terms, x))
    for run, left in zip(runs, linear, strict=True):
        exact = run.tau - predict_run(model, run)
        assert np.all(np.std(exact, axis=0) <= 1.05 * np.std(left, axis=0))


@pytest.mark.parametrize("rate", [50.0, 333.0, 500.0])
def test_a_run_smoothed_piece_by_piece_is_the_run_smoothed_at_once(rate, panda, monkeypatch):
    monkeypatch.setattr(sys.modules["hybrid_dynamics.loop.process"], "PIECE", 50)
    run = process(_sines(rate), panda, ProcessSettings())
    pieces = list(run.pieces())
    assert len(pieces) > 1
    found = np.concatenate([run.smooth(run.motion.ddq[states]) for _, states in pieces])
    np.testing.assert_array_equal(found, run.ddq)


def test_a_row_whose_window_holds_a_reversal_has_no_say():
    run = process(noisy_log([], 3, "train", 0.0), arm(), ProcessSettings(slow_speed=0.0))
    dq, time = run.motion.dq, run.motion.time
    for joint in range(2):
        at = np.flatnonzero(np.diff(np.sign(dq[:, joint])) != 0)
        reversals = time[at] + (time[1] - time[0]) * dq[at, joint] / (dq[at, joint] - dq[at + 1, joint])
        nearest = np.abs(run.time[:, None] - reversals).min(axis=1)
        # The window's own half, to a sample of the log either way.
        assert not run.mask[nearest < 0.5 / run.cutoff - 5e-3, joint].any()
        assert run.mask[nearest > 0.5 / run.cutoff + 5e-3, joint].all()


@pytest.mark.parametrize("seed", [1, 3, 4, 5, 7])
def test_two_columns_that_are_one_do_not_stop_a_physical_fit(seed):
    # Two joints that move alike, the friction of the one and the coupling to the other; rounding pulls them apart.
    rng = np.random.default_rng(seed)
    body = np.array([0.55, 0.0, 0.0, 0.0, 1e-3, 0.0, 1e-3, 0.0, 0.0, 1e-3])
    rows = rng.normal(size=(300, 12))
    y = rows @ np.concatenate([-3 * np.abs(rng.normal(size=10)), [1.0, 1.0]]) + rng.normal(size=300)
    single = solve(rows.T @ rows, rows.T @ y, Constraints(np.full(12, -np.inf), ((0, body),)))
    twice = np.hstack([rows, rows[:, [10]]])
    pull = twice.T @ y
    pull[12] *= 1 + 1e-7
    constraints = Constraints(np.full(13, -np.inf), ((0, body),))
    x = solve(twice.T @ twice, pull, constraints)
    assert np.linalg.eigvalsh(pseudo_inertia(body + x[:10]))[0] > -1e-7
    np.testing.assert_allclose(x[:10], single[:10], atol=2e-3)
    np.testing.assert_allclose([x[10] + x[12], x[11]], single[10:], atol=2e-3)
    # Of what rounding asks of the one against the other nothing comes.
    assert np.abs(x[[10, 12]]).max() < 10.0


@pytest.mark.parametrize(("ridge", "again", "margin"), TRIES)
def test_however_the_solver_is_asked_a_well_posed_fit_is_the_same(ridge, again, margin):
    rng = np.random.default_rng(2)
    rows = rng.normal(size=(400, 10))
    a = 1e4 * rows.T @ rows
    wanted = np.array([2.0, 0.1, 0.0, 0.2, 0.05, 0.0, 0.06, -0.01, 0.0, 0.5])
    constraints = Constraints(np.full(10, -np.inf), ((0, np.zeros(10)),))
    x = _solve_cones(a + ridge * np.diag(np.diag(a)), a @ wanted, constraints, FARTHEST[0], again, margin)
    assert not is_physical(wanted)
    np.testing.assert_allclose(x, solve(a, a @ wanted, constraints), atol=2e-4)


def test_a_body_far_outside_what_can_exist_is_no_solution_and_one_on_the_rim_is_pushed_inside():
    constraints = Constraints(np.full(10, -np.inf), ((0, np.zeros(10)),))
    body = np.array([1.0, 0.0, 0.0, 0.0, 0.2, 0.0, 0.2, 0.0, 0.0, 0.4 + 1e-12])
    inside = _inside(body, constraints)
    assert np.linalg.eigvalsh(pseudo_inertia(inside))[0] == pytest.approx(1e-8, rel=0.01)
    np.testing.assert_allclose(inside, body, atol=1e-7)
    assert _inside(body + np.eye(10)[9] * 1e-3, constraints) is None
    solid = np.array([1.0, 0.0, 0.0, 0.0, 0.2, 0.0, 0.2, 0.0, 0.0, 0.2])
    np.testing.assert_array_equal(_inside(solid, constraints), solid)


@pytest.mark.parametrize(
    ("weight", "pull"), [(1e6, 1e3), (8.67e12, -1.668e6), (5.157e23, 2.528e5), (5.157e23, -2.528e5)]
)
def test_a_body_of_which_one_number_is_known_to_rounding_can_exist(weight, pull):
    # A torque without noise, or none that was measured: its weight is huge, and all else is held by the prior alone.
    a = np.diag([0.04, 1, 1, 1, *5 * [11.1], weight])
    b = np.array([*9 * [0.0], pull])
    x = solve(a, b, Constraints(np.full(10, -np.inf), ((0, np.zeros(10)),)))
    assert np.linalg.eigvalsh(pseudo_inertia(x))[0] > 1e-9
    # What pulls towards a body that cannot be moves nothing, but for what bodies must lie inside; the other is reached.
    assert x[9] == pytest.approx(max(pull / weight, 0.0), abs=1e-4 if pull < 0 else 1e-7)
