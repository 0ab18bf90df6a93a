"""Does a spring or a body explain what looks like a sign turned round, or a coupling what looks like columns exchanged?

A strong spring on a joint, a counterbalance say, pulls against gravity: torque or position turned round then leave
little, and the log is right as it is. Friction tells: of a torque that is turned round it would drive the joint. Where
a gear lets the torque of one joint follow the motion of another, as in many wrists, the first seems to be the other's.
A tool on the other side of a light wrist turns the wrist's torque round; no link turns that of a shoulder round.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import lsq_linear

from hybrid_dynamics.check.columns import Columns
from hybrid_dynamics.effects.inertia import body_scale, link_parameters
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: Powers of the position that a spring's torque is made of.
POWERS = (1, 2, 3)
#: Friction that drives speaks where it makes this share of the torque's mean square.
SPEAKS = 0.01
#: Gains of a joint's torque beside a tool.
GAINS = (0.3, 3.0)
#: Between these multiples of its description a coupled joint's own rigid-body torque must be.
AS_DESCRIBED = (0.5, 2.0)
#: Plausible changes (half a link's mass, shifted by its own size) within which links may weigh otherwise, and the rows
#: that are asked, about.
OTHERWISE, ROWS = 3.0, 2000
#: A column smaller than this share of the largest is rounding.
ROUNDING = 1e-10


def coupling_leaves(columns: Columns, gravity: Array, j: int, k: int) -> float:
    """Share of the mean square of the torque of joint ``j`` that is left with friction and inertia of joint ``k`` in
    it, too; 1 where that is no coupling: the rigid robot as it is described, under ``gravity`` (3,) [m/s^2], would not
    be in it any more (:data:`AS_DESCRIBED`)."""
    torque = columns.tau[:, j] - columns.tau[:, j].mean()
    power = float(torque @ torque)
    if power <= 0:
        return 1.0
    together = np.sign(columns.dq[:, j] + columns.dq[:, k])
    table = np.column_stack([columns.model(j, gravity), columns.free(j)[:, :3], columns.free(k)[:, :3], together])
    low, high = np.full(table.shape[1], -np.inf), np.full(table.shape[1], np.inf)
    low[:4] = 0.0
    x, _, left = _bounded(table, torque, low, high)
    return left / power if AS_DESCRIBED[0] <= x[0] <= AS_DESCRIBED[1] else 1.0


def spring_leaves(
    columns: Columns, q: Array, gravity: Array, j: int, scale: tuple[float, float] = (0.0, np.inf)
) -> float:
    """Share of the mean square of the torque of joint ``j`` that the robot as it is described, under ``gravity`` (3,)
    [m/s^2], leaves with a spring at that joint, positions ``q`` (K,) [rad]; 1 where friction would drive the joint.

    ``scale``: between which multiples of the description the links may be.
    """
    torque = columns.tau[:, j] - columns.tau[:, j].mean()
    power = float(torque @ torque)
    if power <= 0:
        return 1.0
    middle = 0.5 * (q.max() + q.min())
    reach = max(float(np.ptp(q)) / 2, 1e-9)
    spring = [((q - middle) / reach) ** k for k in POWERS]
    table = np.column_stack(
        [
            columns.model(j, gravity),
            columns.ddq[:, j],
            columns.dq[:, j],
            columns.sign[:, j],
            *spring,
        ]
    )
    low, high = np.full(table.shape[1], -np.inf), np.full(table.shape[1], np.inf)
    low[:2], high[0] = (scale[0], 0.0), scale[1]  # the links, and a rotor
    x, table, left = _bounded(table, torque, low, high)
    friction = table[:, 2:4] @ x[2:4]
    drives = float(friction @ columns.dq[:, j]) < 0
    if drives and float(friction @ friction) > SPEAKS * power:
        return 1.0
    return left / power


def body_leaves(robot: Robot, q: Array, columns: Columns, gravity: Array, j: int) -> float:
    """Share of the mean square of the torque of joint ``j`` that is left where one of the links that it carries weighs
    otherwise than ``robot`` says, within :data:`OTHERWISE` of what is plausible; positions ``q`` (K, n) [rad].

    One link alone: many that are off together could be an arm turned round.
    """
    rows = slice(None, None, max(len(q) // ROWS, 1))
    standing = robot.copy()
    standing.model.gravity.linear = gravity
    torque = (columns.tau[:, j] - columns.model(j, gravity))[rows]
    power = float(np.var(columns.tau[rows, j])) * len(torque)
    if power <= 0:
        return 1.0
    torque -= torque.mean()
    regressor = standing.regressor(q[rows], columns.dq[rows], columns.ddq[rows])[:, j]
    least = np.inf
    for k in range(j, robot.n_joints):
        most = OTHERWISE * body_scale(link_parameters(robot, k))
        table = np.column_stack([columns.free(j)[rows, :3], regressor[:, 10 * k : 10 * k + 10]])
        low, high = np.concatenate([np.zeros(3), -most]), np.concatenate([np.full(3, np.inf), most])
        least = min(least, _bounded(table, torque, low, high)[2])
    return least / power


def tool_leaves(robot: Robot, q: Array, columns: Columns, gravity: Array, joints: Sequence[int]) -> Array:
    """Shares (m,) of the mean squares of the torques of m ``joints`` that are left with one tool of any weight on the
    last link, the links as described up to a gain (:data:`GAINS`); positions ``q`` (K, n) [rad]."""
    rows = slice(None, None, max(len(q) // ROWS, 1))
    standing = robot.copy()
    standing.model.gravity.linear = gravity
    regressor = standing.regressor(q[rows], columns.dq[rows], columns.ddq[rows])[:, :, -10:]
    torque, tables = [], []
    for place, j in enumerate(joints):
        tau = columns.tau[rows, j]
        size = float(tau.std()) or 1.0
        own = np.zeros((len(tau), 4 * len(joints)))
        own[:, 4 * place : 4 * place + 4] = np.column_stack(
            [columns.model(j, gravity)[rows], columns.free(j)[rows, :3]]
        )
        table = np.column_stack([own, regressor[:, j]])
        # Of every joint as a share of its own torque.
        tables.append((table - table.mean(axis=0)) / size)
        torque.append((tau - tau.mean()) / size)
    low = np.concatenate([np.tile([GAINS[0], 0.0, 0.0, 0.0], len(joints)), [0.0], np.full(9, -np.inf)])
    high = np.concatenate([np.tile([GAINS[1], np.inf, np.inf, np.inf], len(joints)), np.full(10, np.inf)])
    x, _, _ = _bounded(np.concatenate(tables), np.concatenate(torque), low, high)
    return np.array([float(np.mean((t - own @ x) ** 2)) for t, own in zip(torque, tables, strict=True)])


def _bounded(table: Array, torque: Array, low: Array, high: Array) -> tuple[Array, Array, float]:
    """Least squares of ``torque`` (K,), without a mean, by columns ``table`` (K, p) less their means, coefficients
    between ``low`` and ``high`` (p,): these, the columns, and the sum of squares that is left."""
    table = table - table.mean(axis=0)
    size = np.linalg.norm(table, axis=0)
    # A column of rounding, of a body that acts through no motion here, is nothing; scaled to one it would fit noise.
    nothing = size <= ROUNDING * size.max(initial=0.0)
    table[:, nothing], size[nothing] = 0.0, 1.0
    # Columns alike leave directions open: there an interior method ends anywhere, an active set at the optimum.
    r = np.asarray(np.linalg.qr(np.column_stack([table / size, torque]), mode="r"))
    x = lsq_linear(r[:, :-1], r[:, -1], (low * size, high * size), method="bvls").x / size
    left = torque - table @ x
    return x, table, float(left @ left)
