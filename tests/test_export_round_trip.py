"""Planted, found by the loop, exported: the exported program makes the torque that was planted."""

import numpy as np
import pytest
from tests.effect_examples import of_families_on
from tests.small_arm import URDF
from tests.support_export import imported, saved

from hybrid_dynamics.effects import Effect, catalogue
from hybrid_dynamics.effects.inertia import to_body
from hybrid_dynamics.export.writing import export
from hybrid_dynamics.loop.close import close_loop
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory

S, E = "shoulder", "elbow"
#: One of each family, of a size that matters on the small arm.
PLANTED = {
    e.effect: e
    for e in (
        Effect("armature", (E,), {"armature": 0.1}),
        Effect("asymmetric_coulomb_friction", (S,), {"coulomb_torque_positive": 3.0, "coulomb_torque_negative": 1.5}),
        Effect("coulomb_friction", (E,), {"coulomb_torque": 1.5}),
        Effect("gravity_tilt", (), {"roll": 0.0, "pitch": 0.05}),
        Effect("hysteresis_friction", (E,), {"presliding_stiffness": 15.0, "coulomb_torque": 1.5}),
        Effect("joint_spring", (S,), {"stiffness": 8.0, "rest_position": 0.4}, {"shape": "linear"}),
        Effect("load_dependent_friction", (S,), {"load_coefficient": 0.1}),
        Effect("nonlinear_viscous_friction", (E,), {"quadratic_coefficient": 0.4, "cubic_coefficient": 0.2}),
        Effect("payload", (), to_body(np.array([1.5, 0, 0, 0.3, 0.075, 0, 0.075, 0, 0, 0.01]))),
        Effect("torque_offset", (E,), {"offset": -1.2}),
        Effect("viscous_friction", (S,), {"viscous_coefficient": 3.0}),
        Effect("torque_gain", (S,), {"gain": 1.1}),
        Effect("position_offset", (E,), {"offset": 0.05}),
        Effect("link_mass", (S,), {"mass": 5.0}),
        Effect(
            "joint_coupling",
            (E,),
            {"viscous_coefficient": 0.8, "coulomb_torque": 0.6, "armature": 0.0},
            {"from_joint": S, "rows": "own", "sign_of": "partner"},
        ),
    )
}
#: Families that are not planted here, and why.
ELSEWHERE = {
    "external_contact": "belongs to one run, no format carries it",
    "time_delay": "belongs to the recording, no format carries it",
    "link_com": "on two planar links it is what link_mass and payload are",
    "link_inertia": "on two planar links it is what link_mass and payload are",
    "inertial_parameters": "on two planar links it is what link_mass and payload are",
    "drift": "its torque is compared in test_export_programs; the loop keeps the time constant it starts from",
    "stribeck_friction": "its torque is compared in test_export_programs; the loop's search for it is tested with it",
    "torque_ripple": "its torque is compared in test_export_programs; the loop's search for it is tested with it",
    "symbolic_torque": "its torque is compared in test_export_programs; the loop's search for it is tested with it",
}
#: And every other one of a joint.
PLANTED |= of_families_on(E, {*PLANTED, *ELSEWHERE})
RATE, SECONDS, NOISE = 400.0, 10.0, 0.02


@pytest.fixture(scope="module")
def robot():
    return Robot.from_text(URDF, "small arm")


def motion(seed):
    """time, q, dq, ddq of a multi-sine that starts and ends anywhere."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(SECONDS * RATE)) / RATE
    w = 2 * np.pi * np.array([0.11, 0.29, 0.61])[:, None] * rng.uniform(0.9, 1.1, (3, 2))
    size, phase = np.array([0.9, 0.4, 0.15])[:, None], rng.uniform(0, 2 * np.pi, (3, 2))
    angle = time[:, None, None] * w + phase
    return (
        time,
        (size * np.sin(angle)).sum(1),
        (size * w * np.cos(angle)).sum(1),
        (-size * w**2 * np.sin(angle)).sum(1),
    )


def log(robot, effects, seed, split):
    time, q, dq, ddq = motion(seed)
    tau = Model(robot, effects).predict(q, dq, ddq, time)
    tau += NOISE * np.random.default_rng(100 + seed).normal(size=tau.shape)
    return Trajectory(f"{split}{seed}", split, time, {"q": q, "tau": tau})


def exported(model, folder):
    """The Python export of ``model``, imported."""
    urdf = folder / "small.urdf"
    urdf.write_text(URDF)
    export(saved(model, folder), urdf, "python", folder / "arm.py")
    return imported(folder / "arm.py")


def along(program, time, q, dq, ddq):
    """Torque and its standard deviation (T, n) along one run, with the memory it needs."""
    if not program.STATES:
        return program.torque(q, dq, ddq), program.torque_std(q, dq, ddq)
    states = [np.zeros(len(program.STATES))]
    for k in range(1, len(time)):
        step = time[k] - time[k - 1]
        states.append(program.advance((q[k] - q[k - 1]) / step, step, states[-1]))
    return program.torque(q, dq, ddq, np.array(states)), program.torque_std(q, dq, ddq, np.array(states))


@pytest.mark.parametrize("name", PLANTED)
def test_what_was_planted_comes_out_of_the_exported_file(robot, name, tmp_path):
    planted = PLANTED[name]
    train = [log(robot, (planted,), seed, "train") for seed in (1, 2)]
    test = [log(robot, (planted,), 3, "test")]
    found = close_loop(robot, train, test, LoopSettings(effects=(name,))).model
    assert {effect.effect for effect in found.effects} == {name}
    time, q, dq, ddq = motion(4)
    want = Model(robot, (planted,)).predict(q, dq, ddq, time)
    torque, deviation = along(exported(found, tmp_path), time, q, dq, ddq)
    error, spread = (np.sqrt(np.mean(a**2, axis=0)) for a in (torque - want, deviation))
    # One random draw of one or two parameters: four standard errors. Rounding where a joint has no effect.
    assert np.all(error <= 4 * spread + 1e-9)
    # The wrong-cause control: the spread is no excuse for anything; what was planted is far larger.
    effect = np.sqrt(np.mean((want - robot.inverse_dynamics(q, dq, ddq)) ** 2, axis=0))
    assert effect.max() > 10 * spread.max()


def test_every_family_is_planted_or_has_a_reason():
    assert set(PLANTED) | set(ELSEWHERE) == set(catalogue(everything=True))
    assert not set(PLANTED) & set(ELSEWHERE)
