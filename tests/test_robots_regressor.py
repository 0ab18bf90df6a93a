"""The vectorised inertial regressor against Pinocchio's own, sample by sample."""

import numpy as np
import pinocchio as pin
import pytest

from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.robots.regressor import BLOCK

LINK = (
    '<link name="{name}"><inertial><origin xyz="0.1 -0.2 0.3" rpy="0.4 0.5 0.6"/><mass value="1.5"/>'
    '<inertia ixx="0.1" ixy="0.01" ixz="-0.02" iyy="0.12" iyz="0.015" izz="0.09"/></inertial></link>'
)
JOINT = (
    '<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}_link"/><axis xyz="{axis}"/>'
    '<origin xyz="0.3 0.1 -0.2" rpy="0.7 -0.4 0.2"/><limit lower="-3" upper="3" velocity="2" effort="9"/></joint>'
)


def branching_robot() -> Robot:
    """A fork behind the second joint, a slide, a continuous joint and a slanted axis, the first joint written last."""
    joints = [
        JOINT.format(name="left", kind="prismatic", parent="second_link", axis="0.6 0 0.8"),
        JOINT.format(name="right", kind="continuous", parent="second_link", axis="0 0 1"),
        JOINT.format(name="tip", kind="revolute", parent="left_link", axis="0.36 0.48 0.8"),
        JOINT.format(name="second", kind="revolute", parent="first_link", axis="0 1 0"),
        JOINT.format(name="first", kind="prismatic", parent="base", axis="1 0 0"),
    ]
    links = [LINK.format(name=f"{name}_link") for name in ("left", "right", "tip", "second", "first")]
    return Robot.from_text(f'<robot name="fork"><link name="base"/>{"".join(links + joints)}</robot>', "fork.urdf")


def robot_named(name: str) -> Robot:
    if name == "fork":
        return branching_robot()
    return Robot.from_urdf(
        find_description("panda_description/urdf/panda.urdf"), ("panda_finger_joint1", "panda_finger_joint2")
    )


def one_by_one(robot: Robot, q, dq, ddq):
    """Pinocchio's regressor of each sample, its rows and columns in the robot's order of joints."""
    data = robot.model.createData()
    rows = [robot.model.idx_vs[i] for i in robot.joint_ids]
    columns = np.concatenate([np.arange(10 * (i - 1), 10 * i) for i in robot.joint_ids])
    out = []
    for angles, speed, acceleration in zip(q, dq, ddq, strict=True):
        configuration, v, a = pin.neutral(robot.model), np.zeros(robot.model.nv), np.zeros(robot.model.nv)
        for k, joint in enumerate(robot.joint_ids):
            at = robot.model.idx_qs[joint]
            if robot.model.nqs[joint] == 2:
                configuration[at : at + 2] = np.cos(angles[k]), np.sin(angles[k])
            else:
                configuration[at] = angles[k]
        v[rows], a[rows] = speed, acceleration
        out.append(pin.computeJointTorqueRegressor(robot.model, data, configuration, v, a)[rows][:, columns])
    return np.array(out)


@pytest.mark.parametrize("name", ["panda", "fork"])
@pytest.mark.parametrize("samples", [1, BLOCK + 3])
def test_regressor_is_pinocchios(name, samples):
    robot = robot_named(name)
    q, dq, ddq = np.random.default_rng(samples).normal(size=(3, samples, robot.n_joints))
    expected = one_by_one(robot, q, dq, ddq)
    np.testing.assert_allclose(robot.regressor(q, dq, ddq), expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


def test_a_changed_model_changes_the_regressor():
    robot = branching_robot()
    other = robot.copy()
    other.model.gravity.linear = np.array([1.0, 2.0, -3.0])
    q = np.full((2, robot.n_joints), 0.3)
    expected = one_by_one(other, q, q, q)
    np.testing.assert_allclose(other.regressor(q, q, q), expected, atol=1e-12 * np.abs(expected).max())
    assert np.abs(expected - robot.regressor(q, q, q)).max() > 1.0, "gravity must enter"


def test_no_sample_gives_no_row():
    robot = branching_robot()
    assert robot.regressor(*np.zeros((3, 0, 5))).shape == (0, 5, 50)
