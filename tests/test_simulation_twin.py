"""Sensors and twins: recorded columns belong to one instant, the truth obeys the declared law, noise is as declared."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation import (
    DriveFriction,
    Recording,
    Reference,
    ReferenceSettings,
    Rollout,
    SensorSettings,
    SimulationSettings,
    multi_sine,
    record,
    simulate_recordings,
    simulate_twin,
    true_run,
    viscous,
    with_armature,
)

UR10 = Robot.from_urdf(find_description("ur_description/urdf/ur10_robot.urdf"))
FRICTION = DriveFriction(
    viscous=(21.256, 20.221, 10.378, 3.575, 2.491, 3.026),
    coulomb=(12.548, 13.266, 4.994, 1.998, 2.690, 2.298),
    offset=(0.196, -0.754, 0.198, 0.055, -0.010, 0.043),
    armature=(0.0, 3.7434, 0.0, 0.0708, 0.2342, 0.4365),
)
TIMES = SimulationSettings(duration=6.0, control_period=1e-3, substep=1e-3)
SENSORS = SensorSettings(record_every=10, encoder_resolution=1e-4, torque_noise_share=0.003)
SHAPE = ReferenceSettings(frequency=(0.1, 0.5), velocity_share=0.4, maximum_excursion=2.0, rest=0.3, ramp=0.5)


@pytest.fixture(scope="module")
def twin() -> list[Recording]:
    return simulate_twin(UR10, TIMES, FRICTION, SENSORS, SHAPE, n_train=2, n_test=1, seed=1)


def test_truth_obeys_the_declared_law(twin: list[Recording]) -> None:
    plant = with_armature(UR10, FRICTION.armature)
    for run in twin:
        recorded, truth = run.recorded, run.truth
        assert np.array_equal(recorded.time, truth.time)
        assert recorded.time[0] == 0
        assert recorded.dt == pytest.approx(0.01)
        dq = truth["dq"]
        rigid = plant.inverse_dynamics(truth["q"], dq, truth["ddq"])
        drive = np.array(FRICTION.viscous) * dq + np.array(FRICTION.coulomb) * np.sign(dq) + np.array(FRICTION.offset)
        error = np.where(np.abs(dq) > 0.02, truth["tau"] - rigid - drive, 0.0)
        noise = 0.003 * UR10.effort_limits
        assert (np.sqrt((error**2).mean(axis=0)) < 0.1 * noise).all()
        # The control: without the rotors' inertia the law does not hold.
        rigid = UR10.inverse_dynamics(truth["q"], dq, truth["ddq"])
        error = np.where(np.abs(dq) > 0.02, truth["tau"] - rigid - drive, 0.0)
        assert np.sqrt((error**2).mean(axis=0))[1] > noise[1]


def test_truth_is_consistent_in_time(twin: list[Recording]) -> None:
    """dq is the derivative of q, ddq that of dq: no half-step shift between the columns."""
    truth = twin[0].truth
    central = (truth["q"][2:] - truth["q"][:-2]) / (2 * truth.dt)
    late = (truth["q"][2:] - truth["q"][1:-1]) / truth.dt
    # The median: where a joint breaks away its acceleration jumps, and no difference quotient follows that.
    error = np.median(np.abs(central - truth["dq"][1:-1]))
    assert error < 0.1 * np.median(np.abs(late - truth["dq"][1:-1]))
    slope = (truth["dq"][2:] - truth["dq"][:-2]) / (2 * truth.dt)
    behind = (truth["dq"][2:] - truth["dq"][1:-1]) / truth.dt
    error = np.median(np.abs(slope - truth["ddq"][1:-1]))
    assert error < 0.2 * np.median(np.abs(behind - truth["ddq"][1:-1]))


def test_noise_and_quantisation_are_as_declared(twin: list[Recording]) -> None:
    recorded, truth = twin[0].recorded, twin[0].truth
    assert "dq" not in recorded
    assert np.abs(recorded["q"] - truth["q"]).max() <= 0.5e-4 + 1e-12
    assert np.abs(recorded["q"] / 1e-4 - np.round(recorded["q"] / 1e-4)).max() < 1e-6
    noise = (recorded["tau"] - truth["tau"]).std(axis=0)
    # 597 samples: the standard deviation is known to 3 %; five sigma.
    assert np.abs(noise / (0.003 * UR10.effort_limits) - 1).max() < 0.15


def test_standstill_at_both_ends(twin: list[Recording]) -> None:
    truth = twin[0].truth
    assert np.abs(truth["dq"][:10]).max() < 0.05
    assert np.abs(truth["dq"]).max() > 0.3


def test_same_seed_same_bytes(twin: list[Recording]) -> None:
    again = simulate_twin(UR10, TIMES, FRICTION, SENSORS, SHAPE, n_train=2, n_test=1, seed=1)
    for one, two in zip(twin, again, strict=True):
        assert one.recorded["tau"].tobytes() == two.recorded["tau"].tobytes()
        assert one.truth["ddq"].tobytes() == two.truth["ddq"].tobytes()
    assert [run.recorded.split for run in twin] == ["train", "train", "test"]
    assert len({run.recorded["tau"].tobytes() for run in twin}) == 3


def test_given_references_are_followed_and_named() -> None:
    references = [multi_sine(UR10, SHAPE, 3.0, 1e-3, seed) for seed in (1, 2)]
    runs = simulate_twin(UR10, TIMES, FRICTION, SensorSettings(), references, n_train=1, names=["a", "b"])
    assert [(run.recorded.name, run.truth.split) for run in runs] == [("a", "train"), ("b", "test")]
    for run, reference in zip(runs, references, strict=True):
        assert np.abs(run.truth["q"] - reference.q[1:-1]).max() < 0.15
    outside = Reference(references[0].q + 6.0, references[0].dq, "traj9")
    with pytest.raises(InputError, match=r"traj9 cannot be followed: joint \w+ leaves its limits"):
        simulate_twin(UR10, TIMES, FRICTION, SensorSettings(), [outside])


def _ramp() -> Rollout:
    time = np.arange(400) * 1e-3
    q = np.column_stack([np.sin(6 * time)] * 6)
    dq = np.column_stack([6 * np.cos(6 * time)] * 6)
    held = np.column_stack([np.cos(3 * (time + 0.5e-3))] * 6)  # mean over [k, k+1)
    return Rollout(time, q, dq, held, Reference(q, dq))


def test_torque_belongs_to_the_instant_of_the_state() -> None:
    recorded = record(_ramp(), UR10, SensorSettings(), "x", "train")
    start = 1e-3  # the first recorded instant has a neighbour on both sides
    assert np.abs(recorded["tau"][:, 0] - np.cos(3 * (recorded.time + start))).max() < 1e-5
    truth = true_run(_ramp(), "x", "train")
    assert np.abs(truth["ddq"][:, 0] + 36 * truth["q"][:, 0]).max() < 1e-3
    assert np.abs(truth["dddq"][:, 0] + 36 * truth["dq"][:, 0]).max() < 5e-3


def test_planted_recording_faults() -> None:
    clean = record(_ramp(), UR10, SensorSettings(), "x", "train")
    gain = record(_ramp(), UR10, SensorSettings(torque_gain=(1.1, 1, 1, 1, 1, 1)), "x", "train")
    assert np.allclose(gain["tau"][:, 0], 1.1 * clean["tau"][:, 0])
    assert np.allclose(gain["tau"][:, 1], clean["tau"][:, 1])
    shifted = record(_ramp(), UR10, SensorSettings(position_offset=(0.01, 0, 0, 0, 0, 0)), "x", "train")
    assert np.allclose(shifted["q"][:, 0] + 0.01, clean["q"][:, 0])
    late = record(_ramp(), UR10, SensorSettings(delay=2.5e-3), "x", "train")
    expected = np.cos(3 * (late.time + 1e-3 - 2.5e-3))
    assert np.abs(late["tau"][5:, 0] - expected[5:]).max() < 1e-5
    measured = record(_ramp(), UR10, SensorSettings(velocity=True, encoder_bits=16), "x", "train")
    assert np.allclose(measured["dq"], clean_velocity(), atol=1e-12)
    assert np.abs(measured["q"] - clean["q"]).max() <= np.pi / 2**16 + 1e-12


def clean_velocity() -> np.ndarray:
    return true_run(_ramp(), "x", "train")["dq"]


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"encoder_bits": 16, "encoder_resolution": 1e-4}, "exclude each other"),
        ({"torque_noise": 1.0, "torque_noise_share": 0.1}, "exclude each other"),
        ({"torque_noise": -1.0}, "torque_noise = -1.0"),
        ({"encoder_resolution": 1.0}, "encoder_resolution"),
        ({"record_every": 0}, "record_every = 0"),
        ({"delay": 1.0}, "delay = 1.0"),
    ],
)
def test_sensor_settings_out_of_range(wrong: dict[str, float], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        SensorSettings(**wrong)


def test_lists_of_the_wrong_length_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"friction.coulomb holds 2 numbers; robot ur10 has 6"):
        simulate_twin(UR10, TIMES, DriveFriction(coulomb=(1.0, 1.0)), SENSORS)
    with pytest.raises(ConfigError, match=r"friction.viscous"):
        DriveFriction(viscous=(-1.0,))
    with pytest.raises(ConfigError, match=r"sensors.torque_gain holds 1"):
        record(_ramp(), UR10, SensorSettings(torque_gain=(1.0,)), "x", "train")


def test_a_changed_robot_is_simulated_and_the_controller_does_not_know() -> None:
    """The seam of the effect catalogue: another true robot plus any torque law."""
    heavy = UR10.copy()
    inertia = heavy.model.inertias[heavy.joint_ids[-1]]
    inertia.mass += 3.0
    heavy.model.inertias[heavy.joint_ids[-1]] = inertia
    runs = simulate_recordings(
        UR10, TIMES, SensorSettings(), SHAPE, true_robot=heavy, effects=viscous([20.0] * 6), n_train=1, n_test=0
    )
    truth = runs[0].truth
    rest = truth["tau"] - heavy.inverse_dynamics(truth["q"], truth["dq"], truth["ddq"]) - 20.0 * truth["dq"]
    assert np.sqrt((rest**2).mean(axis=0)).max() < 0.05
    rest = truth["tau"] - UR10.inverse_dynamics(truth["q"], truth["dq"], truth["ddq"]) - 20.0 * truth["dq"]
    assert np.sqrt((rest**2).mean(axis=0))[1] > 1.0
