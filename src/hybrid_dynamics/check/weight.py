"""Does the torque hold what the links weigh? Of a controller that adds gravity itself, a log may hold the rest alone.

The commanded torque of many arms is of that kind, and nothing else in the log says so: links without mass, or odd gains
and springs, then stand for it. The inertia of the same links is in the torque all the same, so the two are compared:
motion and gravity (any direction: the base may stand otherwise than the URDF says) are fitted to the torque of all
joints, beside friction, rotor, offset and what the model has beside the rigid body, free on every joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.check.columns import Columns, OfRun
from hybrid_dynamics.check.findings import Finding
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: Blocks of the jackknife, and how many standard errors an estimate may be off by.
BLOCKS, ERRORS = 12, 2.0
#: A joint has a say where its links' weight, as modelled, is this share of the joint's mean square that friction and
#: the like leave, and this share of the largest weight's torque (rms).
SAYS, STRONG = 0.1, 0.05
#: Of the inertia as modelled so many times as much may be in the torque (else its unit is in question), of the weight
#: at most this share of that: no links are so light beside what they are to move. Inertia beyond so many times the
#: model's is that of motors, or of a URDF that has too little, and asks for no more weight.
MOVES, LIGHT, MORE = (0.25, 4.0), 0.5, 1.5
#: Joints that have their weight all the same, a payload's that the controller knows nothing of, make at most this share
#: of all weight (rms).
ALL_THE_SAME = 0.1
#: In another unit the links explain more than this share of the torque as ever.
ANOTHER_UNIT = 0.8
#: Weight that is in the torque twice, by the inertia in it.
TWICE = (1.7, 2.3)
#: No joint is heard more than one of which a hundredth of what links make is left (square sums), however little noise
#: it has: one that nobody measured has none.
TRUSTED = 100.0
#: Links whose mass and centre are off leave this share of their weight (rms), whatever direction gravity has.
SHAPE = 0.05
#: A joint lifts nothing where that is this share of what its links' inertia makes (square sums).
NOTHING = 0.01
#: Weight in the torque, as a multiple of the model's, between which it is the links' and in N m.
WEIGHS = (0.5, 2.0)
#: A column of which this share of its square sum is left is rounding.
ROUNDING = 1e-9
_FREE, _TORQUE = slice(4, 9), 9
#: What :func:`_fit` tells of a joint.
OfJoint = tuple[Array, float, float]


@dataclass(frozen=True)
class Weighed:
    """How many times what the model says is in the torque: ``motion`` of all joints, ``weight`` (m,) of the m joints
    that have a say; with their standard errors. ``clear_motion``: of the joints that hold their weight, about
    (:data:`WEIGHS`), or lift nothing and show inertia; 0 where none does; ``clear_off``: what it may be off by besides,
    where the links' weight is by :data:`SHAPE`. ``modelled`` (m,) [N m]: rms torque of their weight; ``explained``
    (m,): share that links of any weight explain of what friction and the like leave of their torque."""

    motion: float
    motion_error: float
    clear_motion: float
    clear_motion_error: float
    clear_off: float
    weight: Array
    weight_error: Array
    modelled: Array
    explained: Array

    @property
    def moves(self) -> bool:
        """Whether the inertia of the links is surely in the torque, about as the model has it."""
        most = ERRORS * self.motion_error
        return self.motion - most > MOVES[0] and self.motion + most < MOVES[1]

    @property
    def light(self) -> bool:
        """Whether their weight is not, on any joint, as far as it can be told."""
        return self.weightless or (self.moves and bool(np.all(self.weight < LIGHT * min(self.motion, MORE))))

    @property
    def weightless(self) -> bool:
        """Whether their weight surely is not: on most joints that have a say, two at least (a spring may balance one),
        and hardly on any."""
        off, most = ERRORS * self.weight_error, ERRORS * self.motion_error
        without = self.weight + off < LIGHT * min(self.motion - most, MORE)
        having = self.weight - off > LIGHT * min(self.motion + most, MORE)
        enough = max(2, len(without) // 2 + 1)
        hardly = self.modelled[having].sum() <= ALL_THE_SAME * self.modelled.sum()
        return self.moves and int(without.sum()) >= enough and bool(hardly)

    @property
    def without_links(self) -> bool:
        """Whether hardly anything of the links is in the torque, and not for another unit: that would explain it."""
        moves = self.motion + ERRORS * self.motion_error
        weighs = self.weight + ERRORS * self.weight_error
        return bool(moves < MOVES[0] and np.all(weighs < MOVES[0]) and np.median(self.explained) < ANOTHER_UNIT)

    @property
    def twice(self) -> bool:
        """Whether it is in it about twice, on every joint."""
        share = self.weight / max(self.motion, 1e-300)
        return self.moves and bool(np.all((TWICE[0] < share) & (share < TWICE[1])))


def check_weight(columns: Columns, gravity: Array, tilted: bool = False) -> list[Finding]:
    """A finding where the torque holds the inertia of the links and not their weight under ``gravity`` (3,) [m/s^2],
    or this twice, or neither.

    ``tilted``: another mounting explains as much; where no joint lifts anything then, nothing is missing.
    """
    found = weigh(columns, gravity)
    if found is None:
        return []
    if found.light:
        # Of the joint that lifts most: a light one may lift a payload besides.
        k = int(np.argmax(found.modelled))
        text = (
            f"the torque {'holds' if found.weightless else 'seems to hold'} no weight of the links ("
            f"{found.weight[k]:.0%} +- {found.weight_error[k]:.0%} of what they weigh, and {found.motion:.0%} +- "
            f"{found.motion_error:.0%} of their inertia): it looks like a commanded torque to which the controller adds"
            " gravity itself; log the whole torque, or say gravity: compensated in the log.yaml, which adds what the "
            "URDF's links weigh"
            + ("; a base that stands so that no joint lifts anything looks the same" if tilted else "")
        )
        sure = found.weightless and not tilted
        cure = {"gravity": "compensated"} if sure else {}
        return [Finding("torque_weight", "hard" if sure else "warning", text, suggestion=cure)]
    if found.without_links:
        k = int(np.argmax(found.modelled))
        text = (
            f"the torque holds neither the weight nor the inertia of the links ({found.weight[k]:.1%} and "
            f"{found.motion:.1%} of them): it looks like what a model has left of it, an external torque, or like that"
            " of another arm; expected the torque that the drive delivers, or that of a joint torque sensor; a "
            "motor current needs torque constant times gear ratio (torque_constant in a log.yaml)"
        )
        return [Finding("torque_links", "hard", text)]
    if found.twice:
        share = float(np.median(found.weight)) / found.motion
        text = (
            f"the torque holds the weight of the links {share:.1f} times by the inertia that it holds; where a log.yaml"
            " says gravity: compensated, the log held it already: leave that out"
        )
        return [Finding("torque_weight", "warning", text)]
    return []


def lifts(columns: Columns, gravity: Array) -> bool:
    """Whether the torque holds what the links weigh under ``gravity`` (3,) [m/s^2], as far as any joint lifts then."""
    found = weigh(columns, gravity)
    return found is not None and found.moves and not (found.light or found.twice)


def without_weight(runs: Sequence[OfRun], gravity: Array) -> list[Trajectory]:
    """Those of ``runs`` that, each alone, hold no weight: among others that do, it is neither here nor there."""
    found = ((run, weigh(columns, gravity)) for run, columns in runs)
    return [run for run, weighed in found if weighed is not None and weighed.weightless]


def weigh(columns: Columns, gravity: Array) -> Weighed | None:
    """What of the links' inertia and weight is in the torque; None where too few joints have a say (two; one of two).

    A joint's weight is compared by the size of its torque, whatever direction of gravity fits it best.
    """
    size = float(np.linalg.norm(gravity))
    rows, n = columns.tau.shape
    if size <= 0 or rows < 10 * BLOCKS:
        return None
    grams = _products(columns, size)
    # A torque that nobody measured stands as 0, and holds no inertia to the last digit.
    grams[:, np.ptp(columns.tau, axis=0) == 0] = 0.0
    down = gravity / size
    whole = grams.sum(axis=0)
    rest = [_without_free(gram) for gram in whole]
    own = np.array([max(float(down @ r[1:4, 1:4] @ down), 0.0) for r in rest])
    says = (own >= SAYS * np.array([r[4, 4] for r in rest])) & (own >= STRONG**2 * own.max(initial=0.0)) & (own > 0)
    if says.sum() < min(2, n - 1) or not says.any():
        return None
    fits = [_fit(r) for r in rest]
    weight = _weights(rest, fits, says, own)
    clear = _clear(fits, own, np.flatnonzero(says)[(WEIGHS[0] < weight) & (weight < WEIGHS[1])])
    shape = SHAPE**2 * own[clear]
    spread = np.sqrt(BLOCKS - 1)
    without = [[_without_free(g) for g in whole - part] for part in grams]
    fits_without = [[_fit(r) for r in each] for each in without]
    weights = [_weights(each, own_fits, says, own) for each, own_fits in zip(without, fits_without, strict=True)]
    clear_fits = [fits[j] for j in clear]
    return Weighed(
        _motion(fits),
        spread * float(np.std([_motion(each) for each in fits_without])),
        _motion(clear_fits, shape),
        spread * float(np.std([_motion([each[j] for j in clear], shape) for each in fits_without])),
        _off(clear_fits, shape),
        weight,
        spread * np.std(weights, axis=0),
        np.sqrt(own[says] / rows),
        np.array([1.0 - fits[j][2] / max(float(rest[j][4, 4]), 1e-300) for j in np.flatnonzero(says)]),
    )


def _products(columns: Columns, size: float) -> Array:
    """(BLOCKS, n, 10, 10) products of ``[motion, gx, gy, gz, dq, sign, ddq, beside, 1, tau]``, gravity of ``size``."""
    rows, n = columns.tau.shape
    parts = np.array_split(np.arange(rows), BLOCKS)
    out = np.empty((BLOCKS, n, 10, 10))
    for j in range(n):
        table = np.column_stack(
            [
                columns.motion[:, j],
                columns.gravity[:, j] * size,
                columns.free(j)[:, :3],
                columns.beside[:, j],
                np.ones(rows),
                columns.tau[:, j],
            ]
        )
        out[:, j] = [table[part].T @ table[part] for part in parts]
    return out


def _without_free(gram: Array) -> Array:
    """(5, 5) products of motion, gravity and torque of one joint, less what the free columns explain."""
    kept = [0, 1, 2, 3, _TORQUE]
    inner, cross = gram[_FREE, _FREE], gram[_FREE][:, kept]
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    pinv = np.linalg.pinv(inner / np.outer(scale, scale), rcond=1e-9, hermitian=True) / np.outer(scale, scale)
    out = np.asarray(gram[np.ix_(kept, kept)] - cross.T @ pinv @ cross)
    # What the free columns explain to the last digit, the inertia of a joint that moves alone, is nothing.
    gone = np.diag(out) <= ROUNDING * np.diag(gram)[kept]
    gone[-1] = False
    out[gone], out[:, gone] = 0.0, 0.0
    return out


def _weights(rest: Sequence[Array], fits: Sequence[OfJoint], says: Array, own: Array) -> Array:
    """(m,) the multiple of the weight's torque in that of the joints that have a say."""
    return np.array(
        [
            np.sqrt(max(float(x[1:4] @ r[1:4, 1:4] @ x[1:4]), 0.0) / modelled)
            for r, (x, _, _), speaks, modelled in zip(rest, fits, says, own, strict=True)
            if speaks
        ]
    )


def _clear(fits: Sequence[OfJoint], own: Array, lifting: NDArray[np.int_]) -> NDArray[np.int_]:
    """The joints that are ``lifting``, and those that lift nothing and whose inertia makes more than what is left."""
    shows = [
        weight <= NOTHING * told and x[0] ** 2 * told > left for weight, (x, told, left) in zip(own, fits, strict=True)
    ]
    return np.union1d(lifting, np.flatnonzero(shows))


def _motion(fits: Sequence[OfJoint], shape: Array | float = 0.0) -> float:
    """The multiple of the motion's torque in that of the joints of ``fits`` where it is large; 0 of no joints.
    ``shape``: as for :func:`_off`."""
    trust = _trust(fits, shape)
    return float(trust @ np.array([x[0] for x, _, _ in fits])) / max(float(trust.sum()), 1e-300)


def _off(fits: Sequence[OfJoint], shape: Array) -> float:
    """What the multiple of the motion's torque in that of the joints of ``fits`` may be off by at most where their
    weight is by ``shape`` (m,) (square sums): all of that could look like inertia."""
    trust = _trust(fits, shape)
    told = np.array([max(t, 1e-300) for _, t, _ in fits])
    return float(np.linalg.norm(trust * np.sqrt(shape / told))) / max(float(trust.sum()), 1e-300)


def _trust(fits: Sequence[OfJoint], shape: Array | float) -> Array:
    """(m,) by what each joint tells of the torque that is left, ``shape`` besides; nothing where the motion's torque is
    small."""
    told, left = (np.array([fit[k] for fit in fits]) for k in (1, 2))
    told = np.where(told >= STRONG**2 * told.max(initial=0.0), told, 0.0)
    return np.asarray(told / np.maximum(left + shape, told / TRUSTED))


def _fit(r: Array) -> OfJoint:
    """Coefficients (4,) of motion and gravity, the motion's square sum beside gravity, what is left of the torque."""
    scale = np.sqrt(np.maximum(np.diag(r)[:4], 1e-300))
    inner = np.linalg.pinv(r[:4, :4] / np.outer(scale, scale), rcond=1e-6, hermitian=True)
    x = (inner @ (r[:4, 4] / scale)) / scale
    beside = r[0, 1:4] @ np.linalg.pinv(r[1:4, 1:4], rcond=1e-9, hermitian=True)
    told = max(float(r[0, 0] - beside @ r[1:4, 0]), 0.0)
    return x, told, max(float(r[4, 4] - x @ r[:4, 4]), 1e-6 * float(r[4, 4]), 1e-300)
