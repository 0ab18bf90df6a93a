"""``<dynamics damping friction>`` of a URDF as effects: what the description itself says of friction."""

from __future__ import annotations

import os

from hybrid_dynamics.effects.base import Effect
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.robots.urdf import parse_urdf
from hybrid_dynamics.robots.urdf_checks import numbers

#: Attribute, effect, parameter.
ATTRIBUTES = (
    ("damping", "viscous_friction", "viscous_coefficient"),
    ("friction", "coulomb_friction", "coulomb_torque"),
)


def urdf_dynamics(path: str | os.PathLike[str], robot: Robot) -> tuple[Effect, ...]:
    """Viscous and Coulomb friction that the URDF ``path`` gives for the driven joints of ``robot``, none that is zero.

    The file has been read as ``robot`` already: its values are numbers, and none is negative.
    """
    out = []
    joints = {joint.get("name", ""): joint for joint in parse_urdf(path).findall("joint")}
    for name in robot.joint_names:
        element = joints[name].find("dynamics") if name in joints else None
        if element is None:
            continue
        for attribute, effect, parameter in ATTRIBUTES:
            if element.get(attribute) is None:
                continue
            value = numbers(element, attribute, 1, f"{path}: joint {name}")[0]
            if value > 0:
                out.append(Effect(effect, (name,), {parameter: value}))
    return tuple(out)
