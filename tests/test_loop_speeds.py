"""Whose speeds a motion is made of: logged ones that are late, noisy or coarse, and those of a sensor of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from tests.small_arm import arm, noisy_log

from hybrid_dynamics import Model, close_loop, predict
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.loop.process import ProcessSettings
from hybrid_dynamics.loop.speeds import judged, truer_speeds
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

ROBOT = arm()
ASKED = ProcessSettings()
HIDDEN = [
    Effect("viscous_friction", ("shoulder",), {"viscous_coefficient": 0.8}),
    Effect("coulomb_friction", ("elbow",), {"coulomb_torque": 0.4}),
]
#: Steps [rad] of a ten-bit and of a twenty-bit encoder.
COARSE, FINE = 2 * np.pi / 2**10, 2 * np.pi / 2**20


def late(speed: Array, dt: float) -> Array:
    """Behind the first-order low-pass of a drive, 8 ms."""
    share = dt / (dt + 0.008)
    return np.asarray(lfilter([share], [1, share - 1], speed, axis=0))


def log(speed: str, seed: int = 1, split: str = "train", step: float = FINE) -> Trajectory:
    """Positions in steps of ``step`` [rad] and a logged ``speed``, of which the torque knows nothing."""
    run = noisy_log(HIDDEN, seed, split, 0.02)
    true = np.gradient(run["q"], run.time, axis=0)
    noise = np.random.default_rng(seed + 100).normal(size=true.shape)
    q = np.round(run["q"] / step) * step
    logged = {
        "late": late(true, run.dt),
        "noisy": true + 0.03 * noise,
        "coarse": np.round(true / 0.05) * 0.05,
        "tachometer": true + 0.002 * noise,
        "difference": np.gradient(q, run.time, axis=0),
    }
    return replace(run, signals={"q": q, "tau": run["tau"], "dq": logged[speed]})


@pytest.mark.parametrize("speed", ["late", "noisy", "coarse"])
def test_worse_speeds_than_the_positions_own_are_left_out_of_all_runs(speed: str) -> None:
    train, test, told = truer_speeds(ROBOT, [log(speed)], [log(speed, 2, "test")], ASKED)
    assert all("dq" not in run for run in (*train, *test))
    assert len(told) == 1
    assert "the derivative of q is taken instead of dq" in told[0]


@pytest.mark.parametrize(("speed", "step"), [("tachometer", COARSE), ("difference", FINE), ("difference", COARSE)])
def test_a_sensor_of_its_own_beside_coarse_positions_is_kept_and_so_is_what_differs_by_nothing(
    speed: str, step: float
) -> None:
    runs, tests = (log(speed, step=step),), (log(speed, 2, "test", step),)
    assert truer_speeds(ROBOT, runs, tests, ASKED) == (runs, tests, [])


def test_speeds_that_only_the_test_runs_have_spoilt_are_left_out_there() -> None:
    bad, bare = log("late", 2, "test"), noisy_log(HIDDEN, 3, "train", 0.02)
    for train in (log("difference"), bare):
        learned, tests, told = truer_speeds(ROBOT, [train], [bad], ASKED)
        assert learned == (train,)
        assert "dq" not in tests[0]
        assert len(told) == 1
        assert told[0].startswith("test runs: ")
    # Control: good ones stay.
    good = log("difference", 2, "test")
    assert truer_speeds(ROBOT, [bare], [good], ASKED) == ((bare,), (good,), [])


@pytest.mark.parametrize("still", [0.3, None], ids=["stands", "turns evenly"])
def test_a_joint_that_does_not_accelerate_says_nothing_of_the_others(still: float | None) -> None:
    run = log("tachometer", step=COARSE)
    q, dq = run["q"].copy(), run["dq"].copy()
    q[:, 1] = np.round((run.time if still is None else still + 0.0 * run.time) / FINE) * FINE
    dq[:, 1] += (0.0 if still is not None else 1.0) - (run["dq"][:, 1] - 2e-5 * np.sin(50.0 * run.time))
    found = judged([run.with_signals(q=q, dq=dq)], ASKED)
    assert found is not None
    assert not found.worse.any()


def test_what_differs_is_the_lag_times_the_jerk() -> None:
    run = log("late")
    found = judged([run], ASKED)
    assert found is not None
    acceleration = np.gradient(np.gradient(run["q"], run.time, axis=0), run.time, axis=0)
    # Steps of 20 bits make accelerations of their own; smooth ones as the loop does, within its band.
    kernel = np.hanning(21) / np.hanning(21).sum()
    smooth = np.apply_along_axis(np.convolve, 0, acceleration, kernel, "same")
    jerk = np.gradient(smooth, run.time, axis=0)[40:-40]
    np.testing.assert_allclose(found.off, 0.008 * np.sqrt(np.mean(jerk**2, axis=0)), rtol=0.2)
    assert found.worse.all()
    # Twenty bits at 200 Hz: what is rounded away is white, a twelfth of a squared step, up to half the rate.
    f = np.linspace(0.0, found.cutoff, 1000)
    rounded = np.sqrt(np.sum((2 * np.pi * f) ** 4) * f[1] * FINE**2 / 12 * 2 * run.dt)
    assert np.all(found.scatter < rounded)


def test_late_speeds_give_the_names_that_none_give() -> None:
    """Before, a delay came in for them that the torque does not have."""

    def found(speed: str | None) -> dict[tuple[str, tuple[str, ...]], dict[str, float]]:
        train, test = [log("late")], [log("late", 2, "test")]
        if speed is None:
            train, test = ([replace(r, signals={"q": r["q"], "tau": r["tau"]}) for r in rs] for rs in (train, test))
        result = close_loop(ROBOT, train, test)
        said = [line for line in result.diagnosis.to_json()["notes"] if "derivative of q" in line]
        assert len(said) == (speed is not None)
        return {(e.effect, e.joints): dict(e.parameters) for e in result.model.effects}

    names = found("late")
    assert names == found(None)
    assert set(names) == {("viscous_friction", ("shoulder",)), ("coulomb_friction", ("elbow",))}


def test_a_prediction_follows_the_same_speeds_and_says_so() -> None:
    lines: list[str] = []
    run = log("late")
    bare = replace(run, signals={"q": run["q"], "tau": run["tau"]})
    model = Model(ROBOT).adding(HIDDEN)
    own, other = predict(model, run, notify=lines.append), predict(model, bare)
    np.testing.assert_array_equal(own.tau, other.tau)
    assert [line for line in lines if "derivative of q" in line]
    assert not np.array_equal(predict(model, log("tachometer", step=COARSE)).tau, other.tau)
