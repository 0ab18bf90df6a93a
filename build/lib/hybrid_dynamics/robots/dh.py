"""A robot given by standard Denavit-Hartenberg rows and link inertials, written as a plain URDF.

Standard convention: frame i is fixed to link i behind its joint, T_{i-1,i} = Rz(q_i + offset_i) Tz(d_i) Tx(a_i)
Rx(alpha_i), and joint i turns about z_{i-1}. In a URDF a joint turns about an axis of its own frame, so link i's URDF
frame is placed where frame i-1 is at q_i = 0, turned by the offset: the joint's placement in the previous link is
[Tz(d) Tx(a) Rx(alpha)]_{i-1} Rz(offset_i), its axis z, and the link's inertia, given in DH frame i, is carried over by
[Tz(d) Tx(a) Rx(alpha)]_i. The joint angle equals q_i of the table. The base's z axis is the first joint's axis; gravity
is Pinocchio's, along -z of the base.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_dynamics.errors import ConfigError, require
from hybrid_dynamics.types import Array


@dataclass(frozen=True)
class DHRow:
    """One row of a standard DH table: ``alpha`` [rad], ``a`` [m], ``d`` [m], ``theta_offset`` [rad]."""

    alpha: float
    a: float
    d: float
    theta_offset: float = 0.0


@dataclass(frozen=True)
class DHLink:
    """Inertials of a link in its DH frame: ``mass`` [kg], ``com`` [m] (3), ``inertia`` [kg m^2] = xx xy xz yy yz zz.

    The inertia is the tensor about the centre of mass (off-diagonal elements are tensor elements, -integral of xy dm).
    """

    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]

    def tensor(self) -> Array:
        """(3, 3) inertia tensor about the centre of mass, along the DH frame's axes [kg m^2]."""
        xx, xy, xz, yy, yz, zz = self.inertia
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@dataclass(frozen=True)
class DHLimit:
    """Joint limits: ``lower``, ``upper`` [rad], ``velocity`` [rad/s], ``effort`` [N m]."""

    lower: float
    upper: float
    velocity: float
    effort: float

    def __post_init__(self) -> None:
        require(self.lower < self.upper, f"joint limit lower = {self.lower} >= upper = {self.upper} rad; swap them")
        require(self.velocity > 0, f"joint limit velocity = {self.velocity} rad/s; expected > 0")
        require(self.effort > 0, f"joint limit effort = {self.effort} N m; expected > 0")


def rows_from_config(rows: Sequence[Mapping[str, float]]) -> list[DHRow]:
    """DH rows from mappings with the keys alpha, a, d and, where not 0, theta_offset."""
    keys = ("alpha", "a", "d", "theta_offset")
    out = []
    for i, row in enumerate(rows, 1):
        _check_keys(row, keys[:3], keys, f"dh row {i}")
        out.append(DHRow(**{key: float(value) for key, value in row.items()}))
    return out


def links_from_config(links: Sequence[Mapping[str, Any]]) -> list[DHLink]:
    """Links from mappings with the keys mass, com (3 numbers), inertia (6 numbers: xx xy xz yy yz zz)."""
    keys = ("mass", "com", "inertia")
    out = []
    for i, link in enumerate(links, 1):
        _check_keys(link, keys, keys, f"link {i}")
        com, inertia = [float(x) for x in link["com"]], [float(x) for x in link["inertia"]]
        require(
            len(com) == 3 and len(inertia) == 6,
            f"link {i}: com has {len(com)} and inertia {len(inertia)} numbers; expected 3 and 6 (xx xy xz yy yz zz)",
        )
        xx, xy, xz, yy, yz, zz = inertia
        out.append(DHLink(float(link["mass"]), (com[0], com[1], com[2]), (xx, xy, xz, yy, yz, zz)))
    return out


def limits_from_config(limits: Sequence[Mapping[str, float]]) -> list[DHLimit]:
    """Limits from mappings with the keys lower, upper, velocity, effort."""
    keys = ("lower", "upper", "velocity", "effort")
    out = []
    for i, limit in enumerate(limits, 1):
        _check_keys(limit, keys, keys, f"joint limit {i}")
        out.append(DHLimit(**{key: float(value) for key, value in limit.items()}))
    return out


def _check_keys(values: Mapping[str, Any], needed: Sequence[str], known: Sequence[str], what: str) -> None:
    missing, unknown = sorted(set(needed) - set(values)), sorted(set(values) - set(known))
    require(not missing, f"{what}: {missing} missing; expected the keys {', '.join(known)}")
    require(not unknown, f"{what}: unknown key {unknown}; expected the keys {', '.join(known)}")


def fixed_part(row: DHRow) -> Array:
    """Tz(d) Tx(a) Rx(alpha) as a (4, 4) homogeneous matrix."""
    c, s = np.cos(row.alpha), np.sin(row.alpha)
    return np.array([[1, 0, 0, row.a], [0, c, -s, 0], [0, s, c, row.d], [0, 0, 0, 1.0]])


def dh_to_urdf(
    name: str,
    joint_names: Sequence[str],
    dh_rows: Sequence[DHRow],
    links: Sequence[DHLink],
    limits: Sequence[DHLimit],
) -> str:
    """The robot as URDF text; see the module's text for the frames.

    Raises :class:`ConfigError` naming the joint where counts differ or a link's inertia is impossible.
    """
    n = len(joint_names)
    for what, values in (("DH rows", dh_rows), ("links", links), ("limits", limits)):
        require(len(values) == n, f"robot {name}: {len(values)} {what} for {n} joints; expected one each")
    require(n > 0, f"robot {name}: no joint; expected at least one")
    robot = ET.Element("robot", name=name)
    ET.SubElement(robot, "link", name="base_link")
    parent, placement = "base_link", np.eye(4)
    for joint, row, link, limit in zip(joint_names, dh_rows, links, limits, strict=True):
        child = f"{joint}_link"
        behind = fixed_part(row)
        _link(robot, child, link, behind, name)
        _joint(robot, joint, parent, child, placement @ _rotation_z(row.theta_offset), limit)
        parent, placement = child, behind
    ET.indent(robot)
    return '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"


def _link(robot: ET.Element, name: str, link: DHLink, behind: Array, robot_name: str) -> None:
    tensor = link.tensor()
    moments = np.linalg.eigvalsh(tensor)
    possible = link.mass > 0 and moments[0] >= 0 and moments[2] <= moments[0] + moments[1] + 1e-9 * moments[2]
    if not possible:
        raise ConfigError(
            f"robot {robot_name}, link {name}: mass {link.mass} kg with principal moments {moments} kg m^2 is no solid "
            "body; expected a positive mass and moments that fulfil the triangle inequality (check the tensor's signs)"
        )
    rotation = behind[:3, :3]
    com = rotation @ np.asarray(link.com) + behind[:3, 3]
    turned = rotation @ tensor @ rotation.T
    inertial = ET.SubElement(ET.SubElement(robot, "link", name=name), "inertial")
    ET.SubElement(inertial, "origin", xyz=_numbers(com), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=repr(float(link.mass)))
    elements = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    ET.SubElement(inertial, "inertia", {key: repr(float(turned[at])) for key, at in elements.items()})


def _joint(robot: ET.Element, name: str, parent: str, child: str, placement: Array, limit: DHLimit) -> None:
    joint = ET.SubElement(robot, "joint", name=name, type="revolute")
    ET.SubElement(joint, "origin", xyz=_numbers(placement[:3, 3]), rpy=_numbers(_roll_pitch_yaw(placement[:3, :3])))
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "axis", xyz="0 0 1")
    ET.SubElement(
        joint,
        "limit",
        lower=repr(float(limit.lower)),
        upper=repr(float(limit.upper)),
        velocity=repr(float(limit.velocity)),
        effort=repr(float(limit.effort)),
    )


def _rotation_z(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def _roll_pitch_yaw(rotation: Array) -> Array:
    """URDF's roll, pitch, yaw: rotation = Rz(yaw) Ry(pitch) Rx(roll)."""
    level = np.hypot(rotation[0, 0], rotation[1, 0])
    pitch = np.arctan2(-rotation[2, 0], level)
    if level > 1e-9:
        roll = np.arctan2(rotation[2, 1], rotation[2, 2])
        yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    else:  # pitch +-pi/2: only roll -+ yaw is defined
        roll, yaw = np.arctan2(np.sign(pitch) * rotation[0, 1], rotation[1, 1]), 0.0
    return np.array([roll, pitch, yaw])


def _numbers(values: Array) -> str:
    return " ".join(repr(float(x)) for x in values)
