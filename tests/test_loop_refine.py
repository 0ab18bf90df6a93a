"""Nonlinear parameters of what has been found are refined between the grid's values, each on its own scale."""

from __future__ import annotations

import numpy as np
import pytest
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect, Term, family
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop.further import refine
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.simulation.excitation import excitations

ELBOW = ("elbow",)


def judged(effect: Effect) -> Judge:
    train, test = excitations(arm(), [effect], train=2, test=1, duration=8.0, rate=250.0)
    return gather(Model(arm()), read_motion(arm(), train, test, LoopSettings()), LoopSettings())[0]


@pytest.mark.parametrize("start", [8.5, 9.4])
def test_a_harmonic_is_refined_on_both_sides(start: float) -> None:
    judge = judged(Effect("torque_ripple", ELBOW, {"amplitude": 1.0, "harmonic": 9.0, "phase": 0.4}))
    near = Term("torque_ripple", 1, (("harmonic", start),))
    (found,) = refine(judge.adding([near]), [near])[1]
    assert found.options["harmonic"] == pytest.approx(9.0, abs=0.05)
    # Only what was asked for.
    assert refine(judge.adding([near]), [near], places=[("torque_ripple", 0, 9)])[1] == [near]


@pytest.mark.parametrize("start", [0.06, 0.2])
def test_a_velocity_is_refined_by_factors(start: float) -> None:
    values = {"coulomb_torque": 1.0, "static_torque": 2.0, "stribeck_velocity": 0.12}
    judge = judged(Effect("stribeck_friction", ELBOW, values))
    listed = family("stribeck_friction").terms(arm(), np.array([False, True]), judge.settings.options)
    near = listed[0].refined(stribeck_velocity=start)
    (found,) = refine(judge.adding([near]), [near])[1]
    assert found.options["stribeck_velocity"] == pytest.approx(0.12, rel=0.1)
