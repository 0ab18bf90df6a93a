"""A robot with n joints: rigid-body torques, regressor and forward dynamics, vectorised over samples.

All arrays are (T, n) in the robot's joint order (the order of the URDF file), SI units. Torque is what the drive
delivers, positive along the joint axis.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots.quiet import quiet_stderr
from hybrid_dynamics.robots.regressor import regressor_of_samples
from hybrid_dynamics.robots.urdf import Mimic, lock_joints, mimics, movable_joints, read_text
from hybrid_dynamics.types import Array

#: Moments of inertia may break the triangle inequality by this share: files are rounded.
ROUNDED = 0.02


@dataclass(frozen=True)
class RigidBodyTorques:
    """M(q)ddq, C(q,dq)dq and g(q), each (T, n) [N m]."""

    inertia: Array
    coriolis: Array
    gravity: Array

    @property
    def total(self) -> Array:
        """Inertia, Coriolis and gravity together (T, n) [N m]."""
        return self.inertia + self.coriolis + self.gravity


class Robot:
    """Rigid-body dynamics of a fixed-base arm.

    ``model`` is the Pinocchio model; a caller that changes it (armature, inertia, gravity) works on :meth:`copy`.

    >>> from hybrid_dynamics import Robot
    >>> robot = Robot.from_urdf("robot.urdf")
    >>> robot.joint_names
    ('shoulder', 'elbow')
    >>> still = [0.0, 0.0]
    >>> robot.inverse_dynamics([0.0, 0.0], still, still).round(2) + 0.0  # the arm stands upright
    array([[0., 0.]])
    """

    def __init__(
        self, model: pin.Model, joint_names: tuple[str, ...], name: str, mimics: tuple[Mimic, ...] = ()
    ) -> None:
        self.model = model
        self.joint_names = joint_names
        self.name = name
        #: Joints of the model that no drive moves; they follow one of ``joint_names`` and their torque is its.
        self.mimics = mimics
        ids = [model.getJointId(joint) for joint in joint_names]
        #: Pinocchio joint id of each joint, in the robot's order.
        self.joint_ids: tuple[int, ...] = tuple(ids)
        kinds = [model.joints[i].shortname() for i in ids]
        #: Joints that slide: their positions are [m], their torques forces [N].
        self.prismatic = tuple(j for j, kind in zip(joint_names, kinds, strict=True) if kind.startswith("JointModelP"))
        self._v = np.array([model.idx_vs[i] for i in ids])
        self._q = np.array([model.idx_qs[i] for i in ids])
        self._unbounded = np.array([model.nqs[i] == 2 for i in ids])
        self._followers = [(joint_names.index(m.leader), model.getJointId(m.joint), m) for m in mimics]

    @classmethod
    def from_urdf(cls, path: str | os.PathLike[str], lock: tuple[str, ...] = ()) -> Robot:
        """Read a URDF; ``lock`` fixes joints at zero. Raises :class:`InputError` naming what is wrong with the file."""
        return cls.from_text(lock_joints(path, lock), str(path))

    @classmethod
    def from_text(cls, text: str, origin: str) -> Robot:
        """Read URDF text; ``origin`` names it in errors. Raises :class:`InputError` as :meth:`from_urdf` does: what has
        no number, or cannot exist, would be a robot of other masses without a word."""
        root = read_text(text, origin)
        try:
            # The parser writes lines of its own to the process' error stream.
            with quiet_stderr():
                model = pin.buildModelFromXML(text)
        except (ValueError, RuntimeError) as error:
            raise InputError(f"{origin}: Pinocchio cannot build a model from it ({error})") from None
        _check_bodies(model, root, origin)
        names = tuple(movable_joints(root))
        return cls(model, names, root.get("name") or Path(origin).stem, tuple(mimics(root, origin)))

    def demand_no_mimics(self, what: str) -> None:
        """Raise :class:`InputError` where joints follow others; ``what`` cannot describe that."""
        if self.mimics:
            raise InputError(
                f"robot {self.name}: joint {self.mimics[0].joint} mimics {self.mimics[0].leader}, which {what} cannot "
                f"describe; lock it (--lock {self.mimics[0].joint}) or take it off"
            )

    @property
    def n_joints(self) -> int:
        """Number of movable joints."""
        return len(self.joint_names)

    @property
    def position_limits(self) -> tuple[Array, Array]:
        """Lower and upper joint limits (n,) [rad]; infinite for continuous joints."""
        low, high = np.full(self.n_joints, -np.inf), np.full(self.n_joints, np.inf)
        bounded = ~self._unbounded
        low[bounded] = self.model.lowerPositionLimit[self._q[bounded]]
        high[bounded] = self.model.upperPositionLimit[self._q[bounded]]
        return low, high

    @property
    def velocity_limits(self) -> Array:
        """(n,) [rad/s]."""
        return np.asarray(np.asarray(self.model.upperVelocityLimit)[self._v].copy())

    @property
    def effort_limits(self) -> Array:
        """(n,) [N m], the rated torque."""
        return np.asarray(np.asarray(self.model.upperEffortLimit)[self._v].copy())

    def copy(self) -> Robot:
        """An independent robot whose ``model`` may be changed."""
        return Robot(self.model.copy(), self.joint_names, self.name, self.mimics)

    def _configuration(self, q: Array) -> Array:
        """Pinocchio's (nq, T) configuration of joint angles (T, n); continuous joints become cosine and sine."""
        # One sample after the other, as Pinocchio keeps them: rows of joints cost it a third more.
        out = np.zeros((self.model.nq, len(q)), order="F")
        plain = ~self._unbounded
        out[self._q[plain]] = q[:, plain].T
        for j in np.flatnonzero(self._unbounded):
            out[self._q[j]], out[self._q[j] + 1] = np.cos(q[:, j]), np.sin(q[:, j])
        for leader, i, m in self._followers:
            angle, row = m.multiplier * q[:, leader] + m.offset, self.model.idx_qs[i]
            if self.model.nqs[i] == 2:
                out[row], out[row + 1] = np.cos(angle), np.sin(angle)
            else:
                out[row] = angle
        return out

    def _tangent(self, values: Array) -> Array:
        out = np.zeros((self.model.nv, len(values)), order="F")
        out[self._v] = values.T
        for leader, i, m in self._followers:
            out[self.model.idx_vs[i]] = m.multiplier * values[:, leader]
        return out

    def _per_joint(self, values: Array) -> Array:
        """Torque (T, n) of the driven joints; by virtual work a follower's is its leader's, times the multiplier."""
        # Pinocchio returns a flat array for one sample or one joint.
        full = np.asarray(values).reshape(self.model.nv, -1)
        out = full[self._v].T.copy()
        for leader, i, m in self._followers:
            out[:, leader] += m.multiplier * full[self.model.idx_vs[i]]
        return np.asarray(out)

    def _check(self, *arrays: Array) -> tuple[Array, ...]:
        out = tuple(np.atleast_2d(np.asarray(a, float)) for a in arrays)
        for a in out:
            if a.shape[1] != self.n_joints:
                raise InputError(f"robot {self.name} has {self.n_joints} joints; the data has {a.shape[1]}")
        return out

    def inverse_dynamics(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Rigid-body torque (T, n) [N m] by the recursive Newton-Euler algorithm (armature included)."""
        q, dq, ddq = self._check(q, dq, ddq)
        pool = pin.ModelPool(self.model, 1)
        torque = pin.rneaInParallel(1, pool, self._configuration(q), self._tangent(dq), self._tangent(ddq))
        return self._per_joint(torque)

    def rigid_body_torques(self, q: Array, dq: Array, ddq: Array) -> RigidBodyTorques:
        """Split the rigid-body torque into M(q)ddq, C(q,dq)dq and g(q) by three Newton-Euler passes."""
        q, dq, ddq = self._check(q, dq, ddq)
        zero = np.zeros_like(q)
        gravity = self.inverse_dynamics(q, zero, zero)
        coriolis = self.inverse_dynamics(q, dq, zero) - gravity
        inertia = self.inverse_dynamics(q, zero, ddq) - gravity
        return RigidBodyTorques(inertia, coriolis, gravity)

    def forward_dynamics(self, q: Array, dq: Array, tau: Array) -> Array:
        """Acceleration (T, n) [rad/s^2] under joint torque ``tau``, by the articulated-body algorithm."""
        q, dq, tau = self._check(q, dq, tau)
        if self.mimics:
            return self._constrained_acceleration(q, dq, tau)
        pool = pin.ModelPool(self.model, 1)
        ddq = pin.abaInParallel(1, pool, self._configuration(q), self._tangent(dq), self._tangent(tau))
        return self._per_joint(ddq)

    def _constrained_acceleration(self, q: Array, dq: Array, tau: Array) -> Array:
        """The same where joints follow others: the mass matrix column by column, by inverse dynamics."""
        zero = np.zeros_like(q)
        gravity, bias = self.inverse_dynamics(q, zero, zero), self.inverse_dynamics(q, dq, zero)
        unit = np.eye(self.n_joints)
        columns = [self.inverse_dynamics(q, zero, np.broadcast_to(e, q.shape)) - gravity for e in unit]
        return np.asarray(np.linalg.solve(np.stack(columns, axis=2), (tau - bias)[:, :, None])[:, :, 0])

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Inertial regressor Y (T, n, 10 n) with Y pi = rigid-body torque without armature [N m].

        ``pi`` stacks, per moving body in joint order, Pinocchio's ten parameters: mass, first moments (3), inertia
        about the joint frame's origin xx xy yy xz yz zz (see :attr:`inertial_parameters`). Bodies that follow (mimic)
        are none of them: their part of the torque is known from the description and left out.
        """
        q, dq, ddq = self._check(q, dq, ddq)
        followers = {i for _, i, _ in self._followers}
        for joint, i in zip(self.joint_names, self.joint_ids, strict=True):
            while i and self.model.parents[i] not in followers:
                i = self.model.parents[i]
            if i:
                raise InputError(
                    f"robot {self.name}: joint {joint} is carried by a joint that mimics another; such linkages have "
                    "no inertial regressor here: describe the arm as a chain of driven joints"
                )
        return regressor_of_samples(self.model, self.joint_ids, q, dq, ddq)

    @property
    def inertial_parameters(self) -> Array:
        """(10 n,) the parameters that :meth:`regressor` multiplies."""
        return np.concatenate([self.model.inertias[i].toDynamicParameters() for i in self.joint_ids])

    @property
    def parameters_as_bytes(self) -> bytes:
        """What :meth:`inverse_dynamics` depends on beside the motion and the places of the joints, as bytes."""
        model = self.model
        bodies = [inertia.toDynamicParameters() for inertia in model.inertias]
        return np.concatenate([*bodies, model.armature, model.gravity.vector]).tobytes()


def _check_bodies(model: pin.Model, root: ET.Element, origin: str) -> None:
    """Raise :class:`InputError` where a moving body, with all that is fixed to it, cannot exist."""
    ends = {joint.get("name"): joint.find("child") for joint in root.findall("joint")}
    for i in range(1, model.njoints):
        if model.inertias[i].mass <= 0:
            continue
        low, middle, high = np.linalg.eigvalsh(np.asarray(model.inertias[i].inertia))
        # Point masses have moments of zero.
        if low + middle < high * (1 - ROUNDED) - 1e-9 or low < -1e-9 - ROUNDED * high:
            child = ends.get(model.names[i])
            link = model.names[i] if child is None else child.get("link", "")
            raise InputError(
                f"{origin}: link {link}, with what is fixed to it, has principal moments of inertia {low:.4g}, "
                f"{middle:.4g}, {high:.4g} kg m^2: no body has them (two of them are at least the third); correct its "
                f"<inertia>{_that_can_be(root, link, np.asarray(model.inertias[i].inertia))}"
            )


def _that_can_be(root: ET.Element, link: str, whole: Array) -> str:
    """An <inertia> of ``link``, for a message, with which its body (inertia ``whole`` (3, 3) [kg m^2] in the link's
    frame) can exist: where the mass would have a spread below zero along a principal axis, it has none."""
    own = next((element.find("inertial") for element in root.findall("link") if element.get("name") == link), None)
    inertia = None if own is None else own.find("inertia")
    if own is None or inertia is None:
        return ""
    # Moments about two axes are sums of the spreads (second moments of the mass) along the other two.
    moments, axes = np.linalg.eigh(whole)
    spreads = np.maximum(moments.sum() / 2 - moments, 0.0)
    lacking = axes @ np.diag(spreads.sum() - spreads - moments) @ axes.T
    place = own.find("origin")
    given = "0 0 0" if place is None else place.get("rpy", "0 0 0")
    turned = pin.rpy.rpyToMatrix(np.array([float(angle) for angle in given.split()]))
    change = turned.T @ lacking @ turned
    entries = {f"i{a}{b}": ("xyz".index(a), "xyz".index(b)) for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")}
    words = (f'{key}="{float(inertia.get(key, "0")) + change[at]:.4g}"' for key, at in entries.items())
    return f", for instance to {' '.join(words)}"
