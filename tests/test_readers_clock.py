"""At which instants samples were taken: by the stamps, or evenly, as the positions say."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.small_arm import arm

from hybrid_dynamics import Model, predict
from hybrid_dynamics.readers.clock import truer_stamps
from hybrid_dynamics.readers.resample import resample
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

STEP, ROWS = 0.008, 1000


def motion(time: Array, seed: int = 0) -> Array:
    """Two joints at ``time``: sums of sines below 1 Hz, with the noise of a fine encoder."""
    rng = np.random.default_rng(seed)
    speed, phase = np.array([[0.9, 1.7, 3.1], [1.1, 2.3, 3.7]]), rng.uniform(0, 2 * np.pi, (2, 3))
    q = np.einsum("k,jkt->tj", [0.5, 0.25, 0.1], np.sin(speed[..., None] * time + phase[..., None]))
    return np.asarray(q + 1e-6 * rng.normal(size=q.shape))


def log(time: Array, true: Array, seed: int = 0) -> Trajectory:
    """Stamps ``time`` of samples taken at ``true``."""
    return Trajectory("log", "train", time, {"q": motion(true, seed), "tau": motion(true, seed + 1)})


def received(true: Array, late: float, seed: int = 0) -> Array:
    """When a message of every sample came: late by up to ``late`` steps, one of a hundred by most of one more."""
    rng = np.random.default_rng(seed)
    time = true + late * STEP * rng.random(len(true))
    time[rng.random(len(true)) < 0.01] += 0.6 * STEP
    return np.sort(time)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), late=st.floats(0.05, 0.9))
def test_stamps_of_receipt_are_taken_as_even(seed: int, late: float) -> None:
    true = STEP * np.arange(ROWS)
    found = truer_stamps(received(true, late, seed), motion(true, seed))
    steps = np.diff(found)
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-9)
    assert np.abs(found - true).max() < 2 * STEP


def test_a_clock_that_wanders_is_followed() -> None:
    """Every second four in a hundred slower and as much faster: by five steps it leaves an even one."""
    rate = 1.0 + 0.04 * np.sign(np.sin(2 * np.pi * np.arange(ROWS) / ROWS))
    true = STEP * np.cumsum(rate)
    stamps = received(true, 0.5)
    found = truer_stamps(stamps, motion(true))
    assert found is not stamps
    late = stamps - true
    # What is left of the lateness is its mean, and that over a while.
    assert np.std(found - true) < 0.5 * np.std(late)
    assert np.abs(np.diff(found) / np.diff(true) - 1)[30:-30].mean() < 0.01


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), uneven=st.floats(0.01, 0.9))
def test_instants_that_are_uneven_themselves_keep_their_stamps(seed: int, uneven: float) -> None:
    rng = np.random.default_rng(seed)
    true = STEP * (np.arange(ROWS) + uneven * (rng.random(ROWS) - 0.5))
    assert truer_stamps(true, motion(true, seed)) is true


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), lost=st.floats(0.005, 0.1))
def test_lost_samples_are_told_from_late_stamps(seed: int, lost: float) -> None:
    rng = np.random.default_rng(seed)
    kept = rng.random(ROWS) > lost
    kept[[0, -1]] = True
    true = (STEP * np.arange(ROWS))[kept]
    stamps = true + 0.15 * STEP * rng.random(len(true))
    found = truer_stamps(stamps, motion(true, seed))
    ticks = (found - found[0]) / (found[-1] - found[0]) * (ROWS - 1)
    np.testing.assert_allclose(ticks, np.flatnonzero(kept) - np.flatnonzero(kept)[0], atol=1e-6)


@pytest.mark.parametrize("share", [0.0, 1e-3], ids=["still", "rests"])
def test_an_arm_that_rests_tells_nothing_of_its_clock(share: float) -> None:
    true = STEP * np.arange(ROWS)
    stamps = received(true, 0.5)
    assert truer_stamps(stamps, share * motion(true)) is stamps


def test_samples_that_are_taken_as_even_stay_as_they_are_and_it_is_said() -> None:
    true = STEP * np.arange(ROWS)
    lines: list[str] = []
    run = log(received(true, 0.5), true)
    (part,) = resample(run, None, lines.append)
    np.testing.assert_array_equal(part["q"], run["q"])
    np.testing.assert_array_equal(part["tau"], run["tau"])
    assert len(lines) == 1
    assert "the samples are taken as that clock's" in lines[0]
    # Control: the same stamps of samples that were taken then.
    (other,) = resample(log(run.time, run.time), None, lines.append)
    assert "resampled to" in lines[1]
    assert len(lines) == 2
    assert other.dt == pytest.approx(float(np.median(np.diff(run.time))), rel=1e-6)


@pytest.mark.parametrize("lost", [3, 6])
def test_a_clock_that_wanders_does_not_pass_over_what_was_lost(lost: int) -> None:
    rate = 1.0 + 0.04 * np.sign(np.sin(2 * np.pi * np.arange(ROWS) / ROWS))
    true = STEP * np.cumsum(rate)
    kept = ~np.isin(np.arange(ROWS) % 160, 80 + np.arange(lost))
    stamps = received(true, 0.5)[kept]
    found = truer_stamps(stamps, motion(true[kept]))
    assert np.abs(found - true[kept]).max() <= np.abs(stamps - true[kept]).max() + 1e-9


def test_a_rate_that_changes_is_not_smeared() -> None:
    true = np.cumsum(np.where(np.arange(ROWS) < ROWS // 2, STEP, STEP / 2))
    stamps = true + 0.1 * STEP * np.random.default_rng(0).random(ROWS)
    found = truer_stamps(stamps, motion(true))
    assert np.abs(found - true).max() < 0.2 * STEP


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", ["late", "wanders", "polled"])
def test_every_row_of_a_log_has_a_prediction(kind: str, seed: int) -> None:
    rate = 1.0 + 0.04 * np.sign(np.sin(2 * np.pi * np.arange(ROWS) / ROWS))
    true = STEP * (np.cumsum(rate) if kind == "wanders" else np.arange(ROWS))
    run = log(received(true, 0.5, seed), true, seed)
    if kind == "polled":
        taken = log(true, true, seed).rows(np.minimum(np.floor(np.arange(ROWS) / (1.5 + 2 * seed)), ROWS).astype(int))
        run = Trajectory("log", "train", true, taken.signals)
    assert np.isfinite(predict(Model(arm()), run).tau).all()


def test_a_prediction_along_a_clock_that_wanders_is_that_of_the_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    rate = 1.0 + 0.04 * np.sign(np.sin(2 * np.pi * np.arange(ROWS) / ROWS))
    true = STEP * np.cumsum(rate)
    model = Model(arm())

    def rms(x: Array) -> float:
        return float(np.sqrt(np.mean(x[100:-100] ** 2)))

    truth, late = (predict(model, log(stamps, true)).tau for stamps in (true, received(true, 0.5)))
    assert rms(late - truth) < 0.02 * rms(truth)
    # Control: at the recorded stamps noise of theirs is most of what accelerates.
    for module in ("loop.prediction", "readers.resample"):
        monkeypatch.setattr(sys.modules[f"hybrid_dynamics.{module}"], "truer_stamps", lambda time, q: time)
    assert rms(predict(model, log(received(true, 0.5), true)).tau - truth) > 0.1 * rms(truth)


def test_a_prediction_of_late_stamps_belongs_to_the_rows_of_the_log() -> None:
    true = STEP * np.arange(ROWS)
    model = Model(arm())
    even, late = (predict(model, log(stamps, true)).tau for stamps in (true, received(true, 0.5)))
    # The clock's rate is told from the first and last stamp: within a step of the whole.
    assert np.abs(late - even).max() < 0.02 * np.abs(even).max()
    shifted = np.abs(late[1:] - even[:-1])[100:-100].max()
    assert np.abs(late - even)[100:-100].max() < 0.2 * shifted
