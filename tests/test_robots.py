"""Rigid-body dynamics of a URDF: vectorised results agree with each other and with closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot, find_description, lock_joints

FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
LINK = '<link name="{name}"><inertial><origin xyz="0 0 -0.5"/><mass value="{mass}"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>'  # noqa: E501


def pendulum(tmp_path, kind="revolute", mass=2.0, extra=""):
    limit = '<limit lower="-3" upper="3" velocity="2" effort="10"/>'
    text = f"""<robot name="pendulum"><link name="base"/>{LINK.format(name="bob", mass=mass)}{extra}
    <joint name="hinge" type="{kind}"><parent link="base"/><child link="bob"/><axis xyz="0 1 0"/>
    {limit}</joint></robot>"""
    path = tmp_path / "pendulum.urdf"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def panda():
    return Robot.from_urdf(find_description("panda_description/urdf/panda.urdf"), FINGERS)


@pytest.mark.parametrize("kind", ["revolute", "continuous"])
def test_pendulum_torque_is_the_closed_form(tmp_path, kind):
    robot = Robot.from_urdf(pendulum(tmp_path, kind))
    q = np.linspace(-2.5, 2.5, 11)[:, None]
    torque = robot.rigid_body_torques(q, np.ones_like(q), 3 * np.ones_like(q))
    # centre of mass half a metre below the hinge: m g l sin q, and I = I_c + m l^2
    np.testing.assert_allclose(torque.gravity, 2.0 * 9.81 * 0.5 * np.sin(q), rtol=1e-12)
    np.testing.assert_allclose(torque.inertia, (0.1 + 2.0 * 0.25) * 3, rtol=1e-12)
    np.testing.assert_allclose(torque.coriolis, 0.0, atol=1e-12)


def test_panda_has_seven_joints_and_known_limits(panda):
    assert panda.joint_names == tuple(f"panda_joint{j}" for j in range(1, 8))
    np.testing.assert_allclose(panda.effort_limits, [87, 87, 87, 87, 12, 12, 12])


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_forward_inverts_inverse_and_regressor_is_linear(panda, seed):
    q, dq, ddq = np.random.default_rng(seed).normal(size=(3, 4, 7))
    tau = panda.inverse_dynamics(q, dq, ddq)
    np.testing.assert_allclose(panda.forward_dynamics(q, dq, tau), ddq, atol=1e-8)
    np.testing.assert_allclose(panda.regressor(q, dq, ddq) @ panda.inertial_parameters, tau, atol=1e-9)
    np.testing.assert_allclose(panda.rigid_body_torques(q, dq, ddq).total, tau, atol=1e-9)


def test_armature_enters_inverse_dynamics(panda):
    other = panda.copy()
    other.model.armature = np.full(7, 0.5)
    q = np.zeros((1, 7))
    added = other.inverse_dynamics(q, q, q + 2.0) - panda.inverse_dynamics(q, q, q + 2.0)
    np.testing.assert_allclose(added, 1.0, atol=1e-12)
    assert not np.any(panda.model.armature), "the copy must not touch the original"


def test_joint_order_is_the_files_even_where_the_chain_is_written_backwards(tmp_path):
    joint = (
        '<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>'
        '<limit lower="-1" upper="1" velocity="{limit}" effort="1"/></joint>'
    )
    links = "".join(LINK.format(name=name, mass=1.0) for name in ("a", "b"))
    second = joint.format(name="second", parent="a", child="b", axis="0 1 0", limit=2)
    first = joint.format(name="first", parent="base", child="a", axis="0 1 0", limit=1)
    (tmp_path / "r.urdf").write_text(f'<robot name="r"><link name="base"/>{links}{second}{first}</robot>')
    robot = Robot.from_urdf(tmp_path / "r.urdf")
    assert robot.joint_names == ("second", "first")
    np.testing.assert_array_equal(robot.velocity_limits, [2, 1])
    q = np.array([[0.3, -0.7]])
    gravity = robot.inverse_dynamics(q, 0 * q, 0 * q)
    np.testing.assert_allclose(gravity[0, 0], 9.81 * 0.5 * np.sin(q.sum()), rtol=1e-12)
    np.testing.assert_allclose(
        robot.regressor(q, q, q) @ robot.inertial_parameters, robot.inverse_dynamics(q, q, q), atol=1e-12
    )


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda p: p.unlink(), "no such URDF file"),
        (lambda p: p.write_text("<robot>"), "not valid XML"),
        (lambda p: p.write_text("<sdf/>"), "root element is <sdf>"),
        (lambda p: p.write_text('<robot name="x"><link name="base"/></robot>'), "no movable joint"),
        (lambda p: p.write_text('<!DOCTYPE x [<!ENTITY a "b">]><robot/>'), "document type definition"),
        (lambda p: p.write_text(p.read_text().replace('value="2.0"', 'value="0"')), "link bob.*has no inertia"),
        (lambda p: p.write_text(p.read_text().replace('value="2.0"', 'value="-1"')), "link bob has mass -1"),
    ],
)
def test_unusable_urdf_is_named(tmp_path, edit, message):
    path = pendulum(tmp_path)
    edit(path)
    with pytest.raises(InputError, match=message):
        Robot.from_urdf(path)


def test_unknown_joint_to_lock_is_named(tmp_path):
    with pytest.raises(InputError, match=r"no movable joint 'gripper'.*hinge"):
        Robot.from_urdf(pendulum(tmp_path), lock=("gripper",))


def test_wrong_number_of_joints_is_named(panda):
    with pytest.raises(InputError, match="has 7 joints; the data has 6"):
        panda.inverse_dynamics(*np.zeros((3, 5, 6)))


def test_a_hand_that_was_not_mounted_is_taken_off(panda):
    """Seven joints stay, and what they carry weighs less by the hand and its fingers; the rest is as it was."""
    urdf = find_description("panda_description/urdf/panda.urdf")
    bare = Robot.from_text(lock_joints(urdf, without=("panda_hand_joint",)), "bare")
    assert bare.joint_names == panda.joint_names
    mass = [np.array([inertia.mass for inertia in robot.model.inertias]) for robot in (panda, bare)]
    np.testing.assert_allclose(mass[0][:-1], mass[1][:-1])
    assert mass[0][-1] - mass[1][-1] == pytest.approx(0.73 + 2 * 0.015)  # kg, as the file has it
    with pytest.raises(InputError, match="no joint 'gripper' to take off"):
        lock_joints(urdf, without=("gripper",))
