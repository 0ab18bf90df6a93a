"""URDF: the user's own file with the inertials, damping and friction of the completed model; the rest stays."""

from __future__ import annotations

import numpy as np

from hybrid_dynamics.effects.inertia import INERTIA_ENTRIES, is_physical, to_body, to_dynamic
from hybrid_dynamics.export.body import BodyNumbers
from hybrid_dynamics.export.source import Rendered, Source
from hybrid_dynamics.export.xml_text import Node, XmlText
from hybrid_dynamics.robots.urdf_checks import MOVABLE
from hybrid_dynamics.types import Array

#: Smallest share that can be given to the links fixed to a moving one, searched by halving this often.
_HALVINGS = 40


def render(source: Source, name: str, head: list[str]) -> Rendered:
    """The user's URDF with the numbers of the completed model."""
    document = XmlText(source.urdf.read_bytes())
    notes = _set_friction(document, source) + _set_inertials(document, source)
    document.head(head + [f"Note: {note}" for note in notes])
    return Rendered({name: document.content()}, tuple(notes))


def _set_friction(document: XmlText, source: Source) -> list[str]:
    notes = []
    joints = {joint.attributes.get("name"): joint for joint in document.root.all("joint")}
    for name, terms in source.joint_terms("urdf").items():
        node = joints[name]
        dynamics = node.child("dynamics")
        values = {"damping": terms.get("damping"), "friction": terms.get("dry_friction")}
        given = {} if dynamics is None else dynamics.attributes
        for key, value in values.items():
            if value is None and float(given.get(key, "0")) != 0:
                notes.append(f"{name} keeps its {key} of {given[key]}, of which the model says nothing")
        new = {key: repr(value) for key, value in values.items() if value is not None}
        if not new:
            continue
        if dynamics is None:
            document.append(node, "<dynamics " + " ".join(f'{k}="{v}"' for k, v in new.items()) + "/>")
        else:
            document.set_attributes(dynamics, new)
    return notes


def _set_inertials(document: XmlText, source: Source) -> list[str]:
    notes = []
    robot, completed = source.robot, source.kept.completed_robot
    before, after = BodyNumbers.of(robot).inertias, BodyNumbers.of(completed).inertias
    links = {link.attributes["name"]: link for link in document.root.all("link")}
    for joint, old, new in zip(robot.joint_names, before, after, strict=True):
        if np.array_equal(old, new):
            continue
        moving = (*robot.joint_names, *(mimic.joint for mimic in robot.mimics))
        carried, fixed = _rigidly_joined(document.root, joint, moving)
        own = _own_inertia(links[carried])
        share = _share(new, old - own)
        if share < 1:
            notes.append(
                f"links fixed to {carried} ({', '.join(fixed)}) keep {share:.3g} of their inertia: with all of it the "
                "rest could not exist"
            )
            for name in fixed:
                _scale(document, links[name], share)
        _set_inertial(document, links[carried], new - share * (old - own))
        if not is_physical(new):
            notes.append(f"the inertia of {carried} is not physically consistent, as in the model it comes from")
    return notes


def _rigidly_joined(root: Node, joint: str, moving: tuple[str, ...]) -> tuple[str, list[str]]:
    """The link that ``joint`` carries, and those that move with it (through joints that do not move here)."""
    ends: list[tuple[str, str, bool]] = []
    first = ""
    for node in root.all("joint"):
        parent, child = node.child("parent"), node.child("child")
        if parent is None or child is None:
            continue
        name = node.attributes.get("name", "")
        free = node.attributes.get("type") in MOVABLE and name in moving
        ends.append((parent.attributes["link"], child.attributes["link"], free))
        if name == joint:
            first = child.attributes["link"]
    found = [first]
    for link in found:  # grows while it is walked through
        found += [child for parent, child, free in ends if parent == link and not free]
    return first, found[1:]


def _own_inertia(link: Node) -> Array:
    """(10,) dynamic parameters of a link in its own frame; zeros without <inertial>."""
    inertial = link.child("inertial")
    if inertial is None:
        return np.zeros(10)
    mass, inertia, origin = (inertial.child(tag) for tag in ("mass", "inertia", "origin"))
    assert mass is not None
    assert inertia is not None
    given = {} if origin is None else origin.attributes
    place = np.array([float(x) for x in given.get("xyz", "0 0 0").split()])
    rotation = _rotation(*(float(x) for x in given.get("rpy", "0 0 0").split()))
    entries = np.array([float(inertia.attributes[f"i{e}"]) for e in INERTIA_ENTRIES])
    xx, xy, yy, xz, yz, zz = entries
    turned = rotation @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ rotation.T
    body = {"mass": float(mass.attributes["value"])}
    body |= {f"com_{axis}": float(x) for axis, x in zip("xyz", place, strict=True)}
    body |= {f"inertia_{e}": float(turned["xyz".index(e[0]), "xyz".index(e[1])]) for e in INERTIA_ENTRIES}
    return to_dynamic(body)


def _rotation(roll: float, pitch: float, yaw: float) -> Array:
    """URDF's fixed-axis angles: Rz(yaw) Ry(pitch) Rx(roll)."""
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def _share(whole: Array, fixed: Array) -> float:
    """Largest share of ``fixed`` (10,) that leaves a body which can exist when taken from ``whole`` (10,)."""
    if not fixed.any() or not is_physical(whole) or is_physical(whole - fixed):
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_physical(whole - middle * fixed) else (low, middle)
    return low


def _set_inertial(document: XmlText, link: Node, dynamic: Array) -> None:
    body = to_body(dynamic)
    origin = {"xyz": " ".join(repr(body[f"com_{axis}"]) for axis in "xyz"), "rpy": "0 0 0"}
    mass = {"value": repr(body["mass"])}
    inertia = {f"i{e}": repr(body[f"inertia_{e}"]) for e in INERTIA_ENTRIES}
    parts = {"origin": origin, "mass": mass, "inertia": inertia}
    inertial = link.child("inertial")
    if inertial is None:
        document.append(link, "<inertial>" + "".join(_element(tag, parts[tag]) for tag in parts) + "</inertial>")
        return
    missing = ""
    for tag, values in parts.items():
        node = inertial.child(tag)
        if node is None:
            missing += _element(tag, values)
        else:
            document.set_attributes(node, values)
    if missing:
        document.append(inertial, missing)


def _element(tag: str, attributes: dict[str, str]) -> str:
    return f"<{tag} " + " ".join(f'{key}="{value}"' for key, value in attributes.items()) + "/>"


def _scale(document: XmlText, link: Node, share: float) -> None:
    inertial = link.child("inertial")
    if inertial is None:
        return
    for tag, names in (("mass", ("value",)), ("inertia", tuple(f"i{e}" for e in INERTIA_ENTRIES))):
        node = inertial.child(tag)
        assert node is not None
        document.set_attributes(node, {name: repr(share * float(node.attributes[name])) for name in names})
