"""What makes a robot this robot: its dynamics as plain numbers, their digest, and what differs between two.

A completed model is torque on top of one rigid body. On another one its numbers mean nothing, and joint names do not
tell two arms of one maker apart; so the model carries these numbers with it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from hybrid_dynamics.robots.robot import Robot

#: Significant digits that are kept; files differ in the last ones without meaning it.
DIGITS = 9
#: Angles of a description are often written with five digits (1.5708); lengths to a micrometre.
ROTATION, LENGTH, SHARE = 1e-5, 1e-6, 1e-6


def dynamics_of(robot: Robot) -> dict[str, Any]:
    """The rigid body as JSON values: gravity [m/s^2], and per moving body, in Pinocchio's order, its joint (type, axis,
    parent, placement), mass [kg], com [m], inertia about it [kg m^2] (xx xy yy xz yz zz) and armature [kg m^2].

    What hangs on fixed joints is part of the body that carries it. Damping, friction and limits are not dynamics of
    the rigid body.
    """
    model = robot.model
    neutral = pin.neutral(model)
    follows = {m.joint: m for m in robot.mimics}
    bodies: list[dict[str, Any]] = []
    for i in range(1, model.njoints):
        joint = model.joints[i]
        data = joint.createData()
        joint.calc(data, neutral)
        placement, inertia = model.jointPlacements[i], model.inertias[i]
        parent = model.parents[i]
        bodies.append(
            {
                "joint": model.names[i],
                "type": joint.shortname().removeprefix("JointModel"),
                "parent": model.names[parent] if parent else "base",
                "axis": _numbers(data.S),
                "translation": _numbers(placement.translation),
                "rotation": _numbers(placement.rotation),
                "mass": _numbers([inertia.mass])[0],
                "com": _numbers(inertia.lever),
                "inertia": _numbers(inertia.toDynamicParameters()[4:] if inertia.mass <= 0 else _about_com(inertia)),
                "armature": _numbers(model.armature[model.idx_vs[i] : model.idx_vs[i] + model.nvs[i]]),
            }
        )
        if (mimic := follows.get(model.names[i])) is not None:
            law = _numbers([mimic.multiplier, mimic.offset])
            bodies[-1]["mimic"] = {"joint": mimic.leader, "multiplier": law[0], "offset": law[1]}
    return {"gravity": _numbers(model.gravity.linear), "bodies": bodies}


def digest_of(dynamics: Mapping[str, Any]) -> str:
    """SHA-256 (hex) of :func:`dynamics_of`."""
    text = json.dumps(dynamics, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def differences(made_with: Mapping[str, Any], robot: Robot) -> list[str]:
    """What differs between the dynamics a model was ``made_with`` and those of ``robot``, one clause each."""
    given = dynamics_of(robot)
    if digest_of(made_with) == digest_of(given):
        return []
    out = []
    if _off(made_with["gravity"], given["gravity"], LENGTH):
        out.append(f"gravity is {_shown(given['gravity'])} m/s^2, not {_shown(made_with['gravity'])}")
    old, new = ({body["joint"]: body for body in side["bodies"]} for side in (made_with, given))
    if list(old) != list(new):
        return [*out, f"its moving joints are {', '.join(new)}, not {', '.join(old)}"]
    for name, was in old.items():
        out += [f"joint {name}: {clause}" for clause in _of_body(was, new[name])]
    return out


def _of_body(was: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    out = []
    for key in ("type", "parent"):
        if was[key] != now[key]:
            out.append(f"{key} is {now[key]}, not {was[key]}")
    if was.get("mimic") != now.get("mimic"):
        out.append("it mimics another joint otherwise")
    # The scale of a body: what is small against it is rounding.
    size = max(np.abs([*was["inertia"], *now["inertia"]]).max(), 1e-9)
    for key, what, unit, tolerance in (
        ("axis", "axis", "", ROTATION),
        ("translation", "place", " m", LENGTH),
        ("rotation", "orientation", "", ROTATION),
        ("mass", "mass of its body", " kg", SHARE * max(was["mass"], now["mass"])),
        ("com", "centre of mass of its body", " m", LENGTH),
        ("inertia", "inertia of its body", " kg m^2", SHARE * size),
        ("armature", "armature", " kg m^2", SHARE),
    ):
        if _off(was[key], now[key], tolerance):
            out.append(f"{what} is {_shown(now[key])}{unit}, not {_shown(was[key])}")
    return out


def _off(a: Any, b: Any, tolerance: float) -> bool:
    x, y = np.ravel(np.asarray(a, float)), np.ravel(np.asarray(b, float))
    return x.shape != y.shape or bool(np.any(np.abs(x - y) > tolerance))


def _about_com(inertia: pin.Inertia) -> Any:
    i = inertia.inertia
    return [i[0, 0], i[0, 1], i[1, 1], i[0, 2], i[1, 2], i[2, 2]]


def _numbers(values: Any) -> list[float]:
    # Adding zero makes -0.0 the same text as 0.0.
    return [float(f"{float(v):.{DIGITS - 1}e}") + 0.0 for v in np.ravel(np.asarray(values, float))]


def _shown(value: Any) -> str:
    return " ".join(f"{v:g}" for v in np.ravel(np.asarray(value, float)))
