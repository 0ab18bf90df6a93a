"""URDF files as they come: what cannot be an arm on a fixed base is refused by name, all else is read as meant."""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.robots.identity import digest_of, dynamics_of

LINK = '<link name="{0}"><inertial><origin xyz="0 0 -0.3"/><mass value="{1}"/><inertia ixx="{2}" iyy="{3}" izz="{4}" ixy="0" ixz="0" iyz="0"/></inertial></link>'  # noqa: E501
JOINT = '<joint name="{0}" type="{1}"><origin xyz="0 0 -0.5"/><parent link="{2}"/><child link="{3}"/><axis xyz="0 1 0"/>{4}</joint>'  # noqa: E501
LIMIT = '<limit lower="-2" upper="2" velocity="3" effort="40"/>'


def link(name, mass=1.0, moments=(0.02, 0.02, 0.01)):
    return LINK.format(name, mass, *moments)


def joint(name, parent, child, kind="revolute", more=LIMIT):
    return JOINT.format(name, kind, parent, child, more)


def urdf(*parts):
    return f'<robot name="r"><link name="base"/>{"".join(parts)}</robot>'


def write(tmp_path, text, name="r.urdf"):
    (tmp_path / name).write_text(text)
    return tmp_path / name


CHAIN = (link("a"), link("b"), joint("first", "base", "a"), joint("second", "a", "b"))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (urdf(link("a"), joint("free", "base", "a", "floating", "")), "joint free is floating, six degrees of freedom"),
        (urdf(link("a"), joint("slide", "base", "a", "planar", "")), "joint slide is planar, three degrees of freedom"),
        (
            urdf(link("a"), joint("ball", "base", "a", "spherical")),
            "joint ball has type 'spherical'; expected revolute",
        ),
        (urdf(link("a"), joint("", "base", "a")), "joint number 1 has no name"),
        (urdf(link(" "), joint("first", "base", " ")), "link number 2 has no name"),
        (urdf(*CHAIN, link("c"), joint("first", "b", "c")), "two joints are called 'first'"),
        (urdf(*CHAIN, link("b")), "two links are called 'b'"),
        (
            urdf(link("a"), joint("first", "base", "a", more='<limit lower="1" upper="-1" velocity="1" effort="1"/>')),
            "joint first: its lower limit 1 is above its upper limit -1; exchange them",
        ),
        (
            urdf(link("a"), joint("first", "base", "a", more='<limit lower="-1" upper="1" velocity="1" effort="-1"/>')),
            "joint first: its effort limit is -1",
        ),
        (urdf(link("a", mass="1_0"), joint("first", "base", "a")), "link a: <mass> value is '1_0'"),
        (
            urdf(link("a", moments=(0.1, 0.1, 0.5)), joint("first", "base", "a")),
            "link a, with what is fixed to it, has",
        ),
        (
            urdf(*CHAIN, link("c"), joint("third", "b", "c", more=LIMIT + '<mimic joint="x"/>')),
            "third mimics 'x', which",
        ),
        (
            urdf(*CHAIN, link("c"), joint("third", "b", "c", more=LIMIT + '<mimic joint="first" multiplier="two"/>')),
            "<mimic> multiplier is 'two'; expected a finite number",
        ),
        (
            '<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:include filename="x"/></robot>',
            "is xacro, not yet a URDF; convert it: xacro r.urdf > r.urdf",
        ),
    ],
)
def test_what_is_no_arm_on_a_fixed_base_is_refused_by_name(tmp_path, text, complaint, capfd):
    with pytest.raises(InputError) as refused:
        Robot.from_urdf(write(tmp_path, text))
    assert complaint in str(refused.value)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (urdf(link("a", mass="nan"), joint("first", "base", "a")), "arm: link a: <mass> value is 'nan'"),
        (urdf(link("a", mass="heavy"), joint("first", "base", "a")), "arm: link a: <mass> value is 'heavy'"),
        ("robot: arm", "arm: not valid XML"),
        ("<mujoco/>", "arm: root element is <mujoco>; expected <robot>"),
        ('<!DOCTYPE r [<!ENTITY a "b">]>' + urdf(*CHAIN), "arm: holds a document type definition"),
    ],
)
def test_text_is_checked_as_a_file_is(text, complaint):
    """A mass that is no number was a robot of other masses without a word."""
    assert Robot.from_text(urdf(*CHAIN), "arm").n_joints == 2
    with pytest.raises(InputError, match=complaint):
        Robot.from_text(text, "arm")


def test_traces_that_xacro_left_are_no_xacro(tmp_path):
    """Comments, names and geometry of generated files, as bundled robots have them (finger_edu, xarm7, tiago ...)."""
    geometry = '<visual><geometry><xacro:add size="${x}"/></geometry></visual></link>'
    text = urdf(*CHAIN).replace('<link name="base"/>', f'<!-- ${{y}} --><link name="base">{geometry}')
    text = text.replace("<robot ", '<robot xmlns:xacro="http://ros.org/wiki/xacro" ', 1)
    assert "xacro:add" in text
    assert Robot.from_urdf(write(tmp_path, text)).n_joints == Robot.from_urdf(write(tmp_path, urdf(*CHAIN))).n_joints


def test_the_parsers_own_lines_do_not_appear(tmp_path, capfd):
    # urdfdom complains of the unknown geometry on its own.
    odd = urdf(*CHAIN).replace(
        '<link name="base"/>', '<link name="base"><collision><geometry><x/></geometry></collision></link>'
    )
    Robot.from_urdf(write(tmp_path, odd))
    with pytest.raises(InputError):
        Robot.from_text('<robot name="r"></robot>', "empty")
    assert capfd.readouterr().err == ""


def test_locking_comes_before_the_checks_of_what_moves(tmp_path):
    massless = urdf(*CHAIN, '<link name="finger"/>', joint("grip", "b", "finger"))
    with pytest.raises(InputError, match="link finger, moved by joint grip, has no inertia"):
        Robot.from_urdf(write(tmp_path, massless))
    assert Robot.from_urdf(tmp_path / "r.urdf", ("grip",)).joint_names == ("first", "second")
    free = urdf(*CHAIN).replace('type="revolute"', 'type="floating"', 1)
    assert Robot.from_urdf(write(tmp_path, free), ("first",)).joint_names == ("second",)


def test_a_bad_inertia_that_never_moves_does_not_matter(tmp_path):
    based = urdf(*CHAIN).replace('<link name="base"/>', link("base", moments=(0.1, 0.1, 0.5)))
    assert Robot.from_urdf(write(tmp_path, based)).n_joints == 2


ANGLES = st.tuples(*[st.floats(-3, 3)] * 3)


@given(ANGLES, ANGLES, st.floats(1.1, 50.0), st.floats(0.01, 1.0), st.booleans())
def test_an_inertia_that_no_body_has_is_told_with_one_that_a_body_can_have(rpy, turned, excess, flat, loaded):
    # Principal moments 1 : flat : excess * (1 + flat), turned in the frame of an <inertial> that is itself turned.
    axes = pin.rpy.rpyToMatrix(np.array(turned))
    moments = 0.01 * np.array([1.0, flat, excess * (1 + flat)])
    given = axes @ np.diag(moments) @ axes.T
    entries = {f"i{a}{b}": given["xyz".index(a), "xyz".index(b)] for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")}
    inertia = "<inertia " + " ".join(f'{key}="{float(value)!r}"' for key, value in entries.items()) + "/>"
    origin = f'<origin xyz="0 0 -0.3" rpy="{rpy[0]} {rpy[1]} {rpy[2]}"/>'
    own = f'<link name="a"><inertial>{origin}<mass value="1"/>{inertia}</inertial></link>'
    tool = (link("tool", 1e-3, (1e-7, 1e-7, 1e-7)), joint("mount", "a", "tool", "fixed", "")) if loaded else ()
    text = urdf(own, joint("first", "base", "a"), *tool)
    with pytest.raises(InputError, match="no body has them") as refused:
        Robot.from_text(text, "r.urdf")
    told = re.search(r"for instance to (ixx=.*)$", str(refused.value))
    assert told is not None
    mended = Robot.from_text(text.replace(inertia, f"<inertia {told[1]}/>"), "r.urdf").model.inertias[1]
    # What a body can have of it stays: its largest moment, to the four digits of the message, and 1 g half a metre off.
    largest = np.linalg.eigvalsh(mended.inertia)[-1]
    assert largest == pytest.approx(moments[-1], abs=2e-3 * moments[-1] + 1.1e-3 * 0.5**2 * loaded)


def test_where_a_link_has_no_inertia_of_its_own_none_is_told_for_it():
    tool = link("tool", moments=(0.1, 0.1, 0.5))
    text = urdf('<link name="a"/>', joint("first", "base", "a"), tool, joint("mount", "a", "tool", "fixed", ""))
    with pytest.raises(InputError, match=r"link a, with what is fixed to it, .*correct its <inertia>$"):
        Robot.from_text(text, "r.urdf")


@pytest.fixture
def gripper(tmp_path):
    """A swinging arm whose second link follows the first, 0.5 times and 0.3 rad further; and the same driven freely."""
    both = (link("a", 2.0), link("b", 1.5), joint("first", "base", "a"))
    follow = urdf(*both, joint("second", "a", "b", more=LIMIT + '<mimic joint="first" multiplier="0.5" offset="0.3"/>'))
    plain = urdf(*both, joint("second", "a", "b"))
    return Robot.from_urdf(write(tmp_path, follow)), Robot.from_urdf(write(tmp_path, plain, "plain.urdf"))


def test_a_mimic_joint_follows_and_its_torque_is_its_leaders(gripper):
    robot, free = gripper
    assert robot.joint_names == ("first",)
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 20, 1))
    full = free.inverse_dynamics(np.hstack([q, 0.5 * q + 0.3]), np.hstack([dq, 0.5 * dq]), np.hstack([ddq, 0.5 * ddq]))
    tau = robot.inverse_dynamics(q, dq, ddq)
    # Virtual work: the drive of the leader moves both.
    np.testing.assert_allclose(tau[:, 0], full[:, 0] + 0.5 * full[:, 1], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(robot.forward_dynamics(q, dq, tau), ddq, atol=1e-9)
    assert digest_of(dynamics_of(robot)) != digest_of(dynamics_of(free))
    assert robot.copy().inverse_dynamics(q, dq, ddq) == pytest.approx(tau)


def test_a_mimic_joint_of_a_locked_leader_is_fixed_with_it(tmp_path):
    third = joint("third", "b", "c", more=LIMIT + '<mimic joint="second"/>')
    path = write(tmp_path, urdf(*CHAIN, link("c"), third))
    assert Robot.from_urdf(path).joint_names == ("first", "second")
    locked = Robot.from_urdf(path, ("second",))
    assert locked.joint_names == ("first",)
    assert locked.mimics == ()


def test_a_chain_of_1500_links_gets_an_answer(tmp_path):
    names = [f"l{k}" for k in range(1500)]
    links = [link(name) for name in names]
    joints = [joint(f"j{k}", "base" if k == 0 else names[k - 1], name) for k, name in enumerate(names)]
    assert Robot.from_urdf(write(tmp_path, urdf(*links, *joints))).n_joints == 1500
    ring = urdf(*links, *joints[1:], joint("j0", names[-1], names[0]))
    with pytest.raises(InputError, match="carries itself"):
        Robot.from_urdf(write(tmp_path, ring))
