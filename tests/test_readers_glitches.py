"""Single samples that are none: found wherever they are put, and nothing else is touched."""

import numpy as np
import pytest

from hybrid_dynamics.readers.glitches import find_glitches, repair, told
from hybrid_dynamics.trajectory import Trajectory

TIMES = (0.0, 10.0)


def motion(rate: float, noise: float = 0.01) -> Trajectory:
    """Three joints: gravity and friction; friction alone; a joint at rest."""
    rng = np.random.default_rng(0)
    time = np.arange(*TIMES, 1 / rate)
    phase = np.outer(time, [1.3, 2.1, 0.0]) + np.array([0.2, 1.0, 0.0])
    q, dq = np.sin(phase), np.cos(phase) * np.array([1.3, 2.1, 0.0])
    tau = np.array([8.0, 0.0, 0.0]) * np.sin(q) + np.array([1.0, 2.0, 0.0]) * np.sign(dq) + np.array([0.0, 0.0, 1.0])
    tau += noise * rng.normal(size=tau.shape)
    return Trajectory("run", "train", time, {"q": q, "dq": dq + 1e-3 * rng.normal(size=dq.shape), "tau": tau})


@pytest.mark.parametrize("rate", [100.0, 250.0, 1000.0])
@pytest.mark.parametrize("signal", ["q", "dq", "tau"])
@pytest.mark.parametrize("share", [1e-3, 1e-2])
@pytest.mark.parametrize("times", [3.0, 1000.0])
def test_glitches_of_any_size_and_number_are_found_and_nothing_else(rate, signal, share, times):
    run = motion(rate)
    rng = np.random.default_rng(1)
    put = np.zeros(run[signal].shape, bool)
    # The first and the last samples are cut off by every filter: whether they stand alone cannot be known.
    put[rng.choice(np.arange(3, len(put) - 3), max(round(share * len(put)), 1), replace=False)] = True
    spoilt = run[signal] + put * times * np.maximum(run[signal].std(axis=0), 0.05) * rng.choice([-1, 1], put.shape)
    found = find_glitches(spoilt, 1 / rate, signal)
    missed, false = put & ~found, found & ~put
    assert missed.sum() <= 0.02 * put.sum()
    assert false.sum() <= max(0.02 * put.sum(), 1)
    mended, _ = repair(run.with_signals(**{signal: spoilt}))
    # What stays is as large as the signal itself at the very most.
    assert np.abs(mended[signal] - run[signal]).max() < 4 * max(np.ptp(run[signal]), 0.1)
    left = np.sqrt(np.mean((mended[signal] - run[signal]) ** 2, axis=0))
    assert np.all(left < 0.1 * np.maximum(run[signal].std(axis=0), 0.05))


def test_absurd_and_missing_values_are_left_out_with_their_number_times_and_sizes():
    run = motion(500.0)
    tau = run["tau"].copy()
    tau[1000, 0], tau[2000, 1], tau[3000:3002, 2] = 1e300, np.nan, [-1e300, 1e9]
    mended, found = repair(run.with_signals(tau=tau))
    assert {(g.signal, g.joint): g.rows.tolist() for g in found} == {
        ("tau", 0): [1000],
        ("tau", 1): [2000],
        ("tau", 2): [3000, 3001],
    }
    assert np.abs(mended["tau"] - run["tau"]).max() < 1.0
    lines = told(found, ("a", "b", "c"), len(tau))
    assert len(lines) == 1
    assert "4 samples of tau (a 1, b 1, c 2; of 5000 each) stand alone, at 2, 4, 6, 6.002 s" in lines[0]
    assert told(found[:1], ("a", "b", "c"), len(tau))[0].startswith("1 sample of tau (a 1; of 5000 each) stands alone")


def test_friction_reversals_contacts_and_noise_stay_as_they_are():
    run = motion(500.0, noise=0.3)
    same, found = repair(run)
    assert found == []
    assert same is run
    # A contact of 40 ms in which the torque rises and falls within two samples each.
    tau = run["tau"].copy()
    tau[2000:2020] += np.array([15.0, 5.0, 2.0])
    mended, found = repair(run.with_signals(tau=tau))
    assert found == []
    np.testing.assert_array_equal(mended["tau"], tau)
    # Chatter at rest: the torque jumps to and fro between both values of stiction for a while.
    tau = run["tau"].copy()
    tau[1000:1100, 1] = 2.0 * np.random.default_rng(2).choice([-1.0, 1.0], 100)
    assert repair(run.with_signals(tau=tau))[1] == []


def test_a_signal_full_of_departures_is_left_alone():
    run = motion(500.0)
    tau = run["tau"].copy()
    tau[::12, 0] += 20.0
    assert all(g.joint != 0 for g in repair(run.with_signals(tau=tau))[1])


@pytest.mark.parametrize("rate", [8.0, 10.0, 20.0])
@pytest.mark.parametrize("phase", [0.0, 0.3, 1.1])
def test_a_motion_that_a_slow_log_hardly_resolves_is_no_glitch(rate, phase):
    """At a turning point the running median is far away, but the neighbours know where the sample is."""
    time = np.arange(0.0, 20.0, 1 / rate)
    q = np.sin(2 * np.pi * np.outer(time, [0.3, 0.39]) + phase) * np.array([1.0, 0.4])
    clean = Trajectory("slow", "train", time, {"q": q})
    same, found = repair(clean)
    assert found == []
    assert same is clean
    # The control: a sample that the neighbours know nothing of.
    spoilt = q.copy()
    spoilt[50] += 3.0 * q.std(axis=0)
    mended, found = repair(clean.with_signals(q=spoilt))
    assert {g.joint: g.rows.tolist() for g in found} == {0: [50], 1: [50]}
    assert np.abs(mended["q"] - q).max() < 1e-3
