"""A log's own bandwidth: coarse positions, a torque that was smoothed, and what is none of these."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics import LoopSettings, Model, close_loop, predict
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.loop.bandwidth import narrowed
from hybrid_dynamics.loop.process import ProcessSettings, hann_kernel
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


def test_a_torque_that_was_smoothed_lowers_it_to_where_it_is_whole() -> None:
    whole = shaken()
    assert narrowed(ROBOT, [whole], ASKED)[0] == ASKED, "an arm that shakes and whose torque says so"
    settings, told = narrowed(ROBOT, [smoothed(whole, 5.0)], ASKED)
    assert 1.0 < settings.cutoff < 12.0
    assert "smoothed before it was logged" in told[0]


def test_where_a_rotor_is_most_of_the_inertia_its_noise_counts() -> None:
    rotors = [Effect("armature", (name,), {"armature": 5.0}) for name in ROBOT.joint_names]
    # Next to this torque's own noise the links' inertia alone would be nothing.
    bare, heavy = (narrowed(ROBOT, [log(h, step=TWELVE_BITS / 3, noise=0.5)], ASKED)[0] for h in ([], rotors))
    assert heavy.cutoff < bare.cutoff


def test_what_the_noise_leaves_is_said_where_it_cannot_be_less() -> None:
    # Of six seconds the ends that a filter of less than 4 Hz spoils would be too large a part.
    short = log([], step=50 * TWELVE_BITS).rows(slice(0, 1200))
    settings, told = narrowed(ROBOT, [short], ASKED)
    assert 4.0 <= settings.cutoff < 4.5
    assert "inertias come out too small" in told[0]


def test_coarse_positions_make_no_names() -> None:
    train, test = log([], 1, step=TWELVE_BITS), log([], 2, "test", step=TWELVE_BITS)
    result = close_loop(ROBOT, [train], [test])
    assert result.diagnosis.verdict == "nothing_missing"
    assert result.model.effects == ()
    assert any("positions too coarse" in note for note in result.diagnosis.notes)


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


def test_a_prediction_has_the_bandwidth_of_its_log_with_torque_and_without() -> None:
    model, notes = Model(ROBOT), list[str]()
    fine, coarse = log([]), log([], step=TWELVE_BITS)
    truth = predict(model, fine).tau
    off = np.sqrt(np.mean((predict(model, coarse, notify=notes.append).tau - truth) ** 2))
    assert any("positions too coarse" in note for note in notes)
    fixed = replace(ASKED, own_bandwidth=False)
    assert off < 0.2 * np.sqrt(np.mean((predict(model, coarse, fixed).tau - truth) ** 2))
    bare = replace(coarse, signals={"q": coarse["q"]})
    np.testing.assert_allclose(predict(model, bare).tau, truth, atol=20 * off)
