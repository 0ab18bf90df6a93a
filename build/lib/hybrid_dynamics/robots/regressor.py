"""The inertial regressor of many samples at once: Newton-Euler in spatial vectors, one pass down the tree.

Pinocchio computes the regressor of one sample at a time; called from Python its arguments are converted and its result
is copied for each. Here every step is one call for all samples of a block. Notation and equations: R. Featherstone,
Rigid Body Dynamics Algorithms (2008), chapters 2 and 5; spatial vectors hold the linear part first, as Pinocchio's do.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from hybrid_dynamics.types import Array

#: Samples a block: the intermediate arrays stay in the processor's cache and calls still cost little.
BLOCK = 512
#: Products of angular velocity that the regressor is linear in.
PRODUCTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def regressor_of_samples(model: pin.Model, joint_ids: tuple[int, ...], q: Array, dq: Array, ddq: Array) -> Array:
    """(T, n, 10 n) regressor of joint angles, velocities and accelerations (T, n), in the order of ``joint_ids``.

    Each joint has one degree of freedom and an axis that is constant in its frame (revolute, continuous, prismatic).
    """
    n = len(joint_ids)
    tree = _Tree(model, joint_ids)
    out = np.zeros((len(q), n, 10 * n))
    work = _Workspace(tree, min(BLOCK, len(q)))
    for start in range(0, len(q), BLOCK):
        block = slice(start, min(start + BLOCK, len(q)))
        if block.stop - start != len(work.basis):
            work = _Workspace(tree, block.stop - start)
        _fill(out[block], tree, work, q[block], dq[block], ddq[block])
    return out


class _Tree:
    """What does not depend on the motion: axes, placements, and which joints carry which."""

    def __init__(self, model: pin.Model, joint_ids: tuple[int, ...]) -> None:
        data = model.createData()
        pin.forwardKinematics(model, data, pin.neutral(model), np.zeros(model.nv))
        column = {joint: k for k, joint in enumerate(joint_ids)}
        self.order = sorted(range(len(joint_ids)), key=lambda k: joint_ids[k])  # parents come first
        self.parent = [column.get(model.parents[i]) for i in joint_ids]
        self.axis = [np.asarray(data.joints[i].S).reshape(6) for i in joint_ids]
        self.turns = np.array([bool(s[3:].any()) for s in self.axis])
        # A motion vector x of the parent is x @ transform in the child, transform = [1, sin q, 1 - cos q] @ these rows.
        self.to_child = [_transforms(model.jointPlacements[i], s) for i, s in zip(joint_ids, self.axis, strict=True)]
        self.cross_axis = [-_cross_motion(s) for s in self.axis]  # v x S = -S x v
        self.carriers: dict[int | None, list[int]] = {None: []}
        for k in self.order:
            self.carriers[k] = [*self.carriers[self.parent[k]], k]
        self.gravity = np.asarray(model.gravity.vector)


class _Workspace:
    """Arrays of one block of m samples, allocated once: fresh memory costs more than the arithmetic in it."""

    def __init__(self, tree: _Tree, m: int) -> None:
        self.base = np.zeros((m, 2, 6))
        self.base[:, 1] = -tree.gravity  # a base accelerated upwards feels gravity
        # Per body, in its own frame: velocity, acceleration, the axes of the joints that carry it.
        self.rows = [np.empty((m, 2 + len(tree.carriers[k]), 6)) for k in range(len(tree.order))]
        self.basis = np.ones((m, 3))
        self.transform = np.empty((m, 36))
        self.terms = np.empty((6 + len(PRODUCTS), m))
        self.wrench = np.empty((m, 60))


def _fill(out: Array, tree: _Tree, work: _Workspace, q: Array, dq: Array, ddq: Array) -> None:
    """Write the regressor of one block into ``out`` (m, n, 10 n), which is zero elsewhere."""
    m = len(q)
    first = np.ascontiguousarray(np.where(tree.turns, np.sin(q), q).T)
    second = np.ascontiguousarray(np.where(tree.turns, 1.0 - np.cos(q), 0.0).T)
    dq, ddq = np.ascontiguousarray(dq.T), np.ascontiguousarray(ddq.T)
    for k in tree.order:
        parent, rows, axis = tree.parent[k], work.rows[k], tree.axis[k]
        work.basis[:, 1], work.basis[:, 2] = first[k], second[k]
        np.matmul(work.basis, tree.to_child[k], out=work.transform)
        above = work.base if parent is None else work.rows[parent]
        np.matmul(above, work.transform.reshape(m, 6, 6), out=rows[:, :-1])
        rows[:, -1] = axis
        # v = X v_parent + S dq, a = X a_parent + S ddq + v x S dq (Featherstone, eq. 5.14-5.15), by component
        motion = rows[:, :2].reshape(m, 12).T.copy()
        velocity, acceleration = motion[:6], motion[6:]
        acceleration += (tree.cross_axis[k] @ velocity) * dq[k]
        for c in np.flatnonzero(axis):
            velocity[c] += axis[c] * dq[k]
            acceleration[c] += axis[c] * ddq[k]
        rows[:, :2] = motion.T.reshape(m, 2, 6)
        _body_terms(velocity, acceleration, out=work.terms)
        np.matmul(work.terms.T, BODY_REGRESSOR, out=work.wrench)
        wrench, columns, carriers = work.wrench.reshape(m, 6, 10), slice(10 * k, 10 * k + 10), tree.carriers[k]
        if carriers == list(range(len(carriers))):  # an arm: written in place
            np.matmul(rows[:, 2:], wrench, out=out[:, : len(carriers), columns])
        else:
            out[:, carriers, columns] = rows[:, 2:] @ wrench


def _body_terms(velocity: Array, acceleration: Array, out: Array) -> None:
    """(12, m) acceleration of the body's origin, angular acceleration, products of the angular velocity."""
    vx, vy, vz, x, y, z = velocity
    out[:6] = acceleration
    # The spatial acceleration leaves out how the origin's velocity turns with the body: a = a_spatial + omega x v.
    out[0] += y * vz - z * vy
    out[1] += z * vx - x * vz
    out[2] += x * vy - y * vx
    for row, (i, j) in enumerate(PRODUCTS, start=6):
        np.multiply(velocity[3 + i], velocity[3 + j], out=out[row])


def _skew(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _cross_motion(s: Array) -> Array:
    """(6, 6) matrix of ``s x`` on motion vectors."""
    return np.block([[_skew(s[3:]), _skew(s[:3])], [np.zeros((3, 3)), _skew(s[3:])]])


def _transforms(placement: pin.SE3, axis: Array) -> Array:
    """(3, 36) transposed motion transforms from the parent: the constant, the first and the second order of the joint.

    exp(-q s x) = 1 - sin(q) (s x) + (1 - cos q) (s x)^2 for a rotation, 1 - q (s x) for a slide.
    """
    first = -_cross_motion(axis)
    placed = np.asarray(placement.inverse().action)
    return np.array([(step @ placed).T.reshape(36) for step in (np.eye(6), first, first @ first)])


def _body_regressor() -> Array:
    """(12, 60) map from the terms of :func:`_body_terms` to a body's regressor: a wrench (6, 10) per parameter.

    ``f = m a + alpha x h + omega x (omega x h)``, ``n = h x a + I alpha + omega x I omega`` about the frame's origin,
    parameters in Pinocchio's order: mass, first moments (3), inertia xx xy yy xz yz zz.
    """
    out = np.zeros((12, 6, 10))
    eye = np.eye(3)
    inertia = [np.zeros((3, 3)) for _ in range(6)]
    for unit, (i, j) in zip(inertia, ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)), strict=True):
        unit[i, j] = unit[j, i] = 1.0
    for c in range(3):
        out[c, c, 0] = 1.0
        out[c, 3:, 1:4] = -_skew(eye[c])
        out[3 + c, :3, 1:4] = _skew(eye[c])
        out[3 + c, 3:, 4:] = np.array([unit[:, c] for unit in inertia]).T
    for row, (i, j) in enumerate(PRODUCTS, start=6):
        for left, right in {(i, j), (j, i)}:
            out[row, :3, 1:4] += _skew(eye[left]) @ _skew(eye[right])
            out[row, 3:, 4:] += np.array([_skew(eye[left]) @ unit[:, right] for unit in inertia]).T
    return out.reshape(12, 60)


BODY_REGRESSOR = _body_regressor()
