"""URDF files: reading them with errors that name the fault, locking joints, finding packaged descriptions."""

from __future__ import annotations

import importlib.metadata
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path

from hybrid_dynamics.errors import InputError

MOVABLE = ("revolute", "continuous", "prismatic")


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
    check_inertia(root, file)
    return root


def check_inertia(root: ET.Element, file: str | os.PathLike[str]) -> None:
    """Raise :class:`InputError` where a moving link, with what is fixed to it, has no mass or a negative one."""
    mass: dict[str, float] = {}
    for link in root.findall("link"):
        element = link.find("inertial/mass")
        value = float(element.get("value", "nan")) if element is not None else 0.0
        if not value >= 0:
            raise InputError(f"{file}: link {link.get('name')} has mass {value} kg; expected a mass >= 0")
        mass[link.get("name", "")] = value
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
    for entry in importlib.metadata.files("example-robot-data") or []:
        if str(entry).endswith(relative):
            return Path(str(entry.locate())).resolve()
    raise InputError(f"example-robot-data holds no file {relative!r}; install the pinned version (make venv)")
