"""Rollouts: the simulated robot obeys its declared equation, sampling included; bad rollouts are refused by name."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from tests.tests_support_simulation import passive_controller

from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.robots.dh import DHLimit, DHLink, DHRow, dh_to_urdf
from hybrid_dynamics.simulation import (
    ControllerSettings,
    Reference,
    ReferenceSettings,
    Refusal,
    Rollout,
    SimulationSettings,
    coulomb,
    effective_inertia,
    make_controller,
    multi_sine,
    simulate,
    simulate_dataset,
    viscous,
)
from hybrid_dynamics.simulation.controller import inertia_range
from hybrid_dynamics.trajectory import Trajectory

LOCK = ("panda_finger_joint1", "panda_finger_joint2")
PANDA = Robot.from_urdf(find_description("panda_description/urdf/panda.urdf"), LOCK)
DAMPING = (6.75, 6.0, 5.25, 4.5, 3.75, 3.0, 2.25)
SHORT = SimulationSettings(duration=3.0)


@pytest.fixture(scope="module")
def panda_runs() -> list[Trajectory]:
    return list(simulate_dataset(PANDA, SHORT, damping=DAMPING, n_train=4, n_test=2, seed=5))


def _fit(runs: list[Trajectory], same_instant: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Per joint [tau_i tau_c tau_g dq] coefficients and relative RMSE."""
    features, targets = [], []
    for run in runs:
        q, dq, tau, dt = run["q"], run["dq"], run["tau"], run.dt
        ddq = np.diff(dq, axis=0) / dt
        if same_instant:
            middle, velocity = q[:-1], dq[:-1]
        else:
            middle, velocity = 0.5 * (q[1:] + q[:-1]), 0.5 * (dq[1:] + dq[:-1])
        rigid = PANDA.rigid_body_torques(middle, velocity, ddq)
        features.append(np.stack([rigid.inertia, rigid.coriolis, rigid.gravity, velocity], axis=2))
        targets.append(tau[:-1])
    x, y = np.concatenate(features), np.concatenate(targets)
    coefficients = np.array([np.linalg.lstsq(x[:, j], y[:, j], rcond=None)[0] for j in range(7)])
    left = y - np.einsum("tjk,jk->tj", x, coefficients)
    return coefficients, np.sqrt((left**2).mean(axis=0)) / y.std(axis=0)


def test_declared_dynamics_are_recovered(panda_runs: list[Trajectory]) -> None:
    coefficients, relative = _fit(panda_runs)
    assert np.abs(coefficients[:, 3] / DAMPING - 1).max() < 1e-3
    assert relative.max() < 5e-4
    assert np.abs(coefficients[:6, 0] - 1).max() < 2e-3
    assert np.abs(coefficients[1:6, 2] - 1).max() < 2e-3


def test_wrong_sampling_is_seen(panda_runs: list[Trajectory]) -> None:
    """The control: states of the instant instead of the interval's mean make the same check fail."""
    _, right = _fit(panda_runs)
    _, wrong = _fit(panda_runs, same_instant=True)
    assert (wrong > 3 * right).sum() >= 5
    assert wrong.max() > 5e-4


def test_every_joint_is_excited_and_inside_limits(panda_runs: list[Trajectory]) -> None:
    low, high = PANDA.position_limits
    for run in panda_runs:
        assert (run["q"] > low).all()
        assert (run["q"] < high).all()
        assert (np.abs(run["tau"]) <= PANDA.effort_limits).all()
    assert (np.concatenate([run["dq"] for run in panda_runs]).std(axis=0) > 0.3).all()


def test_same_seed_same_bytes_whatever_the_lockstep(panda_runs: list[Trajectory]) -> None:
    settings = dataclasses.replace(SHORT, lockstep=2)
    again = list(simulate_dataset(PANDA, settings, damping=DAMPING, n_train=4, n_test=2, seed=5))
    assert [run.name for run in again] == [run.name for run in panda_runs]
    assert [run.split for run in again] == ["train"] * 4 + ["test"] * 2
    for one, two in zip(panda_runs, again, strict=True):
        assert all(one[s].tobytes() == two[s].tobytes() for s in ("q", "dq", "tau", "q_ref", "dq_ref"))


def test_effective_inertia_is_never_above_the_diagonal() -> None:
    smallest, largest = inertia_range(PANDA)
    q = np.random.default_rng(1).uniform(*PANDA.position_limits, (300, 7))
    inertia = effective_inertia(PANDA, q)
    assert (inertia >= smallest * 0.98).all(), "the search must have found (nearly) the smallest"
    assert (inertia.max(axis=0) <= largest * 1.05).all()
    assert smallest[2] == pytest.approx(0.018, rel=0.1), "near a straight elbow"


def test_unstable_gain_is_refused_naming_the_joint() -> None:
    kd = (10.0, 10.0, 30.0, 10.0, 5.0, 5.0, 2.0)
    with pytest.raises(ConfigError, match=r"panda_joint3 .* unstable"):
        make_controller(PANDA, ControllerSettings(kd=kd), 1e-3)
    make_controller(PANDA, ControllerSettings(kd=(10.0, 10.0, 10.0, 10.0, 5.0, 5.0, 2.0)), 1e-3)


def _follow(reference: Reference, **changes: object) -> Rollout | Refusal:
    controller = make_controller(PANDA, ControllerSettings(), 1e-3)
    robot = changes.pop("robot", PANDA)
    controller = dataclasses.replace(controller, **changes)
    return simulate(robot, [reference], controller, 2e-4, viscous(DAMPING))[0]


def test_saturating_diverging_and_limit_breaking_runs_are_refused_by_name() -> None:
    reference = multi_sine(PANDA, ReferenceSettings(), 1.0, 1e-3, 2)
    assert isinstance(_follow(reference), Rollout)

    weak = PANDA.copy()
    effort = np.array(weak.model.upperEffortLimit)
    effort[1] = 5.0
    weak.model.upperEffortLimit = effort
    saturated = _follow(reference, robot=weak)
    assert isinstance(saturated, Refusal)
    assert "panda_joint2 saturates" in saturated.why

    low, high = PANDA.position_limits
    beyond = np.tile(0.5 * (low + high), (1000, 1))
    beyond[:, 5] = np.linspace(3.5, 4.2, 1000)
    left = _follow(Reference(beyond, np.zeros_like(beyond)))
    assert isinstance(left, Refusal)
    assert "panda_joint6 leaves its limits" in left.why

    kd = np.array([14.0, 100.0, 200.0, 40.0, 5.0, 9.0, 2.0])
    diverged = _follow(reference, kd=kd)
    assert isinstance(diverged, Refusal)
    assert "joint" in diverged.why


def test_refusals_are_redrawn_logged_and_finally_given_up(caplog: pytest.LogCaptureFixture) -> None:
    weak = PANDA.copy()
    weak.model.upperEffortLimit = np.full(7, 0.5)
    settings = SimulationSettings(duration=0.2, attempts=2)
    with pytest.raises(InputError, match=r"rollout \d.*panda_joint\d saturates.*2 attempts"):
        list(simulate_dataset(weak, settings, n_train=1, n_test=1))
    assert "refused: joint panda_joint" in caplog.text


def test_a_refused_neighbour_changes_nothing() -> None:
    """Runs are independent columns: the same run beside a refused one gives the same bytes."""
    controller = make_controller(PANDA, ControllerSettings(), 1e-3)
    good = multi_sine(PANDA, ReferenceSettings(), 1.0, 1e-3, 2)
    bad = Reference(good.q + 9.0, good.dq)
    alone = simulate(PANDA, [good], controller)[0]
    refused, beside = simulate(PANDA, [bad, good], controller)
    assert isinstance(refused, Refusal)
    assert isinstance(alone, Rollout)
    assert isinstance(beside, Rollout)
    assert np.abs(alone.q - beside.q).max() < 1e-12


def test_references_of_different_length_are_cut() -> None:
    controller = make_controller(PANDA, ControllerSettings(), 1e-3)
    long, short = (multi_sine(PANDA, ReferenceSettings(), t, 1e-3, 2) for t in (0.4, 0.3))
    results = simulate(PANDA, [long, short], controller)
    assert [len(r.time) for r in results if isinstance(r, Rollout)] == [400, 300]
    with pytest.raises(InputError, match="has 6 joints"):
        simulate(PANDA, [Reference(long.q[:, :6], long.dq[:, :6])], controller)


def test_free_fall_conserves_energy_and_damping_takes_it() -> None:
    free = PANDA.copy()
    free.model.lowerPositionLimit, free.model.upperPositionLimit = np.full(7, -1e3), np.full(7, 1e3)
    free.model.upperVelocityLimit = np.full(7, 1e3)
    start = np.array([0.3, -0.4, 0.2, -1.5, 0.1, 1.2, 0.4])
    still = Reference(np.tile(start, (400, 1)), np.zeros((400, 7)))

    def energy(damping: float, substep: float) -> tuple[np.ndarray, np.ndarray]:
        run = simulate(free, [still], passive_controller(free, 1e-3), substep, viscous(np.full(7, damping)))[0]
        assert isinstance(run, Rollout)
        data = free.model.createData()
        moving = [pin.computeKineticEnergy(free.model, data, q, v) for q, v in zip(run.q, run.dq, strict=True)]
        height = [pin.computePotentialEnergy(free.model, data, q) for q in run.q]
        return np.array(moving), np.add(moving, height)

    kinetic, coarse = energy(0.0, 1e-4)
    _, fine = energy(0.0, 5e-5)
    # Symplectic Euler is of first order: the drift is small against the energy turned over and halves with the step.
    assert np.ptp(coarse) < 0.01 * np.ptp(kinetic)
    assert np.ptp(coarse) / np.ptp(fine) == pytest.approx(2.0, rel=0.1)
    _, damped = energy(1.0, 1e-4)
    assert (np.diff(damped)[20:] < 0).all()
    assert damped[-1] < coarse[0] - 10 * np.ptp(coarse)


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"substep": 0.0}, "simulation.substep = 0.0"),
        ({"substep": 2e-3}, "simulation.substep"),
        ({"duration": 1e-3}, "simulation.duration"),
        ({"control_period": -1.0}, "simulation.control_period = -1.0"),
        ({"attempts": 0}, "simulation.attempts = 0"),
    ],
)
def test_settings_out_of_range(wrong: dict[str, float], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        SimulationSettings(**wrong)
    with pytest.raises(ConfigError, match=r"controller\.ratio"):
        ControllerSettings(ratio=0.9)
    with pytest.raises(InputError, match="damping holds 3"):
        next(simulate_dataset(PANDA, SHORT, damping=(1.0, 1.0, 1.0)))


def test_an_endless_joint_moves_like_a_bounded_one(tmp_path: Path) -> None:
    """Continuous joints take Pinocchio's cosine and sine; the motion must be the same."""
    rows = [DHRow(np.pi / 2, 0.1, 0.3), DHRow(0.0, 0.4, 0.0), DHRow(0.5, 0.3, 0.1)]
    links = [DHLink(2.0, (0.0, 0.1, 0.05), (0.05, 0.0, 0.0, 0.04, 0.0, 0.03))] * 3
    text = dh_to_urdf("three", ["a", "b", "c"], rows, links, [DHLimit(-3.0, 3.0, 4.0, 200.0)] * 3)
    runs = []
    for kind in ("revolute", "continuous"):
        path = tmp_path / f"{kind}.urdf"
        path.write_text(text.replace('name="b" type="revolute"', f'name="b" type="{kind}"'))
        robot = Robot.from_urdf(path)
        reference = multi_sine(Robot.from_urdf(tmp_path / "revolute.urdf"), ReferenceSettings(), 1.0, 1e-3, 1)
        controller = make_controller(robot, ControllerSettings(kp=(50.0,) * 3, ki=(5.0,) * 3, kd=(5.0,) * 3), 1e-3)
        run = simulate(robot, [reference], controller, 2e-4, viscous([1.0] * 3) + coulomb([1.0] * 3))[0]
        assert isinstance(run, Rollout), run.why
        runs.append(run)
    assert np.isinf(robot.position_limits[1][1])
    assert np.abs(runs[0].q - runs[1].q).max() < 1e-6
    assert np.ptp(runs[0].q, axis=0).min() > 0.1
