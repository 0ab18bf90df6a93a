"""Inertial parameters of one body: dynamic parameters, mass/centre/inertia, pseudo-inertia.

Dynamic parameters (10,): mass, first moments x y z, inertia about the frame's origin xx xy yy xz yz zz (Pinocchio's
order). The pseudo-inertia (4, 4) is positive definite exactly for bodies that can exist (Wensing, Kim and Slotine,
RA-L 2018, eq. 9).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Effect, Family
from hybrid_dynamics.effects.state import Motion, Parameter
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

INERTIA_ENTRIES = ("xx", "xy", "yy", "xz", "yz", "zz")
BODY_PARAMETERS = (
    Parameter("mass", "kg"),
    Parameter("com_x", "m"),
    Parameter("com_y", "m"),
    Parameter("com_z", "m"),
    *(Parameter(f"inertia_{e}", "kg m^2") for e in INERTIA_ENTRIES),
)
#: Where data leaves a direction open, it is held near zero on these scales (kg, kg m, kg m^2).
BODY_SCALE = np.array([5.0, 1.0, 1.0, 1.0, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3])
#: A link lies within this many times the distance to the joints around it, or of the model's own matter.
ROOM = 1.5


def body_scale(own: Array) -> Array:
    """Plausible change (10,) of a link with dynamic parameters ``own`` (10,): half its mass, shifted by its own size.

    Links without inertia in the URDF are taken as 0.5 kg within 5 cm.
    """
    mass = max(float(own[0]), 0.5)
    reach = max(float(np.sqrt(_second_moment(own) / mass)), 0.05)
    return np.array([0.5 * mass, *[0.5 * mass * reach] * 3, *[0.5 * mass * reach**2] * 6])


def _skew(c: Array) -> Array:
    return np.array([[0.0, -c[2], c[1]], [c[2], 0.0, -c[0]], [-c[1], c[0], 0.0]])


def _symmetric(entries: Array) -> Array:
    xx, xy, yy, xz, yz, zz = entries
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _entries(matrix: Array) -> Array:
    return np.array([matrix[0, 0], matrix[0, 1], matrix[1, 1], matrix[0, 2], matrix[1, 2], matrix[2, 2]])


def to_body(dynamic: Array) -> dict[str, float]:
    """Mass, centre of mass and inertia about it, by the parallel-axis theorem."""
    mass = float(dynamic[0])
    safe = mass if abs(mass) > 1e-9 else 1e-9
    com = dynamic[1:4] / safe
    skew = _skew(com)
    inertia = _entries(_symmetric(dynamic[4:]) + safe * skew @ skew)
    values = [mass, *com, *inertia]
    return {p.name: float(v) for p, v in zip(BODY_PARAMETERS, values, strict=True)}


def to_dynamic(body: Mapping[str, float]) -> Array:
    """Inverse of :func:`to_body`."""
    mass = body["mass"]
    com = np.array([body["com_x"], body["com_y"], body["com_z"]])
    skew = _skew(com)
    inertia = _symmetric(np.array([body[f"inertia_{e}"] for e in INERTIA_ENTRIES])) - mass * skew @ skew
    return np.array([mass, *(mass * com), *_entries(inertia)])


def pseudo_inertia_basis() -> Array:
    """(10, 4, 4): the pseudo-inertia is the sum of dynamic parameters times these."""
    basis = np.zeros((10, 4, 4))
    basis[0, 3, 3] = 1.0
    for axis in range(3):
        basis[1 + axis, axis, 3] = basis[1 + axis, 3, axis] = 1.0
    for k in range(6):
        inertia = _symmetric(np.eye(6)[k])
        basis[4 + k, :3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    return basis


def pseudo_inertia(dynamic: Array) -> Array:
    """Pseudo-inertia (4, 4) of dynamic parameters (10,)."""
    return np.asarray(np.einsum("k,kij->ij", dynamic, pseudo_inertia_basis()))


def is_physical(dynamic: Array) -> bool:
    """True where a body with these parameters can exist."""
    return bool(np.linalg.eigvalsh(pseudo_inertia(dynamic))[0] > 0)


def link_parameters(robot: Robot, link: int) -> Array:
    """Dynamic parameters (10,) of the body that joint ``link`` (0-based) moves."""
    return np.asarray(robot.model.inertias[robot.joint_ids[link]].toDynamicParameters())


def links_with_mass(robot: Robot, moving: NDArray[np.bool_]) -> list[int]:
    """Links (0-based) that the model gives a mass and that some moving joint of ``moving`` (n,) carries."""
    return [j for j in range(robot.n_joints) if moving[: j + 1].any() and link_parameters(robot, j)[0] > 0]


def cannot_be(robot: Robot, change: Array) -> bool:
    """True where no body of ``robot`` differs from the model's by ``change`` (10,), nor carries it.

    No link is off by more than the whole robot weighs, and no arm holds that much in its hand: light ones carry half of
    their own mass. That mass with its centre as far away as the stretched robot reaches is the largest first moment.
    Where the model gives a link no mass nothing is known of the robot's, and everything can be.
    """
    bodies = [link_parameters(robot, k) for k in range(robot.n_joints)]
    masses = np.array([own[0] for own in bodies])
    if np.any(masses <= 0):
        return False
    spans = sum(float(np.linalg.norm(robot.model.jointPlacements[i].translation)) for i in robot.joint_ids)
    reach = spans + max(float(np.linalg.norm(own[1:4])) / float(own[0]) for own in bodies)
    mass = float(masses.sum())
    return bool(abs(change[0]) > mass or np.linalg.norm(change[1:4]) > mass * reach)


def radii(robot: Robot) -> Array:
    """Radius (n,) [m] of a ball about every joint that the link it moves lies in, with room to spare: :data:`ROOM`
    times the farthest of the joints before and behind it, of the model's own matter (its radius of gyration about the
    joint) and of a tenth of the arm; of half the arm for a last link, which may carry a tool.

    inf where nothing is known: of a slide and its rail, of a link that the model gives no mass, of an arm whose joints
    all share one origin.
    """
    model = robot.model
    number = {joint: k for k, joint in enumerate(robot.joint_ids)}
    steps = np.array([float(np.linalg.norm(model.jointPlacements[i].translation)) for i in robot.joint_ids])
    # The first joint's own placement is that of the base.
    before = np.where([model.parents[i] in number for i in robot.joint_ids], steps, 0.0)
    after, last = np.zeros(robot.n_joints), np.ones(robot.n_joints, bool)
    free = np.isin(robot.joint_names, robot.prismatic)
    for k, joint in enumerate(robot.joint_ids):
        if (parent := number.get(model.parents[joint])) is not None:
            after[parent], last[parent] = max(after[parent], steps[k]), False
            free[parent] |= robot.joint_names[k] in robot.prismatic
    gyration = np.array([_gyration(link_parameters(robot, k)) for k in range(robot.n_joints)])
    arm = float(before.sum() + gyration[last & np.isfinite(gyration)].max(initial=0.0))
    radius = ROOM * np.max([before, after, gyration, np.where(last, arm / 2, arm / 10)], axis=0)
    return np.where(free | (before.sum() == 0.0), np.inf, radius)


def _second_moment(dynamic: Array) -> float:
    """Second moment [kg m^2] of a body about its frame's origin, all axes together."""
    return max(float(dynamic[4] + dynamic[6] + dynamic[9]) / 2, 0.0)


def _gyration(dynamic: Array) -> float:
    """Radius of gyration [m] of a body about its frame's origin: all axes together; inf without mass."""
    return float(np.sqrt(_second_moment(dynamic) / dynamic[0])) if dynamic[0] > 0 else float("inf")


def in_ball(radius: float) -> Array:
    """(10,): this times dynamic parameters is at least zero for every body that lies within ``radius`` [m] of its
    frame's origin: mass times the radius' square less the second moment (Wensing, Kim and Slotine, RA-L 2018, sec. IV:
    the bounding ellipsoid, here a ball)."""
    row = np.zeros(10)
    row[0], row[[4, 6, 9]] = radius**2, -0.5
    return row


def random_block(rng: np.random.Generator) -> Array:
    """Dynamic parameters (10,) of a solid block of 1 kg within a hand's breadth, which any body may carry."""
    edge = rng.uniform(0.05, 0.2, 3)
    body = {"mass": 1.0, **dict(zip(("com_x", "com_y", "com_z"), rng.uniform(-0.12, 0.12, 3).tolist(), strict=True))}
    principal = (np.sum(edge**2) - edge**2) / 12
    body |= {f"inertia_{e}": float(v) for e, v in zip(INERTIA_ENTRIES, _entries(np.diag(principal)), strict=True)}
    return to_dynamic(body)


def torque_error(kind: Family, true: Effect, found: Effect, robot: Robot, motions: Sequence[Motion]) -> float:
    """Relative error of the torque that a change of inertia adds on ``motions``.

    Single inertial parameters of a link are not determined by torque, only base parameters are.
    """
    change = kind.coordinates_of(true.parameters, robot, true.term(robot))
    difference = kind.coordinates_of(found.parameters, robot, found.term(robot)) - change
    wrong = added = 0.0
    for motion in motions:
        columns = kind.columns(motion, true.term(robot))
        wrong += float(np.sum((columns @ difference) ** 2))
        added += float(np.sum((columns @ change) ** 2))
    return float(np.sqrt(wrong / added)) if added > 0 else float("nan")
