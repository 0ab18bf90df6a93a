"""The rigid body as CasADi expressions: recursive Newton-Euler over symbols (Featherstone 2008, table 5.1).

Written out here rather than taken from a library: those that build CasADi dynamics read a URDF themselves (and refuse
what Pinocchio reads: a joint without <origin>, say) and add M(q) ddq to the bias, twice the operations. This one takes
its numbers from the Pinocchio model that the rest of the project computes with, so both agree to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as cs
import numpy as np
import pinocchio as pin

from hybrid_dynamics.export.body import BodyNumbers, joint_axis
from hybrid_dynamics.robots import Robot

#: Entries of a rotation or an axis this close to a whole number are rounding (cos of pi/2, say), not geometry.
ROUNDING = 1e-15


def symbols(n: int) -> tuple[BodyNumbers, cs.SX]:
    """Symbols in the place of all numbers, and all of them in one column in the order of :meth:`BodyNumbers.flat`."""
    body = BodyNumbers(cs.SX.sym("pi", n, 10), cs.SX.sym("armature", n), cs.SX.sym("gravity", 3))
    return body, cs.vertcat(cs.reshape(body.inertias.T, -1, 1), body.armature, body.gravity)


def inverse_dynamics(robot: Robot, body: BodyNumbers, q: cs.SX, dq: cs.SX, ddq: cs.SX) -> cs.SX:
    """Drive torque (n,) [N m] of the rigid body at ``q dq ddq`` (n,); kinematics of ``robot``, the rest from ``body``.

    Spatial vectors hold the linear part first, as Pinocchio's.
    """
    model = robot.model
    joints = _joints(robot, body, q, dq, ddq)
    linear, angular = [cs.SX(3, 1)], [cs.SX(3, 1)]
    acceleration, turning = [-_exact(body.gravity)], [cs.SX(3, 1)]
    force: list[Any] = [None]
    moment: list[Any] = [None]
    places: list[Any] = [None]
    for joint in range(1, model.njoints):
        own, parent = joints[joint], model.parents[joint]
        axis, slides = _axis(model, joint)
        rotation, position = _placement(model, joint, axis, slides, own.q)
        back = rotation.T
        shift, spin = (axis * own.dq, cs.SX(3, 1)) if slides else (cs.SX(3, 1), axis * own.dq)
        push, twist = (axis * own.ddq, cs.SX(3, 1)) if slides else (cs.SX(3, 1), axis * own.ddq)
        v = back @ (linear[parent] + cs.cross(angular[parent], position)) + shift
        w = back @ angular[parent] + spin
        a = back @ (acceleration[parent] + cs.cross(turning[parent], position)) + push
        a += cs.cross(w, shift) + cs.cross(v, spin)
        b = back @ turning[parent] + twist + cs.cross(w, spin)
        mass, first, inertia = _inertia(own.inertia)
        momentum = mass * v + cs.cross(w, first)
        spin_momentum = inertia @ w + cs.cross(first, v)
        force.append(mass * a + cs.cross(b, first) + cs.cross(w, momentum))
        moment.append(inertia @ b + cs.cross(first, a) + cs.cross(w, spin_momentum) + cs.cross(v, momentum))
        linear.append(v)
        angular.append(w)
        acceleration.append(a)
        turning.append(b)
        places.append((rotation, position, axis, slides, parent))
    torque = [cs.SX(1, 1) for _ in robot.joint_names]
    for joint in range(model.njoints - 1, 0, -1):
        rotation, position, axis, slides, parent = places[joint]
        own = joints[joint]
        # By virtual work the torque of a joint that follows is its leader's, times the multiplier.
        drive = axis.T @ (force[joint] if slides else moment[joint]) + own.armature * own.ddq
        torque[own.drive] += own.multiplier * drive
        if parent:
            carried = rotation @ force[joint]
            force[parent] += carried
            moment[parent] += rotation @ moment[joint] + cs.cross(position, carried)
    return cs.densify(cs.vertcat(*torque))


@dataclass(frozen=True)
class _Joint:
    """State and numbers of one joint of the Pinocchio model; drive ``drive`` moves it, ``multiplier`` times as far."""

    q: cs.SX
    dq: cs.SX
    ddq: cs.SX
    inertia: Any
    armature: Any
    drive: int
    multiplier: float = 1.0


def _joints(robot: Robot, body: BodyNumbers, q: cs.SX, dq: cs.SX, ddq: cs.SX) -> dict[int, _Joint]:
    """All joints by Pinocchio's number: those that drives move, and those that follow one of them."""
    model = robot.model
    out = {
        joint: _Joint(q[k], dq[k], ddq[k], body.inertias[k, :], body.armature[k], k)
        for k, joint in enumerate(robot.joint_ids)
    }
    for mimic in robot.mimics:
        k, joint, m = robot.joint_names.index(mimic.leader), model.getJointId(mimic.joint), mimic.multiplier
        inertia = np.asarray(model.inertias[joint].toDynamicParameters())
        rotor = float(model.armature[model.idx_vs[joint]])
        out[joint] = _Joint(m * q[k] + mimic.offset, m * dq[k], m * ddq[k], inertia, rotor, k, m)
    return out


def _exact(values: Any) -> cs.SX:
    """Constants as a sparse column or matrix, rounding removed: what is zero costs no operation."""
    if isinstance(values, cs.SX):
        return values
    nearest = np.round(values)
    return cs.sparsify(cs.SX(np.where(np.abs(values - nearest) < ROUNDING, nearest, values)))


def _axis(model: pin.Model, joint: int) -> tuple[cs.SX, bool]:
    """Axis (3,) of a joint in its own frame, and whether it slides along it."""
    subspace = joint_axis(model, joint)
    slides = bool(subspace[:3].any())
    return _exact(subspace[:3] if slides else subspace[3:]), slides


def _placement(model: pin.Model, joint: int, axis: cs.SX, slides: bool, q: cs.SX) -> tuple[cs.SX, cs.SX]:
    """Rotation (3, 3) and position (3,) of the joint's frame in its parent's, at joint position ``q``."""
    fixed = _exact(model.jointPlacements[joint].rotation)
    position = _exact(model.jointPlacements[joint].translation)
    if slides:
        return fixed, position + fixed @ axis * q
    along = axis @ axis.T
    turned = cs.cos(q) * cs.sparsify(cs.SX.eye(3) - along) + cs.sin(q) * cs.skew(axis) + along  # Rodrigues
    return fixed @ turned, position


def _inertia(dynamic: Any) -> tuple[Any, cs.SX, cs.SX]:
    """Mass, first moments (3,) and inertia about the frame's origin (3, 3) of ten dynamic parameters."""
    m, x, y, z, xx, xy, yy, xz, yz, zz = (dynamic[k] for k in range(10))
    matrix = cs.vertcat(cs.horzcat(xx, xy, xz), cs.horzcat(xy, yy, yz), cs.horzcat(xz, yz, zz))
    return m, cs.sparsify(cs.SX(cs.vertcat(x, y, z))), cs.sparsify(cs.SX(matrix))
