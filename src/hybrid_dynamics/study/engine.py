"""Another engine's robot: a URDF in MuJoCo with hidden causes, its torque by MuJoCo's inverse dynamics.

What the blind study's own simulation computes with Pinocchio and this package's laws, MuJoCo computes here with its
own joints (polynomial damping and stiffness, friction loss, armature), bodies, gravity and tendons. Only what MuJoCo
lacks (readings, memory, ripple) is added on top, by laws written in :mod:`.outside`, not taken from the catalogue.

Traps: friction loss is exact Coulomb friction in inverse dynamics only with ``solreffriction = 0 -1e9``; joint and
actuator limits act in it too and are switched off; so is MuJoCo's bound on small masses and inertias.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.robots.urdf import lock_joints
from hybrid_dynamics.types import Array

#: Makes MuJoCo's friction loss exact Coulomb friction.
_EXACT = (0.0, -1e9)


@dataclass(frozen=True)
class Hidden:
    """One hidden cause: ``kind`` (see :data:`NATIVE` and :mod:`.outside`), 0-based ``joint`` or None, numbers."""

    kind: str
    joint: int | None = None
    values: Mapping[str, float] = field(default_factory=dict)

    @property
    def at(self) -> int:
        """The joint, for causes that sit at one."""
        if self.joint is None:
            raise InputError(f"hidden cause {self.kind} needs a joint")
        return self.joint


#: Causes that MuJoCo itself computes, and their numbers (SI; angles in rad).
NATIVE: dict[str, tuple[str, ...]] = {
    "damping": ("d0", "d1", "d2"),  # (d0 + d1 |v| + d2 v^2) v
    "frictionloss": ("torque",),
    "armature": ("armature",),
    "stiffness": ("stiffness", "rest", "cubic"),  # k x + cubic x^3, x = q - rest
    "mass": ("ratio",),  # mass and inertia of the link and what is fixed to it, all in proportion
    "com": ("x", "y", "z"),  # shift of their centre of mass
    "block": ("mass", "x", "y", "z", "edge_x", "edge_y", "edge_z"),  # a solid block on the link
    "tilt": ("roll", "pitch"),
    "tendon": ("partner", "damping", "friction", "armature"),  # seen by a motor at dq_joint + dq_partner
}


def read_text(robot_urdf: str | os.PathLike[str], lock: tuple[str, ...] = ()) -> str:
    """URDF text of a path (``lock`` fixes joints at zero), or the text itself; its ``<dynamics>`` are taken out."""
    own = str(robot_urdf)
    root = ET.fromstring(own if own.lstrip().startswith("<") else lock_joints(own, lock))
    for joint in root.findall("joint"):
        for entry in joint.findall("dynamics"):
            joint.remove(entry)
    return ET.tostring(root, encoding="unicode")


def robot_of(text: str) -> Robot:
    """The robot that the loop sees."""
    return Robot.from_text(text, "blind case")


class Engine:
    """A MuJoCo model of ``text`` (URDF) with the native ones among ``hidden``, in the robot's joint order."""

    def __init__(self, text: str, hidden: Sequence[Hidden] = ()) -> None:
        self.robot = robot_of(text)
        self._spec = _specification(text)
        self._joints = [self._spec.joint(name) for name in self.robot.joint_names]
        for joint in self._joints:
            joint.damping, joint.frictionloss = np.zeros(3), 0.0
            joint.limited = joint.actfrclimited = 0
        for cause in hidden:
            _check(cause)
            getattr(self, f"_{cause.kind}")(cause)
        self.model = self._spec.compile()
        self._dof = np.array([self.model.joint(name).dofadr[0] for name in self.robot.joint_names])
        self._qpos = np.array([self.model.joint(name).qposadr[0] for name in self.robot.joint_names])

    def torque(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Torque (T, n) [N m] that the motion (T, n) needs."""
        data = mujoco.MjData(self.model)
        out = np.empty_like(q)
        for k in range(len(q)):
            data.qpos[self._qpos], data.qvel[self._dof], data.qacc[self._dof] = q[k], dq[k], ddq[k]
            mujoco.mj_inverse(self.model, data)
            out[k] = data.qfrc_inverse[self._dof]
        return out

    def _body(self, cause: Hidden) -> Any:
        return self._joints[cause.at].parent

    def _damping(self, cause: Hidden) -> None:
        self._joints[cause.at].damping += np.array([cause.values.get(k, 0.0) for k in ("d0", "d1", "d2")])

    def _frictionloss(self, cause: Hidden) -> None:
        joint = self._joints[cause.at]
        joint.frictionloss += cause.values["torque"]
        joint.solref_friction = np.array(_EXACT)

    def _armature(self, cause: Hidden) -> None:
        self._joints[cause.at].armature += cause.values["armature"]

    def _stiffness(self, cause: Hidden) -> None:
        joint = self._joints[cause.at]
        joint.stiffness = np.array([cause.values.get("stiffness", 0.0), 0.0, cause.values.get("cubic", 0.0)])
        joint.springref = cause.values.get("rest", 0.0)

    def _mass(self, cause: Hidden) -> None:
        for body, _ in _rigid(self._body(cause)):
            body.mass *= cause.values["ratio"]
            body.inertia *= cause.values["ratio"]
            full = np.array(body.fullinertia)
            if np.isfinite(full).all():
                body.fullinertia = full * cause.values["ratio"]

    def _com(self, cause: Hidden) -> None:
        shift = np.array([cause.values.get(k, 0.0) for k in ("x", "y", "z")])
        for body, turned in _rigid(self._body(cause)):
            body.ipos += turned.T @ shift

    def _block(self, cause: Hidden) -> None:
        v = cause.values
        edges = np.array([v["edge_x"], v["edge_y"], v["edge_z"]]) ** 2
        child = self._body(cause).add_body(pos=[v["x"], v["y"], v["z"]])
        child.mass, child.inertia = v["mass"], v["mass"] * (edges.sum() - edges) / 12
        child.ipos, child.explicitinertial = np.zeros(3), True

    def _tilt(self, cause: Hidden) -> None:
        # R_base = Ry(pitch) Rx(roll): gravity seen from the base.
        r, p = cause.values["roll"], cause.values["pitch"]
        size = float(np.linalg.norm(self._spec.option.gravity))
        self._spec.option.gravity = size * np.array([np.sin(p), -np.sin(r) * np.cos(p), -np.cos(r) * np.cos(p)])

    def _tendon(self, cause: Hidden) -> None:
        tendon = self._spec.add_tendon(name=f"gear{cause.at}")
        for number in (cause.at, int(cause.values["partner"])):
            tendon.wrap_joint(self.robot.joint_names[number], 1.0)
        tendon.damping = np.array([cause.values.get("damping", 0.0), 0.0, 0.0])
        tendon.frictionloss, tendon.armature = cause.values.get("friction", 0.0), cause.values.get("armature", 0.0)
        tendon.solref_friction = np.array(_EXACT)


def _rigid(body: Any, turned: Array | None = None) -> Iterator[tuple[Any, Array]]:
    """``body`` and all that is fixed to it (a hand is part of the last link), with the rotation of each in it."""
    turned = np.eye(3) if turned is None else turned
    yield body, turned
    for child in body.bodies:
        if not child.joints:
            matrix = np.zeros(9)
            mujoco.mju_quat2Mat(matrix, np.array(child.quat))
            yield from _rigid(child, turned @ matrix.reshape(3, 3))


def _check(cause: Hidden) -> None:
    if cause.kind not in NATIVE:
        raise InputError(f"hidden cause {cause.kind!r} is none of MuJoCo's; those are {', '.join(NATIVE)}")
    if unknown := set(cause.values) - set(NATIVE[cause.kind]):
        raise InputError(
            f"hidden cause {cause.kind} has no number {', '.join(sorted(unknown))}; expected "
            f"{', '.join(NATIVE[cause.kind])}"
        )


def _specification(text: str) -> Any:
    """MuJoCo's reading of URDF text: bodies and joints alone, every number as it stands there."""
    root = ET.fromstring(text)
    for link in root.findall("link"):
        for tag in ("visual", "collision"):
            for entry in link.findall(tag):
                link.remove(entry)
    for entry in list(root):
        if entry.tag not in ("link", "joint"):
            root.remove(entry)
    section = ET.Element("mujoco")
    options = {"fusestatic": "true", "balanceinertia": "false", "boundmass": "0", "boundinertia": "0"}
    ET.SubElement(section, "compiler", options)
    root.insert(0, section)
    return mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
