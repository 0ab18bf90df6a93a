"""References: the paper's limits hold, the velocity is the derivative, files are smoothed and not distorted."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation import ReferenceSettings, multi_sine, reference_from_positions
from hybrid_dynamics.simulation.references import Reference, derive_seed

LOCK = ("panda_finger_joint1", "panda_finger_joint2")
PANDA = Robot.from_urdf(find_description("panda_description/urdf/panda.urdf"), LOCK)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**62), margin=st.floats(0, 0.3), share=st.floats(0.2, 1.0))
def test_multi_sine_stays_inside_limits(seed: int, margin: float, share: float) -> None:
    shape = ReferenceSettings(margin=margin, velocity_share=share)
    reference = multi_sine(PANDA, shape, 4.0, 2e-3, seed)
    low, high = PANDA.position_limits
    assert (reference.q >= low + margin - 1e-9).all()
    assert (reference.q <= high - margin + 1e-9).all()
    assert (np.abs(reference.dq) <= share * PANDA.velocity_limits + 1e-9).all()
    # Scaling uses one of the two limits to the full: no joint is left almost at rest.
    assert (np.ptp(reference.q, axis=0) > 0.1).all()


@pytest.mark.parametrize("ends", [{}, {"rest": 0.5, "ramp": 0.7}])
def test_velocity_is_the_derivative_of_position(ends: dict[str, float]) -> None:
    reference = multi_sine(PANDA, ReferenceSettings(**ends), 5.0, 1e-3, 3)
    numeric = (reference.q[2:] - reference.q[:-2]) / 2e-3
    # Central differences err by (w T)^2/6 of the velocity: 1 Hz modes at 1 ms give 7e-6.
    assert np.abs(numeric - reference.dq[1:-1]).max() < 5e-5


def test_rest_at_both_ends_is_standstill() -> None:
    reference = multi_sine(PANDA, ReferenceSettings(rest=0.5, ramp=0.5), 4.0, 1e-3, 1)
    assert not reference.dq[:500].any()
    assert np.abs(reference.dq[-500:]).max() < 1e-12
    assert np.ptp(reference.q, axis=0).min() > 0.1


def test_same_seed_same_reference_and_another_seed_another() -> None:
    one, two, other = (multi_sine(PANDA, ReferenceSettings(), 1.0, 1e-3, seed) for seed in (7, 7, 8))
    assert one.q.tobytes() == two.q.tobytes()
    assert np.abs(one.q - other.q).max() > 0.1
    assert derive_seed(1, 2, 3) != derive_seed(12, 3)


def test_rounded_positions_give_a_clean_velocity() -> None:
    time = np.arange(8000) * 1e-3
    truth = np.column_stack([np.sin(3 * time), 0.5 * np.cos(5 * time)])
    rate = np.column_stack([3 * np.cos(3 * time), -2.5 * np.sin(5 * time)])
    rounded = np.round(truth, 5)
    reference = reference_from_positions(rounded, 1e-3)
    error = np.abs(reference.dq - rate).max()
    naive = np.abs(np.gradient(rounded, 1e-3, axis=0) - rate)[1:-1].max()
    # Rounding to 1e-5 at 1 kHz is up to 5e-3 rad/s for plain differences; the spline must be well below.
    assert naive > 3e-3
    assert error < 1e-3
    assert np.abs(reference.q - truth).max() < 1e-5


def test_resampling_a_file_keeps_the_motion() -> None:
    time = np.arange(2000) * 1e-3
    reference = reference_from_positions(np.sin(2 * time)[:, None], 1e-3, rate=2000)
    grid = np.arange(len(reference.q)) / 2000
    assert np.abs(reference.q[:, 0] - np.sin(2 * grid)).max() < 1e-6


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"modes": 0}, "reference.modes = 0"),
        ({"amplitude": (1.0, 0.5)}, "reference.amplitude"),
        ({"frequency": (0.0, 1.0)}, "reference.frequency"),
        ({"velocity_share": 1.5}, "velocity_share = 1.5"),
        ({"rest": 1.0}, "reference.ramp"),
    ],
)
def test_settings_out_of_range_are_refused_by_name(wrong: dict[str, object], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        ReferenceSettings(**wrong)


def test_no_room_names_the_joint() -> None:
    with pytest.raises(ConfigError, match="panda_joint4"):
        multi_sine(PANDA, ReferenceSettings(margin=1.3), 1.0, 1e-3, 0)


def test_unusable_positions_are_refused() -> None:
    with pytest.raises(InputError, match="row 4"):
        reference_from_positions(np.where(np.arange(20)[:, None] == 3, np.nan, 0.0), 1e-3)
    with pytest.raises(InputError, match="at least 8"):
        reference_from_positions(np.zeros((3, 2)), 1e-3)
    with pytest.raises(InputError, match="shape"):
        Reference(np.zeros((5, 2)), np.zeros((5, 3)))


@pytest.mark.parametrize(("rest", "ramp", "fits"), [(0.3, 1.5, True), (0.6, 1.5, False), (1.9, 0.2, False)])
def test_a_reference_rests_and_rises_at_both_ends_or_is_refused(rest: float, ramp: float, fits: bool) -> None:
    shape = ReferenceSettings(rest=rest, ramp=ramp)
    if not fits:
        with pytest.raises(ConfigError, match=r"do not fit twice into 3\.998 s"):
            multi_sine(PANDA, shape, 4.0, 2e-3, 1)
        return
    reference = multi_sine(PANDA, shape, 4.0, 2e-3, 1)
    rows = round(rest / 2e-3)
    np.testing.assert_array_equal(reference.dq[[*range(rows), *range(-rows, 0)]], 0.0)
    assert np.abs(reference.dq[rows + 50]).max() > 0
