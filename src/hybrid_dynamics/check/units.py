"""In which unit is the torque? All joints in another one, or each joint in its own, as motor currents are.

A unit for all is told by how many times the model's torque is measured. Where every joint has its own - a motor current
is its joint's torque over torque constant and gear ratio - each factor alone may look like links that are lighter or
heavier than the URDF says. What tells them is that the same links load several joints: no links at all, whatever they
weigh and wherever their centres of mass are, make such torques together.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import pinvh

from hybrid_dynamics.check.columns import Columns
from hybrid_dynamics.check.findings import Finding
from hybrid_dynamics.check.forms import Fit, Forms
from hybrid_dynamics.check.guess import EXPLAINED
from hybrid_dynamics.check.samples import Stretch
from hybrid_dynamics.effects.sign import presliding_sign
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: A torque that is this many times too large or small against the model is in another unit.
MAX_SCALE = 8.0
#: Joints whose modelled torque reaches this share of the largest have a say about the unit.
STRONG = 0.15
#: Units by the power of ten a torque in them is too large.
_UNITS: dict[int, tuple[str, dict[str, Any]]] = {
    3: ("N mm", {"units": {"tau": "Nmm"}}),
    2: ("N cm", {"gain": {"tau": [0.01]}}),
    -3: ("kN m", {"units": {"tau": "kNm"}}),
}
#: What brings a torque to N m, as the findings say it.
CURE = (
    "a motor current needs torque constant times gear ratio (torque_constant in a log.yaml), a torque on the motor's "
    "side the gear ratio (motor_side, gear_ratio)"
)
#: A joint has a say about units of their own where links leave, with a factor of its own, less than the first share of
#: what friction and the like leave of its torque (mean square), and where that is more than the second of all (rms);
#: and where the links as described leave less than :data:`EXPLAINED` of it, or the first share where it alone is off,
#: or any links less than :data:`LEFT`. (In small motion links and a factor make much of a wrist's friction that turns
#: over along the way.)
SETTLED, SAYS = 0.2, 0.1
#: Links of one unit fail where they leave more than this share of a joint's: less is what links and the like, which are
#: never quite as the loop may make them, leave.
FAILS = 0.1
#: In one unit links leave this share more of a joint's, and of all of them so many times what they do with a factor a
#: joint, which is at least the third. Of 400 simulated logs of one unit, with all the catalogue hidden in them, none
#: with factors that are apart comes to 1.3 times; of 100 with factors up to 20 apart four fifths come to twice.
LEFT, TIMES, LEAST = 0.03, 2.0, 1e-3
#: So many joints that have a say are enough for that; of fewer it must be so many times. (Of 78 cuts of 3 and 10 s of a
#: recorded arm, two of 3 s with three joints came to 2.5.)
MANY, SURELY = 4, 6.0
#: Factors this far apart are no gains of a drive; joints off the typical factor by the second are off.
APART, OFF = 3.0, 1.5
#: Distances [rad] over which friction may turn over. (At .15 rad it is no friction that turns over with the speed: a
#: simulated wrist that had it was told to have a unit of its own.)
PRESLIDING = (0.02, 0.1)
#: Rows looked at; rounds in which factors and links are found in turn.
ROWS, ROUNDS = 1500, 100
#: Parts of the rows, each predicted by the links of the others.
PARTS = 5
#: Directions of the links' parameters that show less than this share of the clearest are not determined.
_UNSEEN = 1e-11
#: Of a column or a torque this share is rounding.
_ROUNDING = 1e-9


def check_unit(names: Sequence[str], fits: Sequence[Fit], pulled: NDArray[np.bool_]) -> list[Finding]:
    """A unit is called wrong only where most joints that the model says much about agree; not by joints ``pulled``
    (n,), of which a spring explains as much."""
    alpha = np.array([f.coefficients[0] for f in fits])
    rigid = np.array([f.rigid for f in fits])
    strong = (rigid >= STRONG * max(float(rigid.max()), 1e-12)) & (alpha > 0)
    strong &= np.array([f.left < EXPLAINED for f in fits])
    off = strong & ~pulled & ((alpha > MAX_SCALE) | (alpha < 1 / MAX_SCALE))
    # One of two may be friction and a little of something else.
    if not off.any() or 2 * off.sum() <= strong.sum():
        return []
    factors = alpha[strong]
    typical = float(np.exp(np.median(np.log(factors))))
    spread = float(np.max(np.abs(np.log(factors / typical))))
    power = round(float(np.log10(typical)))
    named = _UNITS.get(power) if abs(np.log10(typical) - power) < 0.3 and spread < np.log(3) else None
    j = int(np.argmax(off))
    each = ", ".join(f"{names[k]} {alpha[k]:.3g}" for k in map(int, np.flatnonzero(strong)))
    if named:
        told = f"it looks like {named[0]}: convert it"
        cure = named[1]
    else:
        told = (
            f"convert the unit: {CURE}; factors by joint: {each}; positions that are not in rad look so, too, and in "
            "slow motion a torque without the weight of the links (gravity: compensated in the log.yaml)"
        )
        cure = {}
    text = f"measured torque is {alpha[j]:.3g} times the model's on joint {j + 1}; expected N m at the joint; {told}"
    return [Finding("torque_unit", "hard", text, joint=names[j], suggestion=cure)]


def check_own_units(
    robot: Robot, parts: Sequence[Stretch], columns: Columns, forms: Forms, gravities: Sequence[Array]
) -> list[Finding]:
    """Torques each in a unit of its own: links of any mass and any centre leave much of them, and with a factor a joint
    next to nothing, whichever of ``gravities`` (3,) [m/s^2] holds: no links at all make up for a gravity that is not
    there.

    ``columns`` and ``forms`` are those of ``parts``. One joint that is off by itself, and not beyond all proportion,
    may lack something else.
    """
    found = [_under(robot, parts, columns, g, [forms.fit(j, g) for j in range(forms.n)]) for g in gravities]
    return min(found, key=lambda own: [f.severity == "hard" for f in own])


def _under(
    robot: Robot, parts: Sequence[Stretch], columns: Columns, gravity: Array, fits: Sequence[Fit]
) -> list[Finding]:
    """The same under ``gravity``, with ``fits`` as described."""
    shown = _Shown.of(robot, parts, columns, gravity)
    if len(shown.joints) < 2:
        return []
    one = shown.left(np.ones(len(shown.joints)))
    if one.max() < LEFT:
        return []
    start = np.array([max(fits[j].coefficients[0], 1e-6) for j in shown.joints])
    start /= np.exp(np.log(start).mean())
    factors = shown.factors(start)
    own = shown.left(factors)
    as_described = np.array([fits[j].left for j in shown.joints])
    says = (own < SETTLED) & (shown.share > SAYS) & ((as_described < EXPLAINED) | (own < LEFT))
    worse = np.where(says, one - own, 0.0)
    times = float(one[says].sum()) / max(float(own[says].sum()), LEAST)
    if says.sum() < 2 or worse.max() < LEFT or times < TIMES or np.ptp(np.log(factors[says])) < np.log(APART):
        return []
    typical = float(np.median(np.log(factors[says])))
    off = says & (np.abs(np.log(factors) - typical) > np.log(OFF))
    if off.sum() == 1 and as_described[off][0] > SETTLED and own[off][0] > LEFT:
        # Neither links as described nor any others explain it but for a factor: what is left of it has another cause.
        return []
    # Of few joints and a few seconds, links and factors together can make much of anything.
    enough = says.sum() >= MANY or times > SURELY
    carried = _carries_over(shown, start, says)
    far = (off.sum() > 1 and says.sum() > 2) or np.ptp(np.log(factors[says])) > np.log(MAX_SCALE)
    certain = enough and carried and far and float(one[says].max()) > FAILS
    most = int(np.argmax(worse))
    each = ", ".join(
        f"{robot.joint_names[shown.joints[i]]} {fits[shown.joints[i]].coefficients[0]:.3g}"
        for i in np.flatnonzero(says)
    )
    text = (
        f"the torques are not in one unit: whatever the links weigh, {one[most]:.0%} of what friction and springs do "
        f"not make of {robot.joint_names[shown.joints[most]]}'s is left, and {own[most]:.1%} where each joint is read "
        f"with a factor of its own; expected N m at the joint: {CURE}; how many times the model's torque is measured: "
        f"{each}"
    )
    if not certain:
        instead = "one joint alone may lack something else: a counterweight, a coupling to another"
        if not carried:
            instead = "other parts of these runs do not say so: record longer runs through more poses"
        text = f"it looks as if {text}; {instead}"
    return [Finding("torque_unit", "hard" if certain else "warning", text)]


def _carries_over(shown: _Shown, start: Array, says: NDArray[np.bool_]) -> bool:
    """Whether joints that have a say are explained by links and factors of the other parts of the rows, too, and not by
    links of one unit."""
    own, one = (shown.held_out(first)[says] for first in (start, None))
    return bool(own.mean() < EXPLAINED and TIMES * own.sum() < one.sum())


class _Shown:
    """What friction, rotor, offset, a spring and what the model has beside leave of each joint's torque, of size one,
    and what links could make of it; ``share`` of the torque (rms) that is."""

    def __init__(self, joints: list[int], share: Array, grams: Array, products: Array, squares: Array) -> None:
        """Of each part of the rows: ``grams`` (PARTS, m, c, c) of what links make, its ``products`` (PARTS, m, c) with
        the torque, and that one's ``squares`` (PARTS, m)."""
        self.joints = joints
        self.share = share
        self._each = grams, products, squares
        self._grams = grams.sum(axis=0)
        self._products = products.sum(axis=0)
        self._squares = squares.sum(axis=0)

    @classmethod
    def of(cls, robot: Robot, parts: Sequence[Stretch], columns: Columns, gravity: Array) -> _Shown:
        rows = np.unique(np.linspace(0, len(columns.tau) - 1, min(ROWS, len(columns.tau))).astype(int))
        q, dq, ddq = (np.concatenate([getattr(p, s) for p in parts])[rows] for s in ("q", "dq", "ddq"))
        standing = robot.copy()
        standing.model.gravity.linear = gravity
        regressor = standing.regressor(q, dq, ddq)
        joints, share, grams, products, squares = [], [], [], [], []
        parted = np.array_split(np.arange(len(rows)), PARTS)
        for j in range(robot.n_joints):
            spring = np.column_stack([q[:, j], np.sin(q[:, j]), np.cos(q[:, j])])
            signs = [np.concatenate([presliding_sign(p.q[:, j], s) for p in parts])[rows] for s in PRESLIDING]
            beside = np.column_stack([columns.free(j)[rows], columns.beside[rows, j], spring, *signs])
            basis, size, _ = np.linalg.svd(
                beside / np.maximum(np.linalg.norm(beside, axis=0), 1e-300), full_matrices=False
            )
            basis = basis[:, size > _ROUNDING]
            torque = columns.tau[rows, j] - columns.tau[rows, j].mean()
            left, links = (x - basis @ (basis.T @ x) for x in (columns.tau[rows, j], regressor[:, j]))
            norm, whole = float(np.linalg.norm(left)), float(np.linalg.norm(torque))
            # Of a torque that never changes what is left is rounding, and in that unit links are beyond all others.
            silent = whole <= _ROUNDING * np.linalg.norm(columns.tau[rows, j])
            moves = np.linalg.norm(links) > _ROUNDING * np.linalg.norm(regressor[:, j])
            if silent or not moves or norm <= _ROUNDING * whole:
                continue
            joints.append(j)
            share.append(norm / whole)
            left, links = left / norm, links / norm
            grams.append([links[part].T @ links[part] for part in parted])
            products.append([links[part].T @ left[part] for part in parted])
            squares.append([left[part] @ left[part] for part in parted])
        count, m = regressor.shape[2], len(joints)
        shapes = ((m, PARTS, count, count), (m, PARTS, count), (m, PARTS))
        each = (np.reshape(x, own).swapaxes(0, 1) for x, own in zip((grams, products, squares), shapes, strict=True))
        return cls(joints, np.array(share), *each)

    def links(self, factors: Array) -> Array:
        """(c,) links that explain most, where torque is ``factors`` (m,) times that in N m."""
        gram = np.einsum("m,mij->ij", factors**2, self._grams)
        return np.asarray(pinvh(gram, rtol=_UNSEEN) @ (factors @ self._products))

    def _common(self, links: Array) -> tuple[Array, Array]:
        """What ``links`` (c,) have in common with each joint's torque (m,), and their own square sum there (m,)."""
        return self._products @ links, np.einsum("i,mij,j->m", links, self._grams, links)

    def held_out(self, start: Array | None) -> Array:
        """(m,) share of each joint's mean square that the best links of the other parts of the rows leave: in one unit,
        or, from ``start``, with the best factors of those parts, too."""
        out = np.zeros(len(self.joints))
        for k in range(PARTS):
            others = _Shown(self.joints, self.share, *(np.delete(x, k, axis=0) for x in self._each))
            part = _Shown(self.joints, self.share, *(x[[k]] for x in self._each))
            factors = np.ones(len(out)) if start is None else others.factors(start)
            out += part.left_by(others.links(factors), factors)
        return out

    def left(self, factors: Array) -> Array:
        """(m,) share of each joint's mean square that the best links leave."""
        return self.left_by(self.links(factors), factors)

    def left_by(self, links: Array, factors: Array) -> Array:
        """(m,) square sum of each joint, of all rows one, that ``links`` (c,) leave."""
        along, made = self._common(links)
        return np.asarray(np.maximum(self._squares - 2.0 * factors * along + factors**2 * made, 0.0))

    def factors(self, start: Array) -> Array:
        """(m,) that leave least: links and factors in turn, from ``start``; their geometric mean is one."""
        out = start
        for _ in range(ROUNDS):
            along, made = self._common(self.links(out))
            new = np.maximum(along / np.maximum(made, 1e-300), 1e-6)
            new /= np.exp(np.log(new).mean())
            settled = np.max(np.abs(np.log(new / out))) < 1e-3
            out = new
            if settled:
                break
        return out
