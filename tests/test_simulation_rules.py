"""Rules of the simulation of a line or two each, on the small arm: what is refused, what is told, what is named."""

from __future__ import annotations

import numpy as np
import pytest
from tests.small_arm import arm

from hybrid_dynamics.simulation import (
    Controller,
    ControllerSettings,
    DriveFriction,
    Reference,
    ReferenceSettings,
    Refusal,
    Rollout,
    SensorSettings,
    SimulationSettings,
    coulomb,
    make_controller,
    simulate,
    simulate_dataset,
    simulate_twin,
    viscous,
)
from hybrid_dynamics.simulation.rollout import _BLOCK, _Plant

PERIOD = 2e-3
BRIEF = SimulationSettings(duration=0.06, control_period=PERIOD, substep=PERIOD)
GENTLE = ReferenceSettings(frequency=(0.1, 0.5), velocity_share=0.3)


def held(rows: int) -> Reference:
    """The arm upright, which is at rest without any torque."""
    return Reference(np.zeros((rows, 2)), np.zeros((rows, 2)))


def controller() -> Controller:
    return make_controller(arm(), ControllerSettings(), PERIOD)


@pytest.mark.parametrize("row", [1, _BLOCK - 2, _BLOCK - 1, _BLOCK, 2 * _BLOCK - 1, 2 * _BLOCK + 5, 2 * _BLOCK + 6])
def test_a_torque_too_large_for_one_control_period_is_refused_whichever_it_is(row: int) -> None:
    reference = held(2 * _BLOCK + 7)
    assert isinstance(simulate(arm(), [reference], controller(), PERIOD)[0], Rollout)
    # A speed that is asked for a single period: the elbow's 30 N m by far.
    reference.dq[row, 1] = 100.0 / controller().kd[1]
    (refused,) = simulate(arm(), [reference], controller(), PERIOD)
    assert isinstance(refused, Refusal)
    assert refused.why.startswith("joint elbow saturates: 100 N m")
    assert refused.why.endswith(f"at t = {row * PERIOD:.3f} s")


def test_progress_ends_with_the_last_control_period_and_counts_what_is_left() -> None:
    told: list[tuple[float, str]] = []
    slow = make_controller(arm(), ControllerSettings(), 0.05)
    saturated = held(2 * _BLOCK + 7)
    saturated.dq[_BLOCK + 1, 1] = 1e3
    simulate(arm(), [held(2 * _BLOCK + 7), saturated], slow, 0.05, progress=lambda *s: told.append(s))
    rows = np.array([_BLOCK, 2 * _BLOCK, 2 * _BLOCK + 7])
    assert [share for share, _ in told] == pytest.approx(list(rows / rows[-1]))
    assert [text for _, text in told] == [
        f"{n} rollouts, {t:.1f} s" for n, t in zip((2, 1, 1), rows * 0.05, strict=True)
    ]


def test_runs_are_numbered_from_one_in_each_split() -> None:
    names = ["train_01", "train_02", "test_01", "test_02", "test_03"]
    runs = list(simulate_dataset(arm(), BRIEF, references=GENTLE, n_train=2, n_test=3))
    assert [run.name for run in runs] == names
    twins = simulate_twin(arm(), BRIEF, DriveFriction(), SensorSettings(), GENTLE, n_train=2, n_test=3)
    assert [run.recorded.name for run in twins] == [run.truth.name for run in twins] == names
    assert [run.recorded.split for run in twins] == ["train"] * 2 + ["test"] * 3


def test_the_integral_fills_in_what_the_proportional_part_does_in_the_time_that_is_given() -> None:
    settings = ControllerSettings(integral_rate=2.5)
    chosen = make_controller(arm(), settings, PERIOD)
    # After 1/rate seconds of the same error both parts give the same torque.
    np.testing.assert_allclose(chosen.ki / settings.integral_rate, chosen.kp)
    given = make_controller(arm(), ControllerSettings(integral_rate=2.5, kp=(40.0, 20.0)), PERIOD)
    np.testing.assert_allclose(given.ki, [100.0, 50.0])


@pytest.mark.parametrize("speed", [(0.02, -0.03), (1.5, -0.8), (0.0, 0.0), (1.5, 0.01)])
def test_the_load_of_a_joint_is_its_rigid_body_torque_also_where_friction_stops_it(speed: tuple[float, float]) -> None:
    robot = arm()
    plant = _Plant(robot, coulomb((6.0, 4.0)) + viscous((3.0, 2.0)), PERIOD, PERIOD)
    q, dq = np.array([[0.2, -0.4]]), np.array([speed])
    before_q, before = q.copy(), dq.copy()
    plant.advance(q, dq, np.array([[1.0, -0.5]]), 0.0)
    stopped = np.abs(dq) < 1e-9
    assert stopped.any() == (min(map(abs, speed)) < 0.1)
    assert plant.load is not None
    np.testing.assert_allclose(plant.load, robot.inverse_dynamics(before_q, before, (dq - before) / PERIOD), atol=1e-9)
