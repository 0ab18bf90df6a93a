"""A late torque: as it was before, or behind a drive's low-pass; and which of the two it is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lsim
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.effects.acting import lagged, readings
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop import close_loop
from hybrid_dynamics.simulation.excitation import excitations

ROBOT = arm()


@given(lag=st.floats(1e-4, 1.0), step=st.floats(1e-3, 0.1))
def test_the_low_pass_is_that_of_a_library(lag: float, step: float) -> None:
    time = step * np.arange(200)
    signal = np.random.default_rng(0).normal(size=(200, 2))
    signal[:2] = signal[0]  # at rest before: the library begins there
    expected = [lsim(([1.0], [lag, 1.0]), own - own[0], time)[1] + own[0] for own in signal.T]
    np.testing.assert_allclose(lagged(signal, time, lag), np.column_stack(expected), atol=1e-6)


@given(lag=st.floats(1e-3, 0.5))
def test_a_ramp_stays_a_ramp_as_late_as_the_time_constant(lag: float) -> None:
    uneven = np.cumsum(np.random.default_rng(1).uniform(0.005, 0.015, 300))
    ramp = np.column_stack([3.0 * uneven, -uneven])
    np.testing.assert_allclose(lagged(ramp, uneven, lag), ramp - lag * np.array([3.0, -1.0]), atol=1e-9)
    assert lagged(ramp, None, 0.0) is ramp


def test_without_stamps_no_law_can_say_what_was_before() -> None:
    with pytest.raises(InputError, match="no time stamps are given"):
        lagged(np.zeros((3, 1)), None, 0.1)


def test_delays_and_lags_of_a_model_add_up_each_for_itself() -> None:
    late = [Effect("time_delay", (), {"delay": d}) for d in (0.01, 0.02)]
    slow = Effect("time_delay", (), {"delay": 0.005}, {"response": "lag"})
    read = readings(ROBOT, [*late, slow])
    assert read.delay == pytest.approx(0.03)
    assert read.lag == pytest.approx(0.005)
    assert not read.plain


@pytest.mark.parametrize("response", [pytest.param("delay", marks=pytest.mark.slow), "lag"])
def test_each_is_told_from_the_other_and_right(response: str) -> None:
    settings = {} if response == "delay" else {"response": "lag"}
    hidden = Effect("time_delay", (), {"delay": 0.04}, settings)
    train, test = excitations(ROBOT, [hidden], train=2, test=1, duration=8.0, rate=400.0)
    found = close_loop(ROBOT, train, test).diagnosis
    (entry,) = found.effects
    assert (entry.effect.effect, dict(entry.effect.settings)) == ("time_delay", settings)
    assert entry.effect.parameters["delay"] == pytest.approx(0.04, rel=0.02)
    assert found.verdict == "explained"
    assert not any(o["effects"] == [{"effect": "time_delay", "joints": []}] for o in entry.indistinguishable_from)


def test_a_slow_motion_cannot_tell_and_says_so() -> None:
    hidden = Effect("time_delay", (), {"delay": 0.004}, {"response": "lag"})
    train, test = excitations(ROBOT, [hidden], train=2, test=1, duration=8.0, rate=400.0)
    (entry,) = close_loop(ROBOT, train, test).diagnosis.effects
    assert entry.effect.effect == "time_delay"
    (other,) = [o for o in entry.indistinguishable_from if o["effects"] == [{"effect": "time_delay", "joints": []}]]
    assert "response: lag" in other["why"] or "without settings" in other["why"]
    assert "faster" in other["motion_that_would_tell"]
