"""Numbers of a line or two that tests of what is built on them hardly feel, against their definitions."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect, Term, family, predict
from hybrid_dynamics.effects.acting import readings
from hybrid_dynamics.loop.blackbox import ITERATIONS, _fit
from hybrid_dynamics.loop.diagnosis import errors_of
from hybrid_dynamics.loop.extrapolation import extrapolation
from hybrid_dynamics.loop.jackknife import covariance_of
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.outliers import _near
from hybrid_dynamics.loop.process import ProcessSettings, process
from hybrid_dynamics.loop.uncertainty import _moved
from hybrid_dynamics.simulation.excitation import excitation


def moving(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> Any:
    return SimpleNamespace(q=q, dq=dq, ddq=ddq)


def test_extrapolation_is_in_widths_of_the_training_range():
    train = np.column_stack([np.linspace(-1.0, 3.0, 50), np.linspace(0.0, 1.0, 50)])
    test = np.column_stack([np.linspace(1.0, 5.0, 50), np.linspace(-0.5, 0.5, 50)])
    still = np.zeros_like(train)
    rows = {r["joint"]: r for r in extrapolation(arm(), [moving(train, still, still)], [moving(test, still, still)])}
    assert rows["shoulder"]["beyond"] == pytest.approx(2.0 / 4.0)
    assert rows["elbow"]["beyond"] == pytest.approx(0.5 / 1.0)
    assert rows["elbow"]["train"] == [0.0, 1.0]


def test_a_piecewise_spring_is_continuous_and_has_its_slopes_in_every_piece():
    knots, slopes = (-1.0, -0.2, 0.3, 1.0), (3.0, 1.0, 5.0)
    kind = family("joint_spring")
    term = Term("joint_spring", 1, (("knots", knots), ("shape", "piecewise")))
    values = kind.parameters_of(np.array([*slopes, 0.4]), arm(), term)
    effect = Effect("joint_spring", ("elbow",), values, {"shape": "piecewise", "knots": knots})
    q = np.column_stack([np.zeros(400), np.linspace(-1.5, 1.5, 400)])
    torque = (predict(arm(), [effect], q, 0 * q, 0 * q, np.zeros(400)) - arm().inverse_dynamics(q, 0 * q, 0 * q))[:, 1]
    slope = np.diff(torque) / np.diff(q[:, 1])
    middle = (q[1:, 1] + q[:-1, 1]) / 2
    for (low, high), k in zip(((-1.5, -0.2), (-0.2, 0.3), (0.3, 1.5)), slopes, strict=True):
        inside = (middle > low + 0.01) & (middle < high - 0.01)
        np.testing.assert_allclose(slope[inside], k, rtol=1e-6)
    # No jump at a knot: each step is at most the steepest slope long.
    assert np.abs(np.diff(torque)).max() <= max(slopes) * np.diff(q[:, 1]).max() * (1 + 1e-9)


def test_the_relative_error_of_moving_samples_is_of_their_torque():
    grease = Effect("viscous_friction", ("shoulder",), {"viscous_coefficient": 2.0})
    run = process(excitation(arm(), [grease], duration=6.0, rate=200.0), arm(), ProcessSettings())
    full = errors_of(Model(arm(), (grease,)), [run], moving=True)
    bare = errors_of(Model(arm()), [run], moving=True)
    assert full["relative_error"] < 0.01
    left = np.where(run.mask[:, 0], 2.0 * run.dq[:, 0], 0.0)
    expected = np.linalg.norm(left) / np.linalg.norm(run.tau[run.mask])
    assert bare["relative_error"] == pytest.approx(expected, rel=0.02)


def test_a_parameter_is_moved_up_and_down_by_its_error():
    friction = Effect("coulomb_friction", ("elbow",), {"coulomb_torque": 2.0}, std_errors={"coulomb_torque": 0.5})
    above, below, share = _moved(friction, "coulomb_torque")
    assert (above.parameters["coulomb_torque"], below.parameters["coulomb_torque"], share) == (2.5, 1.5, 1.0)


def test_moments_are_near_within_their_reach_to_both_sides():
    moments = np.zeros((20, 2), bool)
    moments[8, 0] = moments[11, 1] = True
    near = _near(moments, 2)
    assert near.tolist() == [0] * 6 + [1] * 3 + [2] * 2 + [1] * 3 + [0] * 6


def test_blocks_that_know_nothing_of_each_other_give_the_error_of_a_mean():
    """Of one number and B blocks alike, each with its own score s: the variance of the mean is sum s^2 / (B a)^2."""
    rng = np.random.default_rng(6)
    blocks, weight = 400, 2.0
    scores = rng.normal(size=(blocks, 1))
    scores -= scores.mean()
    parts = np.full((blocks, 1, 1), weight)
    for owner in (np.zeros(blocks, int), np.arange(blocks), np.repeat(np.arange(blocks // 2), 2)):
        found = covariance_of(np.array([[blocks * weight]]), parts, scores, owner)
        assert float(found[0, 0]) == pytest.approx(float(np.sum(scores**2)) / (blocks * weight) ** 2, rel=0.15)


@pytest.mark.parametrize(("learnable", "fewest", "most"), [(True, 20, ITERATIONS), (False, 1, 8)])
def test_trees_go_on_as_long_as_rows_they_have_not_seen_gain(learnable: bool, fewest: int, most: int):
    rng = np.random.default_rng(4)
    x = rng.uniform(-1, 1, (600, 2))
    y = 0.2 * rng.normal(size=600) + learnable * np.sin(4 * x[:, 0]) * x[:, 1]
    assert fewest <= _fit(x, y, np.repeat(np.arange(3), 200), seed=0).n_iter_ <= most


@pytest.mark.parametrize(
    ("name", "joints", "parameters"),
    [
        ("torque_gain", ("shoulder", "elbow"), {"gain": 1.2}),
        ("torque_gain", ("elbow",), {"gain": 1.2}),
        ("position_offset", ("elbow",), {"offset": 0.1}),
        ("time_delay", (), {"delay": 0.01}),
    ],
)
def test_a_log_that_reads_otherwise_than_the_truth_is_not_plain(name: str, joints: tuple[str, ...], parameters: Any):
    of_each = [Effect(name, (j,), parameters) for j in joints] or [Effect(name, (), parameters)]
    assert readings(arm(), []).plain
    assert not readings(arm(), of_each).plain
    # Control: what acts on the arm leaves what is read of it as it is.
    assert readings(arm(), [Effect("viscous_friction", ("elbow",), {"viscous_coefficient": 2.0})]).plain
