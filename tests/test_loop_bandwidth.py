"""A log's own bandwidth: coarse positions and velocities, and what is none of these."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics import LoopSettings, close_loop, load_model, predict
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.loop import bandwidth
from hybrid_dynamics.loop.bandwidth import narrowed
from hybrid_dynamics.loop.diagnosis import predict_run
from hybrid_dynamics.loop.heard import as_heard
from hybrid_dynamics.loop.process import ProcessSettings, hann_kernel, least_rows
from hybrid_dynamics.strict_json import read_json
from hybrid_dynamics.trajectory import Trajectory

ROBOT = arm()
ASKED = ProcessSettings()
#: Steps of a twelve-bit encoder at the joint [rad].
TWELVE_BITS = 2 * np.pi / 4096
FRICTION = [
    Effect("viscous_friction", ("shoulder",), {"viscous_coefficient": 0.8}),
    Effect("coulomb_friction", ("elbow",), {"coulomb_torque": 0.4}),
]


def log(
    hidden: list[Effect], seed: int = 1, split: str = "train", step: float = 0.0, noise: float = 0.02
) -> Trajectory:
    """Positions in steps of ``step`` [rad]; torque noise of ``noise`` [N m]."""
    run = noisy_log(hidden, seed, split, noise)
    q = np.round(run["q"] / step) * step if step else run["q"]
    return replace(run, signals={"q": q, "tau": run["tau"]})


def smoothed(run: Trajectory, cutoff: float) -> Trajectory:
    """With a torque that passed a zero-phase low-pass before it was logged."""
    kernel = hann_kernel(1.0 / cutoff, run.dt)
    tau = np.stack([np.convolve(column, kernel, "same") for column in run["tau"].T], axis=1)
    return replace(run, signals={"q": run["q"], "tau": tau})


def test_fine_positions_keep_the_bandwidth_that_was_asked_for() -> None:
    assert narrowed(ROBOT, [log(FRICTION)], ASKED) == (ASKED, [])


@pytest.mark.parametrize("hidden", [[], FRICTION], ids=["nothing", "friction"])
def test_coarse_positions_lower_it_above_the_motion(hidden: list[Effect]) -> None:
    settings, told = narrowed(ROBOT, [log(hidden, step=TWELVE_BITS)], ASKED)
    # The motion has its last sine below .6 Hz; noise of accelerations grows by the fifth power of the cut-off.
    assert 2.0 < settings.cutoff < 0.6 * ASKED.cutoff_at(0.005)
    assert replace(settings, cutoff=ASKED.cutoff) == ASKED
    assert len(told) == 1
    assert f"beyond {settings.cutoff:.2g} Hz" in told[0]


def test_coarser_positions_ask_for_less_and_longer_logs_too() -> None:
    def cutoff(step: float, times: int = 1) -> float:
        runs = [log([], seed, step=step) for seed in range(1, 1 + times)]
        return narrowed(ROBOT, runs, ASKED)[0].cutoff

    assert cutoff(4 * TWELVE_BITS) < cutoff(TWELVE_BITS) < cutoff(TWELVE_BITS / 4) <= ASKED.cutoff
    # What a fit gains from noise grows with the rows it sees.
    assert cutoff(TWELVE_BITS, times=8) < cutoff(TWELVE_BITS)


def test_it_is_left_alone_on_request_and_never_raised() -> None:
    coarse = log([], step=TWELVE_BITS)
    fixed = replace(ASKED, own_bandwidth=False)
    assert narrowed(ROBOT, [coarse], fixed) == (fixed, [])
    low = replace(ASKED, cutoff=3.0)
    assert narrowed(ROBOT, [coarse], low) == (low, [])


def test_a_run_that_is_too_short_anyway_is_left_to_the_filter_to_refuse() -> None:
    coarse = log([], step=16 * TWELVE_BITS)
    short = coarse.rows(slice(0, least_rows(coarse.dt, ASKED) - 1))
    assert narrowed(ROBOT, [coarse, short], ASKED) == (ASKED, [])


def test_noise_of_the_torque_alone_does_not_lower_it() -> None:
    assert narrowed(ROBOT, [log(FRICTION, noise=2.0)], ASKED)[0] == ASKED


def test_a_single_knock_does_not_lower_it() -> None:
    run = log(FRICTION)
    q, tau = run["q"].copy(), run["tau"].copy()
    q[2000:2004, 0] += 0.004
    tau[1990:2010] += 30.0
    assert narrowed(ROBOT, [replace(run, signals={"q": q, "tau": tau})], ASKED)[0] == ASKED


def test_a_weight_or_a_unit_that_is_off_does_not_lower_it() -> None:
    run = log(FRICTION)
    for share in (0.05, 20.0):
        other = replace(run, signals={"q": run["q"], "tau": share * run["tau"]})
        assert narrowed(ROBOT, [other], ASKED)[0] == ASKED


def test_a_silent_joint_does_not_lower_it() -> None:
    run = log(FRICTION)
    tau = run["tau"].copy()
    tau[:, 1] = 0.0
    assert narrowed(ROBOT, [replace(run, signals={"q": run["q"], "tau": tau})], ASKED)[0] == ASKED


def shaken(seed: int = 1) -> Trajectory:
    """As :func:`log`, and the arm shakes at 12 to 17 Hz while it moves."""
    run = log([], seed)
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, (2, 3))
    waves = np.sin(2 * np.pi * np.array([12.1, 14.3, 16.7])[:, None, None] * run.time[:, None] + phase.T[:, None])
    q = run["q"] + 2e-4 * waves.sum(axis=0)
    dq = np.gradient(q, run.time, axis=0)
    tau = ROBOT.inverse_dynamics(q, dq, np.gradient(dq, run.time, axis=0))
    noise = 0.02 * np.random.default_rng(seed).normal(size=tau.shape)
    return replace(run, signals={"q": q, "tau": tau + noise})


def test_a_torque_that_was_smoothed_or_that_friction_made_needless_does_not_lower_it() -> None:
    """An arm that accelerates by its friction has no torque for that either."""
    assert narrowed(ROBOT, [shaken()], ASKED)[0] == ASKED
    assert narrowed(ROBOT, [smoothed(shaken(), 5.0)], ASKED)[0] == ASKED


def test_where_a_rotor_is_most_of_the_inertia_its_noise_counts() -> None:
    rotors = [Effect("armature", (name,), {"armature": 5.0}) for name in ROBOT.joint_names]
    # Next to this torque's own noise the links' inertia alone would be nothing.
    bare, heavy = (narrowed(ROBOT, [log(h, step=TWELVE_BITS / 3, noise=0.5)], ASKED)[0] for h in ([], rotors))
    assert heavy.cutoff < bare.cutoff


def test_what_the_noise_leaves_is_said_where_it_cannot_be_less() -> None:
    # Of six seconds the ends that a filter of less than 4 Hz spoils would be too large a part.
    short = log([], step=100 * TWELVE_BITS).rows(slice(0, 1200))
    settings, told = narrowed(ROBOT, [short], ASKED)
    assert 4.0 <= settings.cutoff < 5.0
    assert "inertias come out too small" in told[0]


def test_coarse_positions_make_no_names() -> None:
    train, test = log([], 1, step=TWELVE_BITS), log([], 2, "test", step=TWELVE_BITS)
    result = close_loop(ROBOT, [train], [test])
    assert result.diagnosis.verdict == "nothing_missing"
    assert result.model.effects == ()
    assert any("are noise of the positions" in note for note in result.diagnosis.notes)


def test_without_it_coarse_positions_pass_for_something_that_is_missing() -> None:
    train, test = log([], 1, step=TWELVE_BITS), log([], 2, "test", step=TWELVE_BITS)
    settings = LoopSettings(process=replace(ASKED, own_bandwidth=False))
    assert close_loop(ROBOT, [train], [test], settings).diagnosis.verdict != "nothing_missing"


def test_what_is_hidden_is_found_behind_coarse_positions() -> None:
    train, test = log(FRICTION, 1, step=TWELVE_BITS), log(FRICTION, 2, "test", step=TWELVE_BITS)
    result = close_loop(ROBOT, [train], [test])
    assert result.diagnosis.verdict == "explained"
    assert {(e.effect, *e.joints) for e in result.model.effects} == {(e.effect, *e.joints) for e in FRICTION}
    for hidden in FRICTION:
        (found,) = (e for e in result.model.effects if e.effect == hidden.effect)
        for name, value in hidden.parameters.items():
            assert abs(found.parameters[name] - value) < 4 * found.std_errors[name] + 0.01 * value


def test_a_model_keeps_its_bandwidth_and_predicts_at_it(tmp_path: Path) -> None:
    train, test = log(FRICTION, 1, step=TWELVE_BITS), log(FRICTION, 2, "test", step=TWELVE_BITS)
    result = close_loop(ROBOT, [train], [test])
    assert result.model.cutoff is not None
    result.model.save(tmp_path / "model.json")
    model = load_model(tmp_path / "model.json", ROBOT)
    assert model.cutoff == result.model.cutoff
    (run,) = result.test
    loops = np.sqrt(np.mean((run.tau - predict_run(result.model, run)) ** 2, axis=0))
    # Of the same rows but for where a filter's window ends.
    np.testing.assert_allclose(predict(model, test).rmse(ends=False), loops, rtol=0.05)
    wide = predict(replace(model, cutoff=None), test).rmse(ends=False)
    assert np.all(wide > 3 * loops)
    fine = close_loop(ROBOT, [log(FRICTION)], [log(FRICTION, 2, "test")]).model
    assert fine.cutoff is None
    fine.save(tmp_path / "fine.json")
    assert "cutoff" not in read_json(tmp_path / "fine.json", "a model")


def test_what_a_joint_turns_in_a_sample_is_no_step() -> None:
    run = log([])
    rng = np.random.default_rng(0)
    for noise in (0.0, 1e-6):
        q = run["q"].copy()
        q[:, 1] = 0.7 * run.time + noise * rng.normal(size=len(q))
        speed = np.stack([np.gradient(column, run.time) for column in run["q"].T], axis=1)
        speed[:, 1] = 0.7
        tau = ROBOT.inverse_dynamics(q, speed, np.gradient(speed, run.time, axis=0)) + 0.02 * rng.normal(size=q.shape)
        assert narrowed(ROBOT, [replace(run, signals={"q": q, "tau": tau})], ASKED)[0] == ASKED


def test_slow_motion_over_coarse_steps_is_as_coarse() -> None:
    """Where a joint stays on a step for many samples, next to nothing of it is far beyond the motion."""
    run = log([])
    time = run.time / 8.0
    slow = replace(run, signals={"q": np.stack([np.interp(time, run.time, c) for c in run["q"].T], axis=1)})
    speed = np.gradient(slow["q"], run.time, axis=0)
    tau = ROBOT.inverse_dynamics(slow["q"], speed, np.gradient(speed, run.time, axis=0))
    tau += 0.02 * np.random.default_rng(0).normal(size=tau.shape)
    coarse = np.round(slow["q"] / (4 * TWELVE_BITS)) * 4 * TWELVE_BITS
    assert narrowed(ROBOT, [replace(run, signals={"q": coarse, "tau": tau})], ASKED)[0].cutoff < 10.0


def fast(step: float, noise: float = 0.02) -> Trajectory:
    """Sines of 3 to 6 Hz: next to what accelerates there, no noise is much."""
    run = log([])
    waves = ((0.05, (3.0, 3.4), 0.0), (0.03, (4.3, 4.7), 1.0), (0.02, (5.6, 6.0), 2.0))
    q = sum(a * np.sin(2 * np.pi * np.array(f) * run.time[:, None] + p) for a, f, p in waves)
    assert isinstance(q, np.ndarray)
    dq = np.gradient(q, run.time, axis=0)
    tau = ROBOT.inverse_dynamics(q, dq, np.gradient(dq, run.time, axis=0))
    tau += noise * np.random.default_rng(3).normal(size=q.shape)
    return replace(run, signals={"q": np.round(q / step) * step, "tau": tau})


def test_noise_that_hides_small_torques_lowers_it_where_inertia_does_not_ask(monkeypatch: pytest.MonkeyPatch) -> None:
    run = fast(TWELVE_BITS)
    assert narrowed(ROBOT, [run], ASKED)[0].cutoff < 0.9 * ASKED.cutoff_at(run.dt)
    # Of two seconds the ends would be more than a tenth; and a sensor that scatters by more shows no more either.
    assert narrowed(ROBOT, [run.rows(slice(0, 400))], ASKED)[0] == ASKED
    assert narrowed(ROBOT, [fast(TWELVE_BITS, noise=3.0)], ASKED)[0] == ASKED
    monkeypatch.setattr(bandwidth, "_LOUD", 1.0)
    assert narrowed(ROBOT, [run], ASKED)[0] == ASKED


@pytest.mark.parametrize("times", [16, 64])
def test_the_motion_itself_is_not_lost(times: int) -> None:
    assert narrowed(ROBOT, [fast(times * TWELVE_BITS)], ASKED)[0].cutoff > 6.0


def with_speed(run: Trajectory, noise: float) -> Trajectory:
    speed = np.gradient(run["q"], run.time, axis=0)
    speed += noise * np.random.default_rng(5).normal(size=speed.shape)
    return replace(run, signals={**run.signals, "dq": speed})


def test_a_measured_velocity_tells_by_its_own_noise() -> None:
    run = log([])
    assert narrowed(ROBOT, [with_speed(run, 1e-4)], ASKED)[0] == ASKED
    assert narrowed(ROBOT, [with_speed(run, 0.05)], ASKED)[0].cutoff < 12.0


@pytest.mark.parametrize("over", [1, 2])
def test_a_velocity_made_of_differences_costs_no_bandwidth(over: int) -> None:
    coarse = log([], step=TWELVE_BITS / 4)
    alone = narrowed(ROBOT, [coarse], ASKED)[0].cutoff
    q = coarse["q"]
    dq = np.gradient(q, coarse.time, axis=0) if over == 2 else np.diff(q, axis=0, prepend=q[:1]) / coarse.dt
    both = narrowed(ROBOT, [replace(coarse, signals={**coarse.signals, "dq": dq})], ASKED)[0].cutoff
    assert both > 0.8 * alone


def test_runs_are_judged_at_their_own_rates() -> None:
    fine, coarse = log([]), log([], 2, step=TWELVE_BITS / 8)
    slow = replace(coarse, time=coarse.time[::4], signals={k: v[::4] for k, v in coarse.signals.items()})
    assert narrowed(ROBOT, [slow], ASKED)[0] == ASKED
    assert narrowed(ROBOT, [fine, slow], ASKED)[0] == ASKED


def test_no_run_becomes_too_short_by_it() -> None:
    coarse, short = log([], step=16 * TWELVE_BITS), log([], 2, "test").rows(slice(0, 300))
    alone = narrowed(ROBOT, [coarse], ASKED)[0]
    beside = narrowed(ROBOT, [coarse], ASKED, [short])[0]
    assert least_rows(short.dt, alone) > len(short.time) >= least_rows(short.dt, beside)
    held_out = narrowed(ROBOT, [coarse], ASKED, held_out=0.075)[0]
    assert least_rows(short.dt, held_out) <= 0.075 * len(coarse.time)
    # One that was too short before says nothing.
    assert narrowed(ROBOT, [coarse], ASKED, [short.rows(slice(0, 60))])[0] == alone


def test_a_dead_sensor_does_not_lower_it() -> None:
    run = log(FRICTION, step=TWELVE_BITS / 32)
    assert narrowed(ROBOT, [run], ASKED)[0] == ASKED
    tau = run["tau"].copy()
    tau[:, 1] = 1e-3 * np.random.default_rng(0).normal(size=len(tau))
    assert narrowed(ROBOT, [replace(run, signals={"q": run["q"], "tau": tau})], ASKED)[0] == ASKED


@pytest.mark.parametrize("share", [0.5, -1.0], ids=["half the weight", "upside down"])
def test_a_weight_that_is_off_makes_no_rotors(share: float) -> None:
    """A motion whose fastest part is small, of an arm that weighs otherwise: its inertia is as described."""
    run = log([])
    wave = 0.005 * np.sin(2 * np.pi * np.array([2.0, 2.4]) * run.time[:, None])
    q = run["q"] + wave
    dq = np.gradient(q, run.time, axis=0)
    ddq = np.gradient(dq, run.time, axis=0)
    still = np.zeros_like(q)
    weight = ROBOT.inverse_dynamics(q, still, still)
    tau = ROBOT.inverse_dynamics(q, dq, ddq) + (share - 1.0) * weight
    tau += 0.02 * np.random.default_rng(0).normal(size=tau.shape)
    odd = replace(run, signals={"q": q, "tau": tau})
    np.testing.assert_allclose(as_heard(ROBOT, [odd], ASKED).rotors, 0.0, atol=0.02)
    assert narrowed(ROBOT, [odd], ASKED)[0] == ASKED


@pytest.mark.parametrize("rotors", [(0.0, 0.0), (0.5, 0.2)])
def test_the_inertia_of_a_log_is_heard(rotors: tuple[float, float]) -> None:
    run = shaken()
    dq = np.gradient(run["q"], run.time, axis=0)
    ddq = np.gradient(dq, run.time, axis=0)
    tau = ROBOT.inverse_dynamics(run["q"], dq, ddq) + ddq * rotors
    heard = as_heard(ROBOT, [replace(run, signals={"q": run["q"], "tau": tau})], ASKED)
    assert heard.alive.all()
    unit = np.zeros((1, 2)) + 1.0
    links = ROBOT.inverse_dynamics(unit * 0, unit * 0, unit) - ROBOT.inverse_dynamics(unit * 0, unit * 0, unit * 0)
    np.testing.assert_allclose(heard.inertial(links, unit), links + np.array(rotors), rtol=0.1)
