"""Dry friction sticks, dissipates and obeys its law; friction laws of any form enter the simulation unchanged."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.tests_support_simulation import interval_residual, passive_controller

from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation import (
    ControllerSettings,
    JointEffects,
    Reference,
    ReferenceSettings,
    Rollout,
    coulomb,
    dahl,
    from_state_torque,
    load_dependent,
    make_controller,
    multi_sine,
    offset,
    simulate,
    stribeck,
    viscous,
)
from hybrid_dynamics.simulation.friction import DrySolver

LOCK = ("panda_finger_joint1", "panda_finger_joint2")
PANDA = Robot.from_urdf(find_description("panda_description/urdf/panda.urdf"), LOCK)
FC = np.array([3.0, 3.0, 3.0, 3.0, 0.6, 0.5, 0.4])
FV = np.array([2.0, 2.0, 2.0, 2.0, 0.5, 0.5, 0.5])
POSE = np.array([0.3, -0.4, 0.2, -1.5, 0.1, 1.2, 0.4])
SHAPE = ReferenceSettings(frequency=(0.1, 0.6), velocity_share=0.6)


def run(effects: JointEffects, seconds: float = 4.0, seed: int = 4) -> Rollout:
    controller = make_controller(PANDA, ControllerSettings(), 2e-3)
    result = simulate(PANDA, [multi_sine(PANDA, SHAPE, seconds, 2e-3, seed)], controller, 5e-4, effects)[0]
    assert isinstance(result, Rollout), result.why
    return result


def residual(rollout: Rollout) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return interval_residual(PANDA, rollout)


def test_coulomb_law_holds_where_the_joint_moves() -> None:
    left, dq, clean = residual(run(viscous(FV) + coulomb(FC)))
    expected = FV * dq + FC * np.sign(dq)
    moving = clean & (np.abs(dq) > 0.02)
    assert moving.mean() > 0.8
    error = np.where(moving, left - expected, 0.0)
    # 0.3 % of rated torque is 0.26 and 0.036 N m; the simulation's own error must not show beside it.
    assert (np.sqrt((error**2).mean(axis=0)) < 0.05 * 0.003 * PANDA.effort_limits).all()
    wrong = np.where(moving, left - FV * dq, 0.0)
    assert (np.sqrt((wrong**2).mean(axis=0)) > 0.5 * FC).all()


def test_friction_sticks_exactly_and_stays_inside_its_bounds() -> None:
    strong = np.array([60.0, 60.0, 60.0, 60.0, 9.0, 9.0, 9.0])
    still = Reference(np.tile(POSE, (300, 1)), np.zeros((300, 7)))
    held = simulate(PANDA, [still], passive_controller(PANDA, 2e-3), 5e-4, coulomb(strong))[0]
    assert isinstance(held, Rollout)
    assert np.abs(held.q - POSE).max() < 1e-9, "gravity (some 40 N m) must not move a joint held by more friction"
    brief = Reference(still.q[:100], still.dq[:100])
    slipping = simulate(PANDA, [brief], passive_controller(PANDA, 2e-3), 5e-4, coulomb(0.1 * strong))[0]
    assert isinstance(slipping, Rollout)
    assert np.abs(slipping.q - POSE).max() > 0.02


def test_friction_never_drives_and_stops_what_it_brakes() -> None:
    moving = Reference(np.tile(POSE, (800, 1)), np.tile([0.5, 0.3, -0.4, 0.3, 0.5, -0.5, 0.8], (800, 1)))
    weightless = PANDA.copy()
    weightless.model.gravity.linear = np.zeros(3)
    stopped = simulate(weightless, [moving], passive_controller(weightless, 2e-3), 5e-4, coulomb(FC))[0]
    assert isinstance(stopped, Rollout)
    kinetic = 0.5 * np.sum(stopped.dq * weightless.inverse_dynamics(stopped.q, 0 * stopped.q, stopped.dq), axis=1)
    assert (np.diff(kinetic) <= 1e-9).all()
    assert np.abs(stopped.dq[-1]).max() < 1e-9, "at rest for good, no chatter"
    assert kinetic[0] > 0.05


def test_stiff_damping_does_not_ring() -> None:
    """Time constant I/D far below the sub-step: explicit integration would explode."""
    falling = Reference(np.tile(POSE, (200, 1)), np.zeros((200, 7)))
    slow = simulate(PANDA, [falling], passive_controller(PANDA, 2e-3), 5e-4, viscous(np.full(7, 500.0)))[0]
    assert isinstance(slow, Rollout)
    gravity = PANDA.rigid_body_torques(slow.q, 0 * slow.q, 0 * slow.q).gravity
    assert np.abs(slow.dq[100:] + gravity[100:] / 500.0).max() < 1e-3


def test_stribeck_load_and_offset_laws_hold() -> None:
    fs, velocity, mu = 1.6 * FC, 0.2, np.full(7, 0.06)
    laws = viscous(FV) + stribeck(FC, fs, velocity) + load_dependent(mu) + offset(0.3 * FC)
    rollout = run(laws)
    left, dq, clean = residual(rollout)
    held = rollout.tau[:-1] - left  # rigid-body torque of the interval: the load
    level = FC + (fs - FC) * np.exp(-((dq / velocity) ** 2)) + mu * np.abs(held)
    error = np.where(clean & (np.abs(dq) > 0.02), left - FV * dq - level * np.sign(dq) - 0.3 * FC, 0.0)
    assert (np.sqrt((error**2).mean(axis=0)) < 0.1 * 0.003 * PANDA.effort_limits).all()


def test_one_state_law_gives_the_same_motion_as_its_parts() -> None:
    def law(q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        return FV * dq + FC * np.sign(dq) + 0.3 * FC

    together = run(from_state_torque(law, 7), 2.0)
    parts = run(viscous(FV) + coulomb(FC) + offset(0.3 * FC), 2.0)
    # Rounding decides in which sub-step (0.5 ms) a joint breaks away, no more.
    assert np.abs(together.q - parts.q).max() < 1e-4
    other = run(viscous(FV) + coulomb(1.1 * FC) + offset(0.3 * FC), 2.0)
    assert np.abs(other.q - parts.q).max() > 2e-3


def test_asymmetric_friction_in_both_directions() -> None:
    left, dq, clean = residual(run(coulomb(FC, 0.5 * FC) + viscous(FV)))
    forward, backward = clean & (dq > 0.05), clean & (dq < -0.05)
    rest = left - FV * dq
    for j in range(7):
        assert np.median(rest[forward[:, j], j]) == pytest.approx(FC[j], rel=0.01)
        assert np.median(rest[backward[:, j], j]) == pytest.approx(-0.5 * FC[j], rel=0.01)


def test_smooth_laws_see_time_and_state() -> None:
    contact = JointEffects(torque=(lambda q, dq, time: np.where(time >= 1.0, 2.0, 0.0) * np.sin(q),))
    rollout = run(contact + viscous(FV), 2.0)
    left, dq, _ = residual(rollout)
    middle = 0.5 * (rollout.q[1:] + rollout.q[:-1])
    expected = np.where(rollout.time[:-1, None] >= 1.0, 2.0, 0.0) * np.sin(middle) + FV * dq
    error = np.sqrt(((left - expected) ** 2).mean(axis=0))
    assert (error < 0.05 * 0.003 * PANDA.effort_limits).all()
    assert np.sqrt(((left - FV * dq) ** 2).mean(axis=0)).min() > 10 * error.max()


def test_dahl_hysteresis_slides_at_its_coulomb_level_and_springs_back() -> None:
    stiffness = np.full(7, 400.0)
    left, dq, clean = residual(run(dahl(stiffness, FC) + viscous(FV)))
    # After a reversal the torque reaches its level within a few Fc/K (0.01 rad): judge where dq is larger.
    fast = clean & (np.abs(dq) > 0.4)
    rest = left - FV * dq - FC * np.sign(dq)
    assert all(np.median(np.abs(rest[fast[:, j], j])) < 0.02 * FC[j] for j in range(7))
    still = Reference(np.tile(POSE, (1500, 1)), np.zeros((1500, 7)))
    strong = dahl(np.full(7, 3000.0), np.full(7, 200.0)) + viscous(np.full(7, 400.0))
    held = simulate(PANDA, [still], passive_controller(PANDA, 2e-3), 5e-4, strong)[0]
    assert isinstance(held, Rollout)
    gravity = PANDA.rigid_body_torques(held.q, 0 * held.q, 0 * held.q).gravity
    # At rest the bristles carry the weight (overdamped: no overshoot, so the loading branch of the law).
    deflection = held.q[-1] - POSE
    expected = -200.0 / 3000.0 * np.log1p(-np.abs(gravity[-1, 1]) / 200.0)
    assert np.abs(deflection[1]) == pytest.approx(expected, rel=0.02)
    assert deflection[1] * gravity[-1, 1] < 0
    assert np.abs(held.dq[-1]).max() < 1e-3


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31), joints=st.integers(1, 7))
def test_solver_meets_the_friction_law_whatever_the_coupling(seed: int, joints: int) -> None:
    """v' = 0 inside the box, v' >= 0 at the upper bound, v' <= 0 at the lower one, and v' = w - h M^-1 (f - f0)."""
    rng = np.random.default_rng(seed)
    spread = rng.normal(size=(5, joints, joints))
    inverse = np.einsum("rij,rkj->rik", spread, spread) + 0.3 * np.eye(joints)
    forward, backward = rng.uniform(0, 10, (2, 5, joints))
    f = rng.uniform(-backward, forward)
    w = rng.normal(size=(5, joints)) * 0.03
    start, before = f.copy(), w.copy()
    solver = DrySolver(PANDA.model, np.arange(joints))
    solver._minverse = inverse
    solver.solve(np.zeros((joints, 5)), w, f, backward, forward, 1e-3)
    assert (f <= forward).all()
    assert (f >= -backward).all()
    assert (np.abs(w - (before - 1e-3 * np.einsum("rij,rj->ri", inverse, f - start))) < 1e-12).all()
    assert (w[f < forward] < 1e-9).all()
    assert (w[f > -backward] > -1e-9).all()
