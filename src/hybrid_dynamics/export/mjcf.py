"""MJCF for MuJoCo: bodies, joints and what MuJoCo's joints can hold, with all 17 digits (MuJoCo's own writer keeps 6).

Written from the completed model, not from the URDF: one body for each moving link with everything that is fixed to it,
so that the numbers are those the model computes with. Meshes are left out; the dynamics need none.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable

import mujoco
import numpy as np
import pinocchio as pin

from hybrid_dynamics.effects import readings
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.export.body import joint_axis
from hybrid_dynamics.export.source import Rendered, Source
from hybrid_dynamics.export.terms import Terms
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.robots.urdf import lock_joints
from hybrid_dynamics.types import Array

#: Direct (stiffness, damping) reference of friction constraints: the friction of a moving joint is exactly its
#: frictionloss, also in inverse dynamics (tried; MuJoCo's default is wrong by up to twice the friction).
SOLREF_FRICTION = "0 -1e9"
#: The class of joints with dry friction, so that one line of the file changes all of them.
DRY = "dry"
_ABOUT_FRICTION = (
    "Dry friction is set for inverse dynamics, exact at any speed. To simulate forward in steps of h seconds, replace "
    'the next line by solreffriction="0 -1/h" solimpfriction="0.9999 0.9999" (-1/h as a number): joints come to rest.'
)
#: A constant torque is written as a spring so soft that the joint's own motion does not show, N m/rad.
SOFT = 1e-9


def render(source: Source, name: str, head: list[str]) -> Rendered:
    """The completed model as MJCF."""
    root = document(source)
    text = "\n".join(f"  {line}" for line in head).replace("--", "- -")
    ET.indent(root)
    whole = f"<!--\n{text}\n-->\n{ET.tostring(root, encoding='unicode')}\n"
    try:
        mujoco.MjModel.from_xml_string(whole)
    except ValueError as error:
        reason = " ".join(str(error).split()).removeprefix("Error: ")
        raise InputError(
            f"{source.urdf}: MuJoCo does not take the completed model ({reason}); mend the inertia of that link"
        ) from None
    return Rendered({name: whole.encode()})


def document(source: Source) -> ET.Element:
    """The <mujoco> element."""
    robot = source.kept.completed_robot
    model = robot.model
    terms = source.joint_terms("mjcf")
    root = ET.Element("mujoco", model=robot.name)
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    ET.SubElement(root, "option", gravity=numbers(model.gravity.linear), integrator="implicitfast", timestep="0.001")
    default = ET.SubElement(ET.SubElement(root, "default"), "default", {"class": DRY})
    default.append(ET.Comment(f" {_ABOUT_FRICTION} "))
    ET.SubElement(default, "joint", solreffriction=SOLREF_FRICTION)
    world = ET.SubElement(root, "worldbody")
    actuators = ET.SubElement(root, "actuator")
    links = _links(source)
    bodies: dict[int, ET.Element] = {0: world}
    low, high = robot.position_limits
    read = readings(source.robot, source.kept.effects)
    drives = {joint: k for k, joint in enumerate(robot.joint_ids)}
    for joint in range(1, model.njoints):
        name = model.names[joint]
        own = terms.get(name, {})
        parent = bodies[model.parents[joint]]
        place = _pose(model.jointPlacements[joint])
        body = bodies[joint] = ET.SubElement(parent, "body", {"name": links[name], **place})
        body.append(_inertial(model.inertias[joint]))
        k = drives.get(joint)
        element = _joint(model, joint, name, own, 0.0 if k is None else float(read.offset[k]))
        body.append(element)
        if k is None:
            continue
        if np.isfinite([low[k], high[k]]).all() and low[k] < high[k]:
            element.set("range", numbers((low[k], high[k])))
        # A motor is commanded the torque as it would be recorded.
        ET.SubElement(actuators, "motor", name=f"drive_{name}", joint=name, gear=numbers([1.0 / read.gain[k]]))
    _couple(root, robot, read.offset)
    return root


def _couple(root: ET.Element, robot: Robot, misread: Array) -> None:
    """Equality constraints for joints that follow another one (mimic)."""
    if not robot.mimics:
        return
    equality = ET.SubElement(root, "equality")
    for mimic in robot.mimics:
        # The leader's position is the one that is read; the follower's is its own.
        start = mimic.offset + mimic.multiplier * float(misread[robot.joint_names.index(mimic.leader)])
        law = numbers([start, mimic.multiplier, 0.0, 0.0, 0.0])
        ET.SubElement(equality, "joint", joint1=mimic.joint, joint2=mimic.leader, polycoef=law)


def _joint(model: pin.Model, joint: int, name: str, own: Terms, misread: float) -> ET.Element:
    """The <joint> with what it holds beyond the rigid body; its true position is that read plus ``misread`` [rad]."""
    subspace = joint_axis(model, joint)
    slides = bool(subspace[:3].any())
    axis = subspace[:3] if slides else subspace[3:]
    element = ET.Element("joint", name=name, type="slide" if slides else "hinge", axis=numbers(axis))
    rotor = float(model.armature[model.idx_vs[joint]])
    if rotor:
        element.set("armature", numbers([rotor]))
    damping = [own.get(key, 0.0) for key in ("damping", "quadratic_damping", "cubic_damping")]
    if any(damping):
        element.set("damping", numbers(np.trim_zeros(damping, "b")))
    if own.get("dry_friction", 0.0):
        element.set("frictionloss", numbers([own["dry_friction"]]))
        element.set("class", DRY)
    stiffness, offset = own.get("stiffness", 0.0), own.get("offset", 0.0)
    if stiffness or offset:
        # MuJoCo's spring pulls back with k (q - springref): the drive must add as much.
        k = stiffness or SOFT * max(1.0, abs(offset))
        element.set("stiffness", numbers([k]))
        element.set("springref", numbers([-offset / k - misread]))
    if misread:
        element.set("ref", numbers([-misread]))
    return element


def _inertial(inertia: pin.Inertia) -> ET.Element:
    matrix = np.asarray(inertia.inertia)
    entries = [matrix[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return ET.Element(
        "inertial", pos=numbers(inertia.lever), mass=numbers([inertia.mass]), fullinertia=numbers(entries)
    )


def _pose(placement: pin.SE3) -> dict[str, str]:
    quaternion = pin.Quaternion(placement.rotation)
    return {
        "pos": numbers(placement.translation),
        "quat": numbers([quaternion.w, quaternion.x, quaternion.y, quaternion.z]),
    }


def _links(source: Source) -> dict[str, str]:
    """The link that each joint carries, by joint name."""
    root = ET.fromstring(lock_joints(source.urdf, source.lock))
    children = {joint.get("name", ""): joint.find("child") for joint in root.findall("joint")}
    return {name: str(child.get("link")) for name, child in children.items() if child is not None}


def numbers(values: Iterable[float] | Array) -> str:
    """Numbers as MJCF has them, with all digits."""
    return " ".join(repr(float(v)) for v in values)
