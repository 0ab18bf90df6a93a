"""Friction that changes while a run lasts: named where the catalogue is asked, no all-clear where it is not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log
from tests.test_loop_beside import judged

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.effects.drift import Drift
from hybrid_dynamics.loop import LoopSettings, Model, close_loop
from hybrid_dynamics.loop.diagnosis import Diagnosis
from hybrid_dynamics.loop.further import further_candidates
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.process import process
from hybrid_dynamics.loop.warming import friction_in_time, linear_prediction
from hybrid_dynamics.trajectory import Trajectory

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
COULOMB = Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 3.0})
#: Of the torque [N m].
NOISE = 0.2
#: Warm after two time constants: 1.3 of the 3 N m are gone at the end of a run.
WARMING = Effect("drift", (SHOULDER,), {"rate": -0.15, "time_constant": 10.0}, {"of": "coulomb"})


def _closed(effects: Sequence[Effect], settings: LoopSettings | None = None) -> Diagnosis:
    train = [noisy_log(effects, seed, "train", NOISE) for seed in (1, 2, 3)]
    return close_loop(ROBOT, train, [noisy_log(effects, 4, "test", NOISE)], settings).diagnosis


def _named(found: Diagnosis) -> list[tuple[str, str]]:
    return [(e.effect.effect, " ".join(e.effect.joints)) for e in found.effects]


def test_friction_that_warms_up_is_named_with_its_rate() -> None:
    found = _closed([COULOMB, WARMING])
    assert set(_named(found)) == {("coulomb_friction", SHOULDER), ("drift", SHOULDER)}
    assert found.verdict == "explained"
    drift = next(e.effect for e in found.effects if e.effect.effect == "drift")
    assert drift.settings["of"] == "coulomb"
    rate, constant = drift.parameters["rate"], drift.parameters["time_constant"]
    # What has gone when the run ends; rate and time constant take each other's part.
    gone = rate * constant * (1 - np.exp(-20.0 / constant))
    assert gone == pytest.approx(-0.15 * 10.0 * (1 - np.exp(-2.0)), rel=0.1)
    # Control: friction that stays as it is has no drift.
    assert _named(_closed([COULOMB])) == [("coulomb_friction", SHOULDER)]


@pytest.mark.parametrize(
    ("runs", "seconds", "asked"), [(1, 20.0, False), (2, 10.0, False), (2, 20.0, True), (1, 40.0, True)]
)
def test_short_logs_are_not_asked_what_changes_while_they_last(runs: int, seconds: float, asked: bool) -> None:
    logs = [_at_length(noisy_log([COULOMB, WARMING], seed, "train", NOISE), seconds) for seed in range(runs)]
    settings = LoopSettings()
    read = read_motion(ROBOT, logs, [noisy_log([COULOMB], 9, "test", NOISE)], settings)
    judge, terms, _ = gather(Model(ROBOT), read, settings)
    dry = next(t for t in terms if t.effect == "coulomb_friction" and t.joint == 0)
    _, offered = further_candidates(judge.at([dry]), [dry])
    assert any(t.effect == "drift" for t in offered) is asked
    # What is no law of the time is asked of either.
    assert any(t.effect != "drift" for t in offered)


@pytest.mark.slow
def test_friction_that_changes_in_one_short_run_is_no_all_clear() -> None:
    train, test = (noisy_log([COULOMB, WARMING], seed, split, NOISE) for seed, split in ((1, "train"), (4, "test")))
    found = close_loop(ROBOT, [train], [test]).diagnosis
    assert "drift" not in {name for name, _ in _named(found)}
    assert found.verdict != "explained"


def _at_length(log: Trajectory, seconds: float) -> Trajectory:
    """The first ``seconds`` of ``log``, which begins anew behind its end."""
    rows = np.arange(round(seconds / log.dt))
    signals = {name: log[name][rows % len(log.time)] for name in ("q", "dq", "tau")}
    return Trajectory(log.name, log.split, rows * log.dt, signals)


def test_friction_that_is_missing_is_no_friction_that_grows(monkeypatch: pytest.MonkeyPatch) -> None:
    judge, _, _ = judged([Effect("viscous_friction", (SHOULDER,), {"viscous_coefficient": 1.0})])
    growing = Term("drift", 0, (("of", "viscous"), ("time_constant", 30.0)))
    judge = judge.adding([growing])
    assert not judge.worth([growing], growing).surer_than(0.0)
    # Control: over nothing at all it gains surely, as what stands for something does.
    monkeypatch.setattr(Drift, "beside", ())
    assert judge.worth([growing], growing).surer_than(judge.settings.gain_in_errors)


@pytest.mark.slow
def test_what_follows_the_time_of_a_run_is_no_all_clear() -> None:
    plain = LoopSettings(effects=("coulomb_friction", "viscous_friction", "torque_offset"))
    found = _closed([COULOMB, WARMING], plain)
    assert found.verdict == "partly_explained"
    assert list(found.motion_dependent) == [True, False]
    # Control: without it nothing is left.
    assert _closed([COULOMB], plain).verdict == "explained"


def test_friction_in_time_is_learned_on_other_runs_and_nothing_is_of_noise() -> None:
    rng = np.random.default_rng(0)
    runs = [process(noisy_log([], seed, "train", NOISE), ROBOT, LoopSettings().process) for seed in (1, 2, 3)]
    x = np.vstack([friction_in_time(run, 0, 20.0) for run in runs])
    since = np.concatenate([run.time - run.time[0] for run in runs])
    fold = np.concatenate([np.full(len(run.time), r) for r, run in enumerate(runs)])
    keep = np.ones(len(fold), bool)
    noise = 0.5 * rng.normal(size=len(fold))
    fading = np.sign(np.concatenate([run.dq[:, 0] for run in runs])) * np.exp(-since / 10.0)
    left = {name: y - linear_prediction(x, y, keep, fold) for name, y in (("fading", fading + noise), ("none", noise))}
    # What a parabola leaves of the exponential, and six numbers of the noise of two runs.
    assert np.mean(left["fading"] ** 2) < 1.02 * np.mean(noise**2)
    assert np.mean(left["none"] ** 2) == pytest.approx(np.mean(noise**2), rel=0.02)
    # Rows that nobody uses are not predicted.
    assert not linear_prediction(x, fading, keep, np.where(fold == 1, -1, fold))[fold == 1].any()
