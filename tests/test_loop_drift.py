"""Friction that changes while a run lasts: named where the catalogue is asked, no all-clear where it is not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.loop import LoopSettings, close_loop
from hybrid_dynamics.loop.diagnosis import Diagnosis

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


def test_what_follows_the_time_of_a_run_is_no_all_clear() -> None:
    plain = LoopSettings(effects=("coulomb_friction", "viscous_friction", "torque_offset"))
    found = _closed([COULOMB, WARMING], plain)
    assert found.verdict == "partly_explained"
    assert list(found.motion_dependent) == [True, False]
    # Control: without it nothing is left.
    assert _closed([COULOMB], plain).verdict == "explained"
