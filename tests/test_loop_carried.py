"""An all-clear that the test runs deny is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.loop import LoopSettings, close_loop
from hybrid_dynamics.loop.carried import CARRIED, carried_over
from hybrid_dynamics.loop.process import ProcessSettings, process
from hybrid_dynamics.trajectory import Trajectory

ROBOT = arm()
SETTINGS = LoopSettings(effects=("coulomb_friction", "viscous_friction"), sign_widths=(0.0,))
GREASE = Effect("viscous_friction", ("elbow",), {"viscous_coefficient": 1.0})
NOISE = 0.1


def _log(seed: int, split: str, torque: float = 0.0, noise: float = NOISE, hertz: float = 2.3) -> Trajectory:
    """A run of the arm; ``torque`` [N m] of the shoulder, a wave in time, as no motion has it."""
    log = noisy_log([GREASE], seed, split, noise)
    wave = torque * np.sqrt(2) * np.sin(2 * np.pi * hertz * log.time)
    return replace(log, signals={**log.signals, "tau": log["tau"] + np.outer(wave, [1.0, 0.0])})


@pytest.mark.parametrize("hertz", [2.3, 0.15])
@pytest.mark.parametrize("seed", range(3))
def test_a_test_run_that_leaves_more_is_no_all_clear(seed: int, hertz: float) -> None:
    train = [_log(10 * seed + k, "train") for k in (1, 2)]
    clear = close_loop(ROBOT, train, [_log(10 * seed + 5, "test")], SETTINGS).diagnosis
    assert clear.verdict == "explained"
    assert not any(clear.worse_on_test)
    # A third of the raw noise, of which the filter leaves less: twice what is left otherwise.
    found = close_loop(ROBOT, train, [_log(10 * seed + 5, "test", torque=NOISE, hertz=hertz)], SETTINGS).diagnosis
    assert found.worse_on_test == (True, False)
    assert found.verdict == "partly_explained"
    assert any("the test runs leave" in note and "shoulder" in note for note in found.notes)
    assert [u["joint"] for u in found.unexplained] == ["shoulder"]


def test_a_noisier_test_run_is_no_reason_to_doubt_the_model() -> None:
    train = [_log(k, "train") for k in (1, 2)]
    found = close_loop(ROBOT, train, [_log(5, "test", noise=3 * NOISE)], SETTINGS).diagnosis
    assert found.verdict == "explained"
    assert not any(found.worse_on_test)


def test_how_much_more_is_measured() -> None:
    rng = np.random.default_rng(0)
    settings = LoopSettings()
    runs = [process(_log(k, "train"), ROBOT, ProcessSettings()) for k in (1, 2)]
    parts = [(run, rng.normal(size=run.tau.shape), run.mask) for run in runs]
    nothing = np.zeros(2)
    slow = np.sin(runs[1].time)[:, None] * 2.0
    more = [(runs[1], parts[1][1] + slow, runs[1].mask)]
    found = carried_over(parts[:1], more, nothing, settings)
    assert found.times == pytest.approx([np.sqrt(3.0)] * 2, rel=0.15)  # variances 1 and 2 of independent parts
    assert found.worse.all()
    assert not carried_over(parts[:1], more, np.full(2, 3.0), settings).worse.any()  # the steps of the torque may do it
    same = carried_over(parts[:1], parts[1:], nothing, settings)
    assert same.times == pytest.approx([1.0, 1.0], rel=0.15)
    assert not same.worse.any()
    assert np.sqrt(3.0) > CARRIED
