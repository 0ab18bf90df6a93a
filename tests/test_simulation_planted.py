"""Every law that can be simulated forward gives back, from the simulated motion, the torque that it was given."""

import numpy as np
import pytest
from tests.effect_examples import of_families_on
from tests.two_links import two_links

from hybrid_dynamics.effects import Effect, catalogue, family, predict
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.simulation import ControllerSettings, SensorSettings, make_controller, multi_sine, record, simulate
from hybrid_dynamics.simulation.planted import planted, sensors_for
from hybrid_dynamics.simulation.references import ReferenceSettings
from hybrid_dynamics.simulation.rollout import Rollout

ROBOT = two_links()
ELBOW = ("elbow",)
PERIOD = 2e-3
CASES = {
    "viscous": Effect("viscous_friction", ELBOW, {"viscous_coefficient": 1.0}),
    "nonlinear viscous": Effect(
        "nonlinear_viscous_friction", ELBOW, {"quadratic_coefficient": 0.3, "cubic_coefficient": 0.2}
    ),
    "coulomb": Effect("coulomb_friction", ELBOW, {"coulomb_torque": 1.0}),
    "coulomb over a width": Effect("coulomb_friction", ELBOW, {"coulomb_torque": 1.0}, {"sign_width": 0.05}),
    "coulomb over a presliding displacement": Effect(
        "coulomb_friction", ELBOW, {"coulomb_torque": 1.0}, {"sign_displacement": 1e-3}
    ),
    "asymmetric": Effect(
        "asymmetric_coulomb_friction", ELBOW, {"coulomb_torque_positive": 1.5, "coulomb_torque_negative": 0.6}
    ),
    "stribeck": Effect(
        "stribeck_friction", ELBOW, {"coulomb_torque": 0.6, "static_torque": 1.2, "stribeck_velocity": 0.3}
    ),
    "load": Effect("load_dependent_friction", ELBOW, {"load_coefficient": 0.2}),
    "dahl": Effect("hysteresis_friction", ELBOW, {"presliding_stiffness": 40.0, "coulomb_torque": 1.0}),
    "lugre": Effect(
        "hysteresis_friction",
        ELBOW,
        {
            "presliding_stiffness": 40.0,
            "coulomb_torque": 1.0,
            "static_torque": 1.6,
            "micro_damping": 0.5,
            "stribeck_velocity": 0.2,
        },
        {"law": "lugre"},
    ),
    "offset": Effect("torque_offset", ELBOW, {"offset": 1.0}),
    "spring": Effect("joint_spring", ELBOW, {"stiffness": 3.0, "rest_position": 0.2}, {"shape": "sine"}),
    "ripple": Effect("torque_ripple", ELBOW, {"amplitude": 0.6, "harmonic": 9.0, "phase": 0.5}),
    "drift": Effect("drift", ELBOW, {"rate": 0.4, "time_constant": 8.0}, {"of": "coulomb"}),
    "contact": Effect("external_contact", ELBOW, {"torque": 2.0}, {"intervals": ((0.4999, 1.1999),)}),
    "symbolic": Effect("symbolic_torque", ELBOW, {"scale": 1.0}, {"expression": "sin(q1) * q2 + 0.3 * dq1"}),
    "coupling": Effect(
        "joint_coupling",
        ELBOW,
        {"viscous_coefficient": 0.8, "coulomb_torque": 0.5, "armature": 0.0},
        {"from_joint": "shoulder", "rows": "own", "sign_of": "partner"},
    ),
    "armature": Effect("armature", ELBOW, {"armature": 0.05}),
    "tilt": Effect("gravity_tilt", (), {"roll": 0.0, "pitch": 1.0}),
}
#: What has no case of its own yet.
CASES |= {
    name: effect
    for name, effect in of_families_on("elbow", {effect.effect for effect in CASES.values()}).items()
    if family(name).has_law
}


def rollout(effects: list[Effect]) -> Rollout:
    robot, acting = planted(ROBOT, effects)
    controller = make_controller(ROBOT, ControllerSettings(), PERIOD, (robot,))
    shape = ReferenceSettings(velocity_share=0.3, maximum_excursion=1.2)
    (done,) = simulate(robot, [multi_sine(ROBOT, shape, 2.0, PERIOD, 3)], controller, 2e-4, acting)
    assert isinstance(done, Rollout), done
    return done


def left(done: Rollout, effects: list[Effect]) -> np.ndarray:
    """Held torque less what the effects ask for over each control period, on rows where nothing turns over."""
    ddq = np.diff(done.dq, axis=0) / PERIOD
    q, dq = (0.5 * (a[1:] + a[:-1]) for a in (done.q, done.dq))
    residual = done.tau[:-1] - predict(ROBOT, effects, q, dq, ddq, done.time[:-1])
    moving = np.abs(dq).min(axis=1) > 0.05
    return residual[moving]


@pytest.mark.parametrize("name", sorted(CASES))
def test_what_is_simulated_is_what_is_predicted(name):
    effect = CASES[name]
    done = rollout([effect])
    right, wrong = np.std(left(done, [effect])[:, 1]), np.sqrt(np.mean(left(done, [])[:, 1] ** 2))
    assert wrong > 0.1
    # The integration's own error: first order in the sub-step of 0.2 ms, and the means over a control period of 2 ms.
    assert right < 0.04 * wrong


def test_a_gear_between_two_joints_acts_on_both_rows():
    gear = Effect(
        "joint_coupling",
        ("shoulder",),
        {"viscous_coefficient": 0.8, "coulomb_torque": 0.0, "armature": 0.0},
        {"from_joint": "elbow", "rows": "both", "sign_of": "sum"},
    )
    friction = [Effect("viscous_friction", (name,), {"viscous_coefficient": 1.0}) for name in ROBOT.joint_names]
    done = rollout([gear, *friction])
    assert np.all(np.std(left(done, [gear, *friction]), axis=0) < 0.04 * np.std(left(done, friction), axis=0))


def test_laws_of_accelerations_are_refused_and_readings_go_to_the_sensors():
    jerky = Effect("symbolic_torque", ELBOW, {"scale": 1.0}, {"expression": "ddq1"})
    with pytest.raises(InputError, match="symbolic_torque cannot be simulated forward"):
        planted(ROBOT, [jerky])
    faults = [
        Effect("torque_gain", ELBOW, {"gain": 1.2}),
        Effect("position_offset", ELBOW, {"offset": 0.1}),
        Effect("time_delay", (), {"delay": 0.004}),
    ]
    done = rollout([])
    plain = record(done, ROBOT, SensorSettings(), "run", "train")
    faulty = record(done, ROBOT, sensors_for(SensorSettings(), ROBOT, faults), "run", "train")
    np.testing.assert_allclose(faulty["q"][:, 1] + 0.1, plain["q"][:, 1], atol=1e-12)
    np.testing.assert_allclose(faulty["tau"][2:, 1], 1.2 * plain["tau"][:-2, 1], atol=1e-9)
    np.testing.assert_allclose(faulty["tau"][2:, 0], plain["tau"][:-2, 0], atol=1e-9)


def test_every_law_of_the_catalogue_is_simulated_here():
    laws = {name for name in catalogue(everything=True) if family(name).has_law}
    assert laws <= {effect.effect for effect in CASES.values()}
