"""URDF files: reading them with errors that name the fault, locking joints, finding packaged descriptions."""

from __future__ import annotations

import importlib.metadata
import math
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path

from hybrid_dynamics.errors import InputError, MissingDependencyError

MOVABLE = ("revolute", "continuous", "prismatic")
#: A moment of inertia [kg m^2] this little below zero was rounded by the program that wrote the file.
ROUNDING = 1e-9


def read_urdf(path: str | os.PathLike[str]) -> ET.Element:
    """Parse ``path``; raises :class:`InputError` where it is missing, not XML or not a URDF of moving links."""
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{file}: no such URDF file; give the path of the robot's URDF")
    # ElementTree expands no external entities; a document type definition has no business in a URDF.
    text = file.read_text(encoding="utf-8", errors="replace")
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(f"{file}: holds a document type definition; expected a plain URDF")
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise InputError(f"{file}: not valid XML ({error}); expected a URDF (expand xacro first)") from None
    if root.tag != "robot":
        raise InputError(f"{file}: root element is <{root.tag}>; expected <robot> (a URDF)")
    if not movable_joints(root):
        raise InputError(f"{file}: no movable joint; expected at least one joint of type {', '.join(MOVABLE)}")
    check_tree(root, file)
    check_numbers(root, file)
    check_inertia(root, file)
    return root


def check_tree(root: ET.Element, file: str | os.PathLike[str]) -> None:
    """Raise :class:`InputError` where joints do not connect the links to one tree."""
    links = {link.get("name", "") for link in root.findall("link")}
    carried: dict[str, str] = {}
    for joint in root.findall("joint"):
        ends = [joint.find(end) for end in ("parent", "child")]
        parent, child = ("" if end is None else end.get("link", "") for end in ends)
        for end, link in (("parent", parent), ("child", child)):
            if link not in links:
                raise InputError(f"{file}: joint {joint.get('name')}: {end} link {link!r} is not in the file; add it")
        if child in carried:
            raise InputError(f"{file}: link {child} hangs on more than one joint; expected a tree of links")
        carried[child] = parent
    if len(links - set(carried)) != 1:
        loose = ", ".join(sorted(links - set(carried))[:5]) or "none"
        raise InputError(f"{file}: links that hang on no joint: {loose}; expected one, the base")
    for link in carried:
        path = [link]
        while path[-1] in carried:
            path.append(carried[path[-1]])
            if path[-1] in path[:-1]:
                raise InputError(f"{file}: link {path[-1]} carries itself; expected a tree of links")


def check_numbers(root: ET.Element, file: str | os.PathLike[str]) -> None:
    """Raise :class:`InputError` for what should be a number and is none: the URDF parser would drop it in silence."""
    for link in root.findall("link"):
        where = f"{file}: link {link.get('name')}"
        for inertial in link.findall("inertial"):
            mass, inertia = inertial.find("mass"), inertial.find("inertia")
            if mass is None or inertia is None:
                raise InputError(f"{where}: <inertial> without <{'mass' if mass is None else 'inertia'}>; add it")
            if (value := _numbers(mass, "value", 1, where)[0]) < 0:
                raise InputError(f"{where} has mass {value} kg; expected a mass >= 0")
            for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
                value = _numbers(inertia, name, 1, where)[0]
                if value < -ROUNDING and name in ("ixx", "iyy", "izz"):
                    raise InputError(f"{where} has {name} {value} kg m^2; expected a moment of inertia >= 0")
            _check_origin(inertial, where)
    for joint in root.findall("joint"):
        where = f"{file}: joint {joint.get('name')}"
        _check_origin(joint, where)
        axis, limit = joint.find("axis"), joint.find("limit")
        if joint.get("type") not in MOVABLE:
            continue
        if axis is not None and not any(_numbers(axis, "xyz", 3, where)):
            raise InputError(f"{where}: its axis is zero; expected a direction such as 0 0 1")
        if limit is None and joint.get("type") != "continuous":
            raise InputError(f"{where} has no <limit>; add one with lower, upper, velocity and effort")
        if limit is not None:
            for name in set(limit.keys()) & {"lower", "upper", "velocity", "effort"}:
                _numbers(limit, name, 1, where)


def _check_origin(element: ET.Element, where: str) -> None:
    for origin in element.findall("origin"):
        for name in ("xyz", "rpy"):
            if origin.get(name) is not None:
                _numbers(origin, name, 3, where)


def _numbers(element: ET.Element, name: str, count: int, where: str) -> list[float]:
    """Attribute ``name`` as ``count`` finite numbers; raises :class:`InputError`."""
    text = element.get(name)
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(value) for value in values):
        expected = "a finite number" if count == 1 else f"{count} finite numbers"
        raise InputError(f"{where}: <{element.tag}> {name} is {text!r}; expected {expected}")
    return values


def check_inertia(root: ET.Element, file: str | os.PathLike[str]) -> None:
    """Raise :class:`InputError` where a moving link, with what is fixed to it, has no mass."""
    mass: dict[str, float] = {}
    for link in root.findall("link"):
        element = link.find("inertial/mass")
        mass[link.get("name", "")] = float(element.get("value", "0")) if element is not None else 0.0
    joints = root.findall("joint")
    children: dict[str, list[tuple[str, str]]] = {}
    for joint in joints:
        parent, child = joint.find("parent"), joint.find("child")
        if parent is not None and child is not None:
            children.setdefault(parent.get("link", ""), []).append((child.get("link", ""), joint.get("type", "")))

    def subtree(link: str) -> float:
        return mass.get(link, 0.0) + sum(subtree(child) for child, _ in children.get(link, []))

    for joint in joints:
        child = joint.find("child")
        if joint.get("type") in MOVABLE and child is not None and subtree(child.get("link", "")) <= 0:
            raise InputError(
                f"{file}: link {child.get('link')}, moved by joint {joint.get('name')}, has no inertia; "
                "add an <inertial> element with mass and inertia"
            )


def movable_joints(root: ET.Element) -> list[str]:
    """Names of the joints that move, in the order of the file."""
    return [joint.get("name", "") for joint in root.findall("joint") if joint.get("type") in MOVABLE]


def lock_joints(path: str | os.PathLike[str], lock: Iterable[str] = ()) -> str:
    """The URDF of ``path`` as text, with the joints ``lock`` fixed at zero and without geometry.

    What is fixed becomes part of the link that carries it (Pinocchio lumps the inertia).
    """
    root = read_urdf(path)
    names = set(movable_joints(root))
    for name in lock:
        if name not in names:
            raise InputError(f"{path}: no movable joint {name!r} to lock; its joints are {', '.join(sorted(names))}")
    locked = set(lock)
    if not names - locked:
        raise InputError(f"{path}: all joints are locked; leave at least one of {', '.join(sorted(names))} free")
    for joint in root.findall("joint"):
        if joint.get("name") in locked:
            joint.set("type", "fixed")
            for tag in ("mimic", "limit", "dynamics", "axis"):
                for element in joint.findall(tag):
                    joint.remove(element)
    for link in root.findall("link"):
        for tag in ("visual", "collision"):
            for element in link.findall(tag):
                link.remove(element)
    for element in list(root):
        if element.tag not in ("link", "joint"):
            root.remove(element)
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def find_description(relative: str) -> Path:
    """Path of a file of the example-robot-data distribution, named by the end of its path.

    The distribution ships data without an importable module, so its own file list is searched.
    """
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        raise MissingDependencyError(
            f"the description {relative!r} is in the package example-robot-data, which is not installed; run: pip "
            "install 'hybrid-dynamics[study]', or give the path of a URDF of your own"
        ) from None
    for entry in files:
        if str(entry).endswith(relative):
            return Path(str(entry.locate())).resolve()
    raise InputError(f"example-robot-data holds no file {relative!r}; install the pinned version (make venv)")
