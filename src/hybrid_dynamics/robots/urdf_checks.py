"""Is a URDF a robot that can exist? One line for the first fault, with the name of the link or joint."""

from __future__ import annotations

import math
import os
import xml.etree.ElementTree as ET

from hybrid_dynamics.errors import InputError

MOVABLE = ("revolute", "continuous", "prismatic")
#: A moment of inertia [kg m^2] this little below zero was rounded by the program that wrote the file.
ROUNDING = 1e-9


def check_names(root: ET.Element, file: str | os.PathLike[str]) -> None:
    """Raise :class:`InputError` for links and joints without a name, or with one that is given twice."""
    for kind in ("link", "joint"):
        seen: set[str] = set()
        for position, element in enumerate(root.findall(kind), 1):
            name = element.get("name", "")
            if not name.strip():
                raise InputError(f"{file}: {kind} number {position} has no name; give every {kind} its own")
            if name in seen:
                raise InputError(f"{file}: two {kind}s are called {name!r}; give every {kind} its own name")
            seen.add(name)


def check_joints(root: ET.Element, file: str | os.PathLike[str]) -> None:
    """Raise :class:`InputError` for joints that are no single axis."""
    for joint in root.findall("joint"):
        name, kind = joint.get("name"), joint.get("type")
        if kind in ("floating", "planar"):
            what = "six" if kind == "floating" else "three"
            raise InputError(
                f"{file}: joint {name} is {kind}, {what} degrees of freedom without a drive; expected an arm on a "
                f'fixed base: write type="fixed" there, or --lock {name}'
            )
        if kind not in (*MOVABLE, "fixed"):
            raise InputError(f"{file}: joint {name} has type {kind!r}; expected {', '.join(MOVABLE)} or fixed")


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
    grounded: set[str] = links - set(carried)
    for link in carried:
        path = [link]
        on_path = {link}
        while path[-1] not in grounded:
            above = carried[path[-1]]
            if above in on_path:
                raise InputError(f"{file}: link {above} carries itself; expected a tree of links")
            path.append(above)
            on_path.add(above)
        grounded |= on_path


def check_numbers(root: ET.Element, file: str | os.PathLike[str]) -> None:
    """Raise :class:`InputError` for what should be a number and is none: the URDF parser would drop it in silence."""
    for link in root.findall("link"):
        where = f"{file}: link {link.get('name')}"
        for inertial in link.findall("inertial"):
            mass, inertia = inertial.find("mass"), inertial.find("inertia")
            if mass is None or inertia is None:
                raise InputError(f"{where}: <inertial> without <{'mass' if mass is None else 'inertia'}>; add it")
            if (value := numbers(mass, "value", 1, where)[0]) < 0:
                raise InputError(f"{where} has mass {value} kg; expected a mass >= 0")
            for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
                value = numbers(inertia, name, 1, where)[0]
                if value < -ROUNDING and name in ("ixx", "iyy", "izz"):
                    raise InputError(f"{where} has {name} {value} kg m^2; expected a moment of inertia >= 0")
            _check_origin(inertial, where)
    for joint in root.findall("joint"):
        where = f"{file}: joint {joint.get('name')}"
        _check_origin(joint, where)
        axis, limit = joint.find("axis"), joint.find("limit")
        if joint.get("type") not in MOVABLE:
            continue
        for element in joint.findall("dynamics"):
            for name in ("damping", "friction"):
                if element.get(name) is not None and (value := numbers(element, name, 1, where)[0]) < 0:
                    raise InputError(f"{where}: <dynamics> {name} is {value:g}; expected 0 or more: it would drive")
        if axis is not None and not any(numbers(axis, "xyz", 3, where)):
            raise InputError(f"{where}: its axis is zero; expected a direction such as 0 0 1")
        if limit is None and joint.get("type") != "continuous":
            raise InputError(f"{where} has no <limit>; add one with lower, upper, velocity and effort")
        if limit is not None:
            given = {
                name: numbers(limit, name, 1, where)[0]
                for name in ("lower", "upper", "velocity", "effort")
                if limit.get(name) is not None
            }
            if given.get("lower", 0.0) > given.get("upper", 0.0) and joint.get("type") != "continuous":
                raise InputError(
                    f"{where}: its lower limit {given.get('lower', 0.0):g} is above its upper limit "
                    f"{given.get('upper', 0.0):g}; exchange them"
                )
            for name in ("velocity", "effort"):
                if given.get(name, 0.0) < 0:
                    raise InputError(f"{where}: its {name} limit is {given[name]:g}; expected 0 (not given) or more")


def _check_origin(element: ET.Element, where: str) -> None:
    for origin in element.findall("origin"):
        for name in ("xyz", "rpy"):
            if origin.get(name) is not None:
                numbers(origin, name, 3, where)


def numbers(element: ET.Element, name: str, count: int, where: str) -> list[float]:
    """Attribute ``name`` as ``count`` finite numbers; raises :class:`InputError`."""
    text = element.get(name)
    try:
        # Python reads 1_0 as 10; nobody who writes a URDF means that.
        values = [float(word) for word in (text or "").split()] if "_" not in (text or "") else []
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
    parent_of = {}
    for joint in joints:
        parent, child = joint.find("parent"), joint.find("child")
        if parent is not None and child is not None:
            parent_of[child.get("link", "")] = parent.get("link", "")
    heavy: set[str] = set()
    for name in [name for name, own in mass.items() if own > 0]:
        # Upwards from every link with mass, until a link that is known to carry some.
        above: str | None = name
        while above is not None and above not in heavy:
            heavy.add(above)
            above = parent_of.get(above)

    for joint in joints:
        child = joint.find("child")
        if joint.get("type") in MOVABLE and child is not None and child.get("link", "") not in heavy:
            raise InputError(
                f"{file}: link {child.get('link')}, moved by joint {joint.get('name')}, has no inertia; "
                "add an <inertial> element with mass and inertia"
            )
