"""Driven by the recorded torque, the exported model moves as the robot did; the one without the effects does not."""

import numpy as np
import pytest

from hybrid_dynamics.effects import Effect, with_effects
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.export import mjcf
from hybrid_dynamics.export.resimulate import ResimulationSettings, resimulate
from hybrid_dynamics.export.source import Source
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.trajectory import Trajectory

PENDULUM = find_description("double_pendulum_description/urdf/double_pendulum_simple.urdf")
DT, SUBSTEPS = 2e-3, 10


@pytest.fixture(scope="module")
def robot():
    return Robot.from_urdf(PENDULUM)


def true_effects(robot):
    first, second = robot.joint_names
    return (
        Effect("viscous_friction", (first,), {"viscous_coefficient": 0.05}),
        Effect("coulomb_friction", (first,), {"coulomb_torque": 0.1}, {"sign_width": 0.05}),
        Effect("viscous_friction", (second,), {"viscous_coefficient": 0.03}),
        Effect("armature", (second,), {"armature": 0.01}),
        Effect("torque_offset", (second,), {"offset": 0.05}),
    )


@pytest.fixture(scope="module")
def run(robot):
    """1.5 s under a torque of two sines, by this project's own forward dynamics in small steps."""
    changed, torque = with_effects(robot, true_effects(robot))
    time = np.arange(0.0, 1.5, DT)
    drive = np.column_stack([1.2 * np.sin(3 * time), 0.4 * np.cos(5 * time)])
    q, dq = np.zeros((2, len(time), 2))
    at, speed = np.array([[0.3, -0.2]]), np.zeros((1, 2))
    h = DT / SUBSTEPS
    for k in range(len(time)):
        q[k], dq[k] = at[0], speed[0]
        after = drive[min(k + 1, len(time) - 1)]
        for part in range(SUBSTEPS):
            own = drive[k] + (part + 0.5) / SUBSTEPS * (after - drive[k])
            speed = speed + h * changed.forward_dynamics(at, speed, own[None] - torque(at, speed, 0 * at))
            at = at + h * speed
    return Trajectory("held-out", "test", time, {"q": q, "dq": dq, "tau": drive})


def xml_of(robot, effects):
    return mjcf.render(Source(Model(robot, effects), PENDULUM), "arm.xml", []).files["arm.xml"].decode()


def test_the_completed_model_moves_as_the_robot_did(robot, run):
    settings = ResimulationSettings(window=0.5)
    before = resimulate(xml_of(robot, ()), robot.joint_names, [run], settings)
    after = resimulate(xml_of(robot, true_effects(robot)), robot.joint_names, [run], settings)
    assert before.windows == after.windows == 2
    assert np.all(after.position < before.position / 20)
    assert np.all(after.velocity < before.velocity / 20)
    # What is left is integration and a reversal over 0.05 rad/s that MJCF does not have.
    assert np.all(after.position < 0.01)


def test_a_wrong_effect_does_not_help(robot, run):
    """The wrong-cause control: the same amount of friction with the other sign of offset and no rotor."""
    _, second = robot.joint_names
    wrong = (*true_effects(robot)[:3], Effect("torque_offset", (second,), {"offset": -0.05}))
    right = resimulate(xml_of(robot, true_effects(robot)), robot.joint_names, [run])
    off = resimulate(xml_of(robot, wrong), robot.joint_names, [run])
    assert off.position[1] > 5 * right.position[1]


def test_friction_holds_a_joint_at_rest(robot):
    """A joint below its break-away torque stays where it is: no chatter."""
    heavy = tuple(Effect("coulomb_friction", (j,), {"coulomb_torque": 50.0}) for j in robot.joint_names)
    still = np.zeros((200, 2))
    run = Trajectory("rest", "test", DT * np.arange(200), {"q": still + 0.4, "dq": still, "tau": still})
    error = resimulate(xml_of(robot, heavy), robot.joint_names, [run], ResimulationSettings(window=0.3))
    assert np.all(error.velocity < 1e-3)
    assert np.all(error.position < 1e-3)


def test_short_runs_and_foreign_models_are_refused(robot, run):
    with pytest.raises(InputError, match="no run is as long as a window"):
        resimulate(xml_of(robot, ()), robot.joint_names, [run], ResimulationSettings(window=5.0))
    with pytest.raises(InputError, match="has no joint 'elbow'"):
        resimulate(xml_of(robot, ()), ("elbow",), [run])
    with pytest.raises(InputError, match="cannot compile"):
        resimulate("<mujoco><nonsense/></mujoco>", robot.joint_names, [run])
    with pytest.raises(InputError, match="substep is 0"):
        ResimulationSettings(substep=0.0)
