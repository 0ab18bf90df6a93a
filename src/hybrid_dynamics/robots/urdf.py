"""URDF files: reading them with errors that name the fault, locking joints, finding packaged descriptions."""

from __future__ import annotations

import importlib.metadata
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from hybrid_dynamics.errors import InputError, MissingDependencyError
from hybrid_dynamics.robots.urdf_checks import (
    MOVABLE,
    check_inertia,
    check_joints,
    check_names,
    check_numbers,
    check_tree,
    numbers,
)


@dataclass(frozen=True)
class Mimic:
    """A joint that no drive moves: ``angle = multiplier * angle of leader + offset``."""

    joint: str
    leader: str
    multiplier: float
    offset: float


def parse_urdf(path: str | os.PathLike[str]) -> ET.Element:
    """The XML of ``path``; raises :class:`InputError` where it is missing, not XML, xacro, or not a URDF."""
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{file}: no such URDF file; give the path of the robot's URDF")
    return _parsed(file.read_text(encoding="utf-8", errors="replace"), str(file))


def _parsed(text: str, origin: str) -> ET.Element:
    # ElementTree expands no external entities; a document type definition has no business in a URDF.
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(f"{origin}: holds a document type definition; expected a plain URDF")
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise InputError(f"{origin}: not valid XML ({error}); expected a URDF (expand xacro first)") from None
    # Only what is to be expanded; xacro leaves traces in comments, names and geometry that nobody reads here.
    if any("xacro" in element.tag for element in root):
        name = Path(origin).name
        stem = name.removesuffix(".xacro").removesuffix(".urdf")
        raise InputError(
            f"{origin}: is xacro, not yet a URDF; convert it: xacro {name} > {stem}.urdf (pip install xacro)"
        )
    if root.tag != "robot":
        raise InputError(f"{origin}: root element is <{root.tag}>; expected <robot> (a URDF)")
    return root


def read_urdf(path: str | os.PathLike[str]) -> ET.Element:
    """Parse and check ``path``; :class:`InputError` where it is no URDF of moving links that can exist."""
    root = parse_urdf(path)
    _check(root, path)
    return root


def read_text(text: str, origin: str) -> ET.Element:
    """The same of URDF ``text``, which errors call ``origin``."""
    root = _parsed(text, origin)
    _check(root, origin)
    return root


def _check(root: ET.Element, path: str | os.PathLike[str]) -> None:
    check_names(root, path)
    check_joints(root, path)
    if not movable_joints(root):
        raise InputError(f"{path}: no movable joint; expected at least one joint of type {', '.join(MOVABLE)}")
    check_tree(root, path)
    check_numbers(root, path)
    mimics(root, path)
    check_inertia(root, path)


def movable_joints(root: ET.Element) -> list[str]:
    """Names of the joints that drives move, in the order of the file; those that mimic another are none."""
    return [
        joint.get("name", "")
        for joint in root.findall("joint")
        if joint.get("type") in MOVABLE and joint.find("mimic") is None
    ]


def mimics(root: ET.Element, path: str | os.PathLike[str]) -> list[Mimic]:
    """The joints that follow another, with what they follow; :class:`InputError` where that is no driven joint."""
    driven = set(movable_joints(root))
    out = []
    for joint in root.findall("joint"):
        element = joint.find("mimic")
        if element is None or joint.get("type") not in MOVABLE:
            continue
        name, leader = joint.get("name", ""), element.get("joint", "")
        where = f"{path}: joint {name}"
        if leader not in driven:
            raise InputError(
                f"{where} mimics {leader!r}, which is no driven joint; expected one of {', '.join(sorted(driven))}"
            )
        factors = [
            numbers(element, key, 1, where)[0] if element.get(key) is not None else default
            for key, default in (("multiplier", 1.0), ("offset", 0.0))
        ]
        out.append(Mimic(name, leader, factors[0], factors[1]))
    return out


def lock_joints(path: str | os.PathLike[str], lock: Iterable[str] = (), without: Iterable[str] = ()) -> str:
    """The URDF of ``path`` as text, with the joints ``lock`` fixed at zero and without geometry.

    ``without``: joints (fixed or not) that are taken off together with all that hangs on them.

    What is fixed becomes part of the link that carries it (Pinocchio lumps the inertia).
    """
    root = parse_urdf(path)
    check_names(root, path)
    for name in without:
        _take_off(root, name, path)
    _lock(root, set(lock), path)
    # What is locked need not be physical by itself: it becomes part of the link that carries it.
    _check(root, path)
    for link in root.findall("link"):
        for tag in ("visual", "collision"):
            for element in link.findall(tag):
                link.remove(element)
    for element in list(root):
        if element.tag not in ("link", "joint"):
            root.remove(element)
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _lock(root: ET.Element, locked: set[str], path: str | os.PathLike[str]) -> None:
    """Fix the joints ``locked``, and those that mimic them, at zero."""
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    free = {name for name, joint in joints.items() if joint.get("type") != "fixed"}
    for name in sorted(locked - free):
        raise InputError(f"{path}: no movable joint {name!r} to lock; its joints are {', '.join(sorted(free))}")
    if locked and not free - locked:
        raise InputError(f"{path}: all joints are locked; leave at least one of {', '.join(sorted(free))} free")
    for name in sorted(free - locked):
        leader = joints[name].find("mimic")
        if leader is not None and leader.get("joint") in locked:
            locked = locked | {name}
            if float(leader.get("offset", "0") or 0) != 0:
                raise InputError(
                    f"{path}: joint {name} mimics the locked {leader.get('joint')} at an offset; lock it too"
                )
    for name in locked:
        joints[name].set("type", "fixed")
        for tag in ("mimic", "limit", "dynamics", "axis"):
            for element in joints[name].findall(tag):
                joints[name].remove(element)


def _take_off(root: ET.Element, name: str, path: str | os.PathLike[str]) -> None:
    """Remove joint ``name`` of ``root`` and every link and joint behind it."""
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    if name not in joints:
        raise InputError(f"{path}: no joint {name!r} to take off; its joints are {', '.join(sorted(joints))}")
    links = {link.get("name", ""): link for link in root.findall("link")}
    ends = {key: [joint.find(end) for end in ("parent", "child")] for key, joint in joints.items()}
    pair = {key: tuple("" if end is None else end.get("link", "") for end in two) for key, two in ends.items()}
    doomed = [name]
    for key in doomed:
        root.remove(joints[key])
        root.remove(links[pair[key][1]])
        doomed += [other for other, (parent, _) in pair.items() if parent == pair[key][1]]


def find_description(relative: str) -> Path:
    """Path of a file of the example-robot-data distribution, named by the end of its path.

    The distribution ships data without an importable module, so its own file list is searched.
    """
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        raise MissingDependencyError(
            f"the description {relative!r} is in the package example-robot-data, which is not installed; run: pip "
            "install '.[study]' in a clone of the project, or give the path of a URDF of your own"
        ) from None
    for entry in files:
        if str(entry).endswith(relative):
            return Path(str(entry.locate())).resolve()
    raise InputError(f"example-robot-data holds no file {relative!r}; install the pinned version (make venv)")
