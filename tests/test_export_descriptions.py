"""URDF and MJCF exports, read back by Pinocchio and MuJoCo: the same torque for every effect that they carry."""

import importlib.metadata
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from tests.support_export import FINGER, drawn

from hybrid_dynamics.effects import Effect, catalogue, family, readings
from hybrid_dynamics.effects.inertia import is_physical, to_body
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.export import mjcf, urdf
from hybrid_dynamics.export.carry import CARRIES, carried, losses
from hybrid_dynamics.export.source import Source
from hybrid_dynamics.export.terms import WORDS
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.robots import Robot

BUNDLED = sorted(
    Path(str(entry.locate())).resolve()
    for entry in importlib.metadata.files("example-robot-data") or []
    if str(entry).endswith(".urdf")
)
#: Bundled robots that this project refuses (no joint, or a moving link without inertia).
REFUSED = {
    *("quadrotor_base", "iris_simple", "ur3"),  # no joint
    *("romeo", "romeo_laas_small", "romeo_small"),  # a link without inertia, or with one that no body has
    "alex_psyonic_hands",  # a joint that mimics one that is not driven
}
#: Bundled robots with links without extent, which MuJoCo does not compile.
IMPOSSIBLE = {"human", "icub", "icub_reduced"}


@pytest.fixture(scope="module")
def robot():
    return Robot.from_urdf(FINGER)


def states(robot, rows=12, seed=0):
    """q, dq, ddq with every joint moving faster than 1e-3 rad/s."""
    q, dq, ddq = np.random.default_rng(seed).normal(size=(3, rows, robot.n_joints))
    return q, dq + np.sign(dq) * 1e-3, ddq


def text_of(module, model, path, head=()):
    rendered = module.render(Source(model, path), "out.xml", list(head))
    return rendered.files["out.xml"].decode(), rendered.notes


def mujoco_torque(xml, robot, q, dq, ddq):
    """Inverse dynamics (T, n) of the MJCF, limits, contacts and equalities off."""
    model = mujoco.MjModel.from_xml_string(xml)
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= off.mjDSBL_LIMIT | off.mjDSBL_CONTACT | off.mjDSBL_EQUALITY
    data = mujoco.MjData(model)
    at_q = [model.joint(name).qposadr[0] for name in robot.joint_names]
    at_dq = [model.joint(name).dofadr[0] for name in robot.joint_names]
    gear = np.array([model.actuator(f"drive_{name}").gear[0] for name in robot.joint_names])
    out = np.empty_like(q)
    for k in range(len(q)):
        data.qpos[at_q], data.qvel[at_dq], data.qacc[at_dq] = q[k], dq[k], ddq[k]
        for mimic in robot.mimics:
            leader, joint = robot.joint_names.index(mimic.leader), model.joint(mimic.joint)
            data.qpos[joint.qposadr] = mimic.multiplier * q[k, leader] + mimic.offset
            data.qvel[joint.dofadr] = mimic.multiplier * dq[k, leader]
            data.qacc[joint.dofadr] = mimic.multiplier * ddq[k, leader]
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse[at_dq] / gear
        for mimic in robot.mimics:  # with the constraint off, what it would pass on to the leader
            passed = data.qfrc_inverse[model.joint(mimic.joint).dofadr[0]]
            out[k, robot.joint_names.index(mimic.leader)] += mimic.multiplier * passed
    return out


def loaded_with_all_that_mjcf_carries(robot):
    effects = [Effect("gravity_tilt", (), {"roll": 0.03, "pitch": -0.02})]
    for k, joint in enumerate(robot.joint_names):
        size = 0.1 + 0.05 * (k % 5)
        effects += [
            Effect("viscous_friction", (joint,), {"viscous_coefficient": size}),
            Effect("nonlinear_viscous_friction", (joint,), {"quadratic_coefficient": -0.1, "cubic_coefficient": 0.05}),
            Effect("coulomb_friction", (joint,), {"coulomb_torque": 2 * size}),
            Effect("torque_offset", (joint,), {"offset": -3 * size}),
            Effect("armature", (joint,), {"armature": size}),
        ]
    payload = to_body(np.array([0.5, 0.02, -0.01, 0.05, 0.02, 0.001, 0.02, -0.001, 0.002, 0.01]))
    return Model(robot, (*effects, Effect("payload", (), payload)))


@pytest.mark.parametrize("path", BUNDLED, ids=[path.stem for path in BUNDLED])
def test_every_bundled_robot_in_mujoco_and_back_from_urdf(path):
    if path.stem in REFUSED:
        with pytest.raises(InputError):
            Robot.from_urdf(path)
        return
    robot = Robot.from_urdf(path)
    model = loaded_with_all_that_mjcf_carries(robot)
    q, dq, ddq = states(robot, 4)
    ours = model.predict(q, dq, ddq)
    if path.stem in IMPOSSIBLE:
        with pytest.raises(InputError, match="MuJoCo does not take the completed model"):
            text_of(mjcf, model, path)
    else:
        assert mujoco_torque(text_of(mjcf, model, path)[0], robot, q, dq, ddq) == pytest.approx(ours, abs=1e-6)
    level = Model(robot, model.effects[-1:])
    back = Robot.from_text(text_of(urdf, level, path)[0], "exported")
    assert back.inverse_dynamics(q, dq, ddq) == pytest.approx(
        level.completed_robot.inverse_dynamics(q, dq, ddq), abs=1e-9
    )


@pytest.mark.parametrize("name", catalogue(everything=True))
def test_every_effect_that_mjcf_carries_whole_keeps_its_torque(robot, name):
    effect = drawn(robot, name)
    model = Model(robot, (effect,))
    if carried("mjcf", (effect,), robot)[0].lost:
        assert losses(carried("mjcf", (effect,), robot))[0].startswith(f"{name} (")
        return
    if family(name).is_body and not _exists(model):
        with pytest.raises(InputError, match="MuJoCo does not take"):
            text_of(mjcf, model, FINGER)
        return
    q, dq, ddq = states(robot)
    ours = model.predict(q, dq, ddq, 0.01 * np.arange(len(q)))
    assert mujoco_torque(text_of(mjcf, model, FINGER)[0], robot, q, dq, ddq) == pytest.approx(ours, abs=1e-6)


def _exists(model):
    robot = model.completed_robot
    return all(is_physical(robot.model.inertias[i].toDynamicParameters()) for i in robot.joint_ids)


def test_what_is_lost_is_really_lost(robot):
    """The wrong-cause control of the table: an effect that MJCF is said to lose changes our torque, not MuJoCo's."""
    joint = robot.joint_names[0]
    effect = Effect("load_dependent_friction", (joint,), {"load_coefficient": 0.3})
    assert carried("mjcf", (effect,), robot)[0].lost == ("law",)
    q, dq, ddq = states(robot)
    plain, planted = Model(robot), Model(robot, (effect,))
    theirs = mujoco_torque(text_of(mjcf, planted, FINGER)[0], robot, q, dq, ddq)
    assert theirs == pytest.approx(plain.predict(q, dq, ddq), abs=1e-9)
    assert np.abs(theirs - planted.predict(q, dq, ddq)).max() > 1e-3


def test_mjcf_has_all_digits(robot):
    third = Effect("viscous_friction", robot.joint_names[:1], {"viscous_coefficient": 1 / 3})
    text = text_of(mjcf, Model(robot, (third,)), FINGER)[0]
    assert 'damping="0.3333333333333333"' in text


def test_readings_stand_in_the_joint_and_its_motor(robot):
    """What is read wrongly: MuJoCo's positions and commands are those of the log."""
    assert not readings(robot, ()).offset.any()
    names = {"position_offset", "torque_gain"} & set(catalogue(everything=True))
    model = Model(robot, tuple(drawn(robot, name) for name in sorted(names)))
    q, dq, ddq = states(robot)
    ours = model.predict(q, dq, ddq, 0.01 * np.arange(len(q)))
    assert mujoco_torque(text_of(mjcf, model, FINGER)[0], robot, q, dq, ddq) == pytest.approx(ours, abs=1e-6)


ODD_URDF = """<?xml version='1.0'?>
<!-- kept: before the root -->
<robot name='odd' xmlns:x="http://example.org">
  <link name="base"/>
  <link name="arm"> <!-- kept: beside a link -->
    <inertial>
      <!-- kept: within -->
      <mass   value='2.0'/>
      <origin rpy="0.1 0.2 0.3" xyz="0 0 .1"/>
      <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/>
    </inertial>
    <visual><geometry><mesh filename="package://a > b/c.stl"/></geometry></visual>
  </link>
  <joint name="j1" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/>
    <dynamics friction='0.5' x:kept="yes" damping="0.25"/></joint>
  <link name="hand"/>
  <joint name="j2" type="revolute"><origin xyz="0 0 .3"/><parent link="arm"/><child link="hand"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
  <link name="tool"><inertial><mass value="1.5"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>
  </inertial></link>
  <joint name="weld" type="fixed"><origin xyz="0 0 .05"/><parent link="hand"/><child link="tool"/></joint>
  <gazebo reference="arm"><material>Kept</material></gazebo>
</robot>
"""


@pytest.fixture
def odd(tmp_path):
    path = tmp_path / "odd.urdf"
    path.write_text(ODD_URDF)
    return path


def test_urdf_changes_the_numbers_and_nothing_else(odd):
    robot = Robot.from_urdf(odd)
    effects = (
        Effect("viscous_friction", ("j1",), {"viscous_coefficient": 1.25}),
        Effect("coulomb_friction", ("j2",), {"coulomb_torque": 0.75}),
        Effect("payload", (), to_body(np.array([0.5, 0, 0, 0.05, 0.02, 0, 0.02, 0, 0, 0.01]))),
        Effect("link_inertia", ("j1",), to_body(np.array([2.5, 0, 0, 0.2, 0.05, 0, 0.05, 0, 0, 0.02]))),
    )
    text, notes = text_of(urdf, Model(robot, effects), odd, ["a -- head"])
    for kept in ("before the root", "beside a link", "within"):
        assert f"<!-- kept: {kept} -->" in text
    assert 'x:kept="yes"' in text
    assert "<material>Kept</material>" in text
    assert "package://a > b/c.stl" in text
    assert '<dynamics friction=\'0.5\' x:kept="yes" damping="1.25"/>' in text
    assert '<dynamics friction="0.75"/>' in text
    assert any("j1 keeps its friction of 0.5" in note for note in notes)
    unchanged = [line for line in ODD_URDF.splitlines() if "inerti" not in line and "mass" not in line]
    missing = [line for line in unchanged if line not in text and "dynamics" not in line]
    assert len(missing) <= 3, missing  # a hand that had no inertial, the joint that had no dynamics, and the head
    back = Robot.from_text(text, "exported")
    q, dq, ddq = states(robot)
    want = Model(robot, effects).completed_robot.inverse_dynamics(q, dq, ddq)
    assert back.inverse_dynamics(q, dq, ddq) == pytest.approx(want, abs=1e-12)


def test_a_body_that_becomes_lighter_than_what_is_fixed_to_it_stays_physical(odd):
    """The tool weighs 1.5 kg and hand with tool are found to weigh 1.0: the hand cannot weigh -0.5."""
    robot = Robot.from_urdf(odd)
    lighter = to_body(np.array([-0.5, 0, 0, -0.025, -0.0045, 0, -0.0045, 0, 0, -0.0033]))
    effects = (Effect("payload", (), lighter),)
    text, notes = text_of(urdf, Model(robot, effects), odd)
    masses = [float(m) for m in re.findall(r"<mass\s+value=[\"']([^\"']+)", text)]
    assert min(masses) >= 0
    assert sum(masses) == pytest.approx(3.0)
    assert any("links fixed to hand (tool) keep" in note for note in notes)
    back = Robot.from_text(text, "exported")
    q, dq, ddq = states(robot)
    want = Model(robot, effects).completed_robot.inverse_dynamics(q, dq, ddq)
    assert back.inverse_dynamics(q, dq, ddq) == pytest.approx(want, abs=1e-12)


def test_locked_joints_stay_joints_in_the_file(odd):
    robot = Robot.from_urdf(odd, ("j2",))
    payload = Effect("payload", (), to_body(np.array([0.5, 0, 0, 0.05, 0.02, 0, 0.02, 0, 0, 0.01])))
    model = Model(robot, (payload,))
    source = Source(model, odd, ("j2",))
    text = urdf.render(source, "out.urdf", source.head("urdf")).files["out.urdf"].decode()
    assert "Joints held at zero: j2" in text
    odd.write_text(text)
    q, dq, ddq = states(robot)
    assert Robot.from_urdf(odd, ("j2",)).inverse_dynamics(q, dq, ddq) == pytest.approx(
        model.completed_robot.inverse_dynamics(q, dq, ddq), abs=1e-12
    )


def test_the_table_knows_only_terms_that_there_are():
    for form, table in CARRIES.items():
        assert set(table) <= set(WORDS), form
