"""Prediction along a whole log: truth recovered at its own stamps, ends included; parts that add up; an honest band."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from tests.two_links import EFFECTS, two_links

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.prediction import _back_to, predict
from hybrid_dynamics.loop.process import ProcessSettings, process
from hybrid_dynamics.loop.uncertainty import Uncertainty, correlation_of
from hybrid_dynamics.simulation.excitation import excitation
from hybrid_dynamics.trajectory import Trajectory


def true_run(rate: float = 200.0, seed: int = 0, **options: float) -> Trajectory:
    exact = {"torque_noise_share": 0.0, "encoder_bits": 0} | options
    return excitation(two_links(), EFFECTS, seed=seed, duration=6.0, rate=rate, **exact)


def share(error: np.ndarray, torque: np.ndarray) -> float:
    return float(np.max(np.sqrt(np.mean(error**2, axis=0)) / torque.std(axis=0)))


@pytest.mark.parametrize("rate", [100.0, 500.0])
def test_every_row_is_predicted_and_the_ends_hardly_worse(rate):
    """The log begins and ends in full motion; 5 % of the spread at the ends (mirrored ends: 10 to 20 %)."""
    run = true_run(rate).rows(slice(int(2.2 * rate), int(4.4 * rate)))
    found = predict(Model(two_links(), EFFECTS), run)
    np.testing.assert_array_equal(found.time, run.time)
    assert found.covered.all()
    error, edge = found.tau - run["tau"], int(0.08 * rate)
    assert share(error[2 * edge : -2 * edge], run["tau"]) < 0.02
    assert share(error[:edge], run["tau"]) < 0.05
    assert share(error[-edge:], run["tau"]) < 0.05
    # The control: without the effects the same prediction misses them.
    bare = predict(Model(two_links()), run)
    assert share(bare.tau - run["tau"], run["tau"]) > 0.1


def test_the_error_without_the_ends_is_taken_where_the_loop_takes_its_own():
    run = true_run(200.0)
    found = predict(Model(two_links(), EFFECTS), run)
    own = process(run, two_links(), ProcessSettings())
    assert found.inside is not None
    assert found.measured_smooth is not None
    np.testing.assert_allclose(run.time[found.inside][[0, -1]], own.time[[0, -1]], atol=0.05)
    assert found.relative_error(ends=False) == pytest.approx(
        np.linalg.norm((found.measured_smooth - found.tau)[found.inside])
        / np.linalg.norm(found.measured_smooth[found.inside])
    )
    # What is wrong at the ends alone is no error without them.
    spoiled = run["tau"].copy()
    spoiled[:5] += spoiled.std(axis=0)
    spoiled[-5:] += spoiled.std(axis=0)
    worse = predict(Model(two_links(), EFFECTS), run.with_signals(tau=spoiled))
    assert worse.rmse().max() > 2 * found.rmse().max()
    np.testing.assert_allclose(worse.rmse(ends=False), found.rmse(ends=False), rtol=1e-6)


def test_uneven_stamps_keep_their_own_rows_and_a_gap_is_not_bridged():
    run = true_run(500.0)
    rng = np.random.default_rng(0)
    kept = np.sort(rng.choice(len(run.time), int(0.8 * len(run.time)), replace=False))
    kept = kept[(run.time[kept] < 2.0) | (run.time[kept] > 3.0)]
    log = run.rows(kept)
    found = predict(Model(two_links(), EFFECTS), log)
    np.testing.assert_array_equal(found.time, log.time)
    assert share((found.tau - log["tau"])[found.covered], log["tau"]) < 0.03
    assert found.covered.all()
    short = np.concatenate([log.time < 2.0, np.zeros(0, bool)]) | ((log.time > 4.0) & (log.time < 4.02))
    told: list[str] = []
    partly = predict(Model(two_links(), EFFECTS), log.rows(short), notify=told.append)
    assert not partly.covered[log.time[short] > 3].any()
    assert any("left out" in line for line in told)


def test_stamps_that_stray_from_the_grid_have_values_of_their_own_instants():
    grid = np.arange(200) * 0.01
    stray = grid + 0.003 * np.sin(np.arange(200))
    values = np.sin(8.0 * grid)[:, None]
    back = _back_to(grid, stray)(values)
    inside = slice(5, -5)
    np.testing.assert_allclose(back[inside, 0], np.sin(8.0 * stray[inside]), atol=1e-5)
    # The control: as they stand on the grid they are off by a hundredth and more.
    assert np.abs(values[inside, 0] - np.sin(8.0 * stray[inside])).max() > 0.01
    assert _back_to(grid, grid + 1e-5)(values) is values


def test_friction_that_drives_at_the_speeds_of_a_log_is_told_where_somebody_listens():
    falling = {"quadratic_coefficient": -1.0, "cubic_coefficient": 0.0}
    grease = Effect("viscous_friction", ("elbow",), {"viscous_coefficient": 0.5})
    run = true_run()
    told: list[str] = []
    model = Model(two_links(), (grease, Effect("nonlinear_viscous_friction", ("elbow",), falling)))
    found = predict(model, run, notify=told.append)
    # 0.5 dq - dq |dq| drives beyond 0.5 rad/s.
    (line,) = told
    assert line.startswith("elbow moves at up to ")
    assert float(line.split("from ")[1].split()[0]) == pytest.approx(0.5, abs=0.05)
    np.testing.assert_array_equal(predict(model, run).tau, found.tau)
    # Control: the first alone opposes the motion at any speed.
    predict(Model(two_links(), (grease,)), run, notify=told.append)
    assert told == [line]


def test_parts_add_up_to_the_prediction():
    effects = (*EFFECTS, Effect("armature", ("elbow",), {"armature": 0.1}), EFFECTS[0])
    run = true_run()
    found = predict(Model(two_links(), effects), run, parts=True)
    # Viscous friction of the shoulder stands twice in the model, as it was and as it changed: one share.
    assert list(found.parts) == ["rigid_body", "viscous_friction", "torque_offset", "armature"]
    once = predict(Model(two_links(), EFFECTS), run, parts=True)
    np.testing.assert_allclose(found.parts["viscous_friction"], 2 * once.parts["viscous_friction"], atol=1e-9)
    np.testing.assert_allclose(sum(found.parts.values()), found.tau, atol=1e-9)
    # An offset is the one effect whose share is known without any filter.
    np.testing.assert_allclose(found.parts["torque_offset"][:, 1], 0.8, atol=1e-9)
    assert not found.parts["torque_offset"][:, 0].any()


def test_the_band_holds_what_it_promises():
    """Parameters off by their standard errors, noise on the torque: the error stays within two deviations."""
    robot = two_links()
    errors = ({"viscous_coefficient": 0.3}, {"offset": 0.2})
    rng = np.random.default_rng(1)
    inside, wide = [], []
    for seed in range(20):
        run = true_run(seed=seed, torque_noise_share=0.01)
        off = [
            Effect(e.effect, e.joints, {k: v + s[k] * rng.normal() for k, v in e.parameters.items()}, std_errors=s)
            for e, s in zip(EFFECTS, errors, strict=True)
        ]
        left = predict(Model(robot, EFFECTS), run).rmse()
        found = predict(Model(robot, tuple(off)), run, uncertainty=Uncertainty(left))
        assert found.band is not None
        assert found.measured_smooth is not None
        error = np.abs(found.measured_smooth - found.tau)
        inside.append(np.mean(error < 2 * found.band, axis=0))
        wide.append(np.mean(error < 2 * left, axis=0))
    assert np.mean(inside) > 0.9
    # The control: the noise alone does not cover parameters that are off.
    assert np.mean(wide) < 0.75


def test_correlated_parameters_give_another_band():
    effects = tuple(
        Effect(name, ("elbow",), {parameter: 0.5}, std_errors={parameter: 0.2})
        for name, parameter in (("torque_offset", "offset"), ("torque_offset", "offset"))
    )
    run, model = true_run(), Model(two_links(), effects)
    nothing = np.zeros(2)
    opposite = predict(model, run, uncertainty=Uncertainty(nothing, np.array([[1.0, -1.0], [-1.0, 1.0]])))
    together = predict(model, run, uncertainty=Uncertainty(nothing, np.ones((2, 2))))
    alone = predict(model, run, uncertainty=Uncertainty(nothing))
    for found, expected in ((opposite, 0.0), (together, 0.4), (alone, 0.2 * np.sqrt(2))):
        assert found.band is not None
        np.testing.assert_allclose(found.band[:, 1], expected, atol=1e-6)


def test_parameters_that_the_runs_cannot_tell_apart_are_correlated():
    """Two offsets of one joint make the same torque and go against each other; friction elsewhere does not."""
    robot = two_links()
    first = Effect("torque_offset", ("shoulder",), {"offset": 0.5}, std_errors={"offset": 0.1})
    twin = Effect("torque_offset", ("shoulder",), {"offset": 0.2}, std_errors={"offset": 0.1})
    viscous = {"viscous_coefficient": 1.0}
    grease = Effect("viscous_friction", ("elbow",), viscous, std_errors={"viscous_coefficient": 0.1})
    runs = [process(true_run(seed=k), robot, ProcessSettings()) for k in range(2)]
    found = correlation_of(Model(robot, (first, twin, grease)), runs, np.ones(2))
    assert found is not None
    np.testing.assert_allclose(np.diag(found), 1.0)
    assert found[0, 1] < -0.99
    assert abs(found[0, 2]) < 0.1
    assert correlation_of(Model(robot, (first,)), runs, np.ones(2)) is None


def test_what_the_runs_determine_together_is_known_however_little_of_each():
    """Three constant torques of one joint, one of them known well: only their sum is determined, and it is."""
    robot = two_links()
    offsets = [
        Effect("torque_offset", ("shoulder",), {"offset": 0.5}, std_errors={"offset": error}) for error in (1, 1, 0.01)
    ]
    runs = [process(true_run(seed=k), robot, ProcessSettings()) for k in range(2)]
    model = Model(robot, tuple(offsets))
    known = Uncertainty(np.zeros(2), correlation_of(model, runs, np.ones(2)))
    band = known.standard_deviation(model, runs[0].q, runs[0].dq, runs[0].ddq, runs[0].time, lambda values: values)
    # A few thousand rows of 1 N m tell the sum to some hundredths; each offset by itself is open by 1 N m.
    assert band[:, 0].max() < 0.1


def test_a_speed_that_is_known_to_half_its_size_is_no_speed_below_zero():
    """A parameter may be less sure than what keeps it above zero: its sensitivity is that of a smaller step."""
    robot, law = two_links(), {"coulomb_torque": 0.5, "static_torque": 1.5, "stribeck_velocity": 0.1}

    def correlation(error: float) -> np.ndarray:
        errors = {"coulomb_torque": 0.1, "stribeck_velocity": error}
        friction = Effect("stribeck_friction", ("elbow",), law, std_errors=errors)
        runs = [process(true_run(seed=k), robot, ProcessSettings()) for k in range(2)]
        found = correlation_of(Model(robot, (friction,)), runs, np.ones(2))
        assert found is not None
        return found

    sure, unsure = correlation(1e-4), correlation(0.3)
    np.testing.assert_allclose(np.diag(unsure), 1.0)
    assert sure[0, 1] * unsure[0, 1] > 0
    # Control: one that may be below zero takes its whole step.
    offset = Effect("torque_offset", ("elbow",), {"offset": 0.1}, std_errors={"offset": 0.3})
    run, nothing = true_run(), np.zeros(2)
    band = predict(Model(robot, (offset,)), run, uncertainty=Uncertainty(nothing)).band
    assert band is not None
    np.testing.assert_allclose(band[:, 1], 0.3, atol=1e-6)


def test_measured_velocity_is_used_where_positions_are_coarse():
    run = true_run()
    speed = CubicSpline(run.time, run["q"], axis=0)(run.time, 1)
    model = Model(two_links(), EFFECTS)
    truth = predict(model, run).tau
    coarse = run.with_signals(q=np.round(run["q"] * 500) / 500)
    given, derived = (np.abs(predict(model, log).tau - truth).max() for log in (coarse.with_signals(dq=speed), coarse))
    assert given < 0.25 * derived


def test_one_sample_at_a_time_is_the_whole_run():
    """For a controller: the same torque, but for friction that remembers where it turned over."""
    run = true_run(100.0)
    spline = CubicSpline(run.time, run["q"], axis=0)
    states = [spline(run.time, order)[::20] for order in range(3)]
    load = Effect("load_dependent_friction", ("shoulder",), {"load_coefficient": 0.1}, {"sign_width": 0.05})
    gain = Effect("torque_gain", ("elbow",), {"gain": 1.1})
    model = Model(two_links(), (*EFFECTS, load, gain))
    one = np.array([model.torque(*state) for state in zip(*states, strict=True)])
    np.testing.assert_allclose(one, model.predict(*states), atol=1e-9)
    memory = Effect("coulomb_friction", ("shoulder",), {"coulomb_torque": 1.0}, {"sign_displacement": 0.01})
    late = Effect("time_delay", (), {"delay": 0.01})
    still = Model(two_links(), (memory, late)).torque([0.1, 0.2], [0.5, 0.0], [0.0, 0.0])
    plain = Model(two_links()).torque([0.1, 0.2], [0.5, 0.0], [0.0, 0.0])
    np.testing.assert_allclose(still - plain, [1.0, 0.0], atol=1e-9)
    drift = Effect("drift", ("shoulder",), {"rate": 0.1, "time_constant": 100.0}, {"of": "offset"})
    with pytest.raises(InputError, match="effect drift changes over the run"):
        Model(two_links(), (drift,)).torque([0.1, 0.2], [0.5, 0.0], [0.0, 0.0])
    with pytest.raises(InputError, match="a state holds 3 values; expected 2 of q, dq and ddq each"):
        Model(two_links()).torque([0.1, 0.2, 0.3], [0.5, 0.0], [0.0, 0.0])


def test_a_log_of_another_robot_is_refused():
    run = true_run()
    with pytest.raises(InputError, match="holds 1 joints; robot two_links has 2"):
        predict(Model(two_links()), Trajectory("x", "test", run.time, {"q": run["q"][:, :1]}))


def test_a_torque_that_does_not_vary_has_no_spread_to_compare_with():
    """Filters leave 1e-16 of a constant, and an error over that is no share of anything."""
    time = np.arange(400) * 0.005
    q = np.tile([0.3, -0.2], (400, 1))
    resting = Trajectory("rest", "test", time, {"q": q, "tau": np.tile([0.1, 0.7], (400, 1)) / 3})
    found = predict(Model(two_links()), resting)
    assert np.isnan(found.relative_rmse()).all()
    assert np.isfinite(found.rmse()).all()
    moved = resting.with_signals(tau=resting["tau"] + 1e-3 * np.sin(time)[:, None])
    assert np.isfinite(predict(Model(two_links()), moved).relative_rmse()).all()
