"""Does the log count some joints otherwise than the URDF: from a zero a quarter turn off, or the other way round?

Descriptions of one arm by a maker, a lab and a simulator differ so: the elbow is straight at 0 or at 90 degrees, a
wrist turns the other way. Nothing else of the log is wrong, and far from the true zero no small correction finds it:
what comes nearest is gravity from another side, or friction that is none. A quarter turn, or a turned axis, of one
joint after the other is tried, those first that explain the torque best; torque is counted as the joint is. Turned
axes and turns that are one and the same arm (all of a straight one, say) cannot be told apart, and need not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid_dynamics.check.columns import Columns
from hybrid_dynamics.check.completed import Completed, beside_body, body_of
from hybrid_dynamics.check.cures import turned
from hybrid_dynamics.check.findings import Finding
from hybrid_dynamics.check.forms import FLOOR, Forms
from hybrid_dynamics.check.guess import CERTAIN, CHANGED, SIGN, UNEXPLAINED, Guess, few_rows, left_of
from hybrid_dynamics.check.pulled import body_leaves, spring_leaves, tool_leaves
from hybrid_dynamics.check.samples import Stretch, direction
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: Price of a zero that is off, in units of the natural logarithm of a joint's mean square; of a joint that counts
#: backwards in position and torque both their signs'.
ZERO, BACKWARDS = 0.7, 2 * SIGN
#: Asked only where a joint leaves more than this share of its torque's mean square.
LEFT = 0.05
#: Readings that are followed at once, and the rows that they are tried on, about; readings tried at a time, and where
#: all pairs of joints are asked. Of many joints fewer are followed.
WIDTH, ROWS, AT_ONCE, PAIRS = 8, 400, 400, 2800
#: So many readings that do as well are told at most.
MOST = 2
#: So much of what is gained must be of joints that are explained then.
MOSTLY = 0.8
#: What leaves no more than this share of the mean square explains a joint as well as anything.
SAME = 0.02
#: A joint moves where its positions range over more than this [rad, m].
MOVES = 0.05
#: Other causes explain plainly what they leave no more of than this share: nothing is asked then.
PLAIN = 0.01
#: Limits of a URDF are known to about this [rad], of a joint that slides [m].
OUTSIDE, SLID = 0.2, 0.02


@dataclass(frozen=True)
class Convention:
    """A joint's position is ``sign * read + 90 deg * quarters``, its torque ``sign * read``; per joint (n,)."""

    sign: tuple[int, ...]
    quarters: tuple[int, ...]

    @property
    def price(self) -> float:
        """What it costs to read the log so."""
        return ZERO * sum(k != 0 for k in self.quarters) + BACKWARDS * self.sign.count(-1)

    @property
    def changed(self) -> list[int]:
        """Joints (0-based) that are counted otherwise than they are read."""
        return [j for j, (s, k) in enumerate(zip(self.sign, self.quarters, strict=True)) if s < 0 or k]

    @property
    def offset(self) -> Array:
        """(n,) [rad]."""
        return np.pi / 2 * np.array(self.quarters, float)

    def cure(self, known: Array) -> dict[str, Any]:
        """Keys of a ``log.yaml`` that count so, before a model adds its own ``known`` offset (n,) to the positions."""
        turned_round = np.array(self.sign) - 1.0
        offset = [round(float(x), 6) + 0.0 for x in self.offset + turned_round * known]
        backwards = [j for j, s in enumerate(self.sign) if s < 0]
        return {
            **({"offset": {"q": offset}} if any(offset) else {}),
            **(turned(len(self.sign), backwards, ["q", "dq", "tau"]) if backwards else {}),
        }

    def said(self, names: Sequence[str]) -> list[str]:
        """A clause for each joint counted otherwise."""
        return [
            " and ".join(
                [
                    *(["the other way round"] if self.sign[j] < 0 else []),
                    *([f"from a zero about {abs(90 * self.quarters[j])} deg off"] if self.quarters[j] else []),
                ]
            )
            + f" at {names[j]} (q of the URDF = {'-' if self.sign[j] < 0 else ''}q read"
            + (f" {90 * self.quarters[j]:+d} deg" if self.quarters[j] else "")
            + ")"
            for j in self.changed
        ]

    def of(self, parts: Sequence[Stretch]) -> list[Stretch]:
        """``parts`` counted so."""
        s, offset = np.array(self.sign, float), self.offset
        return [replace(p, q=s * p.q + offset, dq=s * p.dq, ddq=s * p.ddq, tau=s * p.tau) for p in parts]


@dataclass(frozen=True)
class _Counted:
    convention: Convention
    scores: Array

    @property
    def explained(self) -> float:
        return -float(self.scores.sum())

    @property
    def total(self) -> float:
        return self.convention.price - self.explained


def check_convention(
    model: Robot | Completed, parts: Sequence[Stretch], told: Guess, best: Guess, columns: Columns
) -> list[Finding]:
    """A finding where ``parts`` explain their torque by another convention, better than as ``told`` and by any of the
    other guesses, of which ``best`` is the best; ``columns`` are those of ``parts``.

    None where a tool, or of every joint that it explains a link or a spring, explains more; a warning where they do
    as well; else hard, with a cure where no other convention is nearly as good.
    """
    robot, names = body_of(model), body_of(model).joint_names
    before = np.array([left_of(s) for s in told.scores])
    q = np.concatenate([p.q for p in parts])
    # What is left of a joint that stands is noise, whatever it counts from.
    unexplained = [int(j) for j in np.flatnonzero((before > LEFT) & (np.ptp(q, axis=0) > MOVES))]
    if not unexplained or any(np.all(x <= PLAIN) for x in _otherwise(robot, q, columns, [told, best], unexplained)):
        return []
    few = few_rows(parts)
    here = _scores(model, few, told.gravity)
    chosen, *others = _search(model, few, told.gravity)
    gain = float(here.sum()) - chosen.total
    if gain < max(told.total - best.total, 0.0) + CERTAIN:
        return []
    # On the footing of all rows, by what is told there.
    after = np.array([left_of(s) for s in chosen.scores - here + np.array(told.scores)])
    gained = here - chosen.scores
    better = [int(j) for j in np.flatnonzero(gained > CERTAIN)]
    if not better or gained[after < UNEXPLAINED].sum() < MOSTLY * gained.sum():
        return []
    so = after[better]
    alternatives = _otherwise(robot, q, columns, [told, best], better)
    if any(np.log((so + FLOOR) / (left + FLOOR)).sum() > CHANGED for left in alternatives):
        return []
    doubtful = any(bool(np.all(left <= np.maximum(so, SAME))) for left in alternatives)
    counted = chosen.convention.changed
    rivals = [
        o.convention for o in others if o.total < chosen.total + CERTAIN or o.explained > chosen.explained + CERTAIN
    ]
    most = int(np.argmax(before - after))
    text = (
        f"the log counts {'; '.join(chosen.convention.said(names))} (unexplained {before[most]:.0%} of the "
        f"mean square of {names[most]} as it stands, {after[most]:.0%} so)"
    )
    if doubtful:
        text = (
            f"it looks as if {text}; a link or a tool that weighs otherwise, or a spring, at {names[most]} would "
            "look the same: compare one posture of the arm with the URDF's"
        )
    elif rivals:
        others_said = ", or ".join("; ".join(rival.said(names)) for rival in rivals[:MOST])
        text += f"; nearly as well: {others_said}; compare one posture of the arm with the URDF's, and say in log.yaml"
    else:
        text += "; say so in log.yaml (offset and sign of q, sign of tau), or give the URDF that the log counts by"
    return [
        Finding(
            "convention",
            "warning" if doubtful else "hard",
            text,
            joint=names[counted[0]] if len(counted) == 1 else "",
            suggestion={} if doubtful or rivals else chosen.convention.cure(_known_offset(model)),
        )
    ]


def _otherwise(
    robot: Robot, q: Array, columns: Columns, guesses: Sequence[Guess], joints: Sequence[int]
) -> list[Array]:
    """Shares (m,) of the mean squares of ``joints`` that other causes leave, under the gravity of each of ``guesses``:
    a link that weighs otherwise or a spring, of each joint its own, and one tool on the last link."""
    out = []
    for gravity in {tuple(map(float, guess.gravity)): guess.gravity for guess in guesses}.values():
        # One joint's torque is easily explained by one link; that of several joints not by one each.
        each = [
            min(body_leaves(robot, q, columns, gravity, j), spring_leaves(columns, q[:, j], gravity, j)) for j in joints
        ]
        out += [np.array(each), tool_leaves(robot, q, columns, gravity, joints)]
    return out


def _known_offset(model: Robot | Completed) -> Array:
    """(n,) [rad] what ``model`` adds to the positions that a log gives it."""
    n = body_of(model).n_joints
    return np.zeros(n) if isinstance(model, Robot) else np.zeros(n) + model.readings.offset


def _search(model: Robot | Completed, parts: Sequence[Stretch], gravity: Array) -> list[_Counted]:
    """Conventions by which ``parts`` explain their torque, the best first; as it is read is one that is asked.

    From a few readings at a time one joint is counted otherwise, until that has twice led to nothing better:
    of two joints that are both turned round, one turned back may look worse. Where a joint is hardly explained,
    from every reading of one joint (of many joints the best): pairs of joints are asked.
    """
    limits = _Limits(body_of(model), parts)
    coarse = few_rows(parts, ROWS)

    def counted(convention: Convention, rows: Sequence[Stretch]) -> _Counted:
        return _Counted(convention, _scores(model, convention.of(rows), gravity))

    front = [counted(_as_read(body_of(model).n_joints), coarse)]
    seen = {front[0].convention: front[0]}
    moving = np.ptp(np.concatenate([p.q for p in coarse]), axis=0) > MOVES
    hardly = np.any(moving & (np.array([left_of(s) for s in front[0].scores]) > UNEXPLAINED))
    steps = len(list(_steps(front[0].convention, limits)))
    narrow, wide = (max(most // max(steps, 1), 1) for most in (AT_ONCE, PAIRS))
    follow = min(WIDTH, narrow)
    best, idle, width = front[0].total, 0, wide if hardly else follow
    while front and idle < 2:
        asked = {c for one in front for c in _steps(one.convention, limits)} - set(seen)
        tried = [counted(c, coarse) for c in sorted(asked, key=_order)]
        seen |= {t.convention: t for t in tried}
        front, width = sorted(tried, key=lambda t: t.total)[:width], follow
        least = min((t.total for t in front), default=np.inf)
        idle = 0 if least < best else idle + 1
        best = min(best, least)
    ends = {t.convention for t in sorted(seen.values(), key=lambda t: t.total)[:WIDTH]}
    ends |= {t.convention for t in sorted(seen.values(), key=lambda t: t.scores.sum())[:WIDTH]}
    return sorted((counted(c, parts) for c in sorted(ends, key=_order)), key=lambda t: t.total)


def _steps(convention: Convention, limits: _Limits) -> Iterator[Convention]:
    """``convention`` with one joint counted otherwise, where the joint can be there."""
    for j in range(len(convention.sign)):
        for sign in (1, -1):
            for turn in range(4) if limits.turns[j] else (0,):
                quarters = limits.within(j, sign, turn)
                if quarters is not None:
                    yield Convention(
                        (*convention.sign[:j], sign, *convention.sign[j + 1 :]),
                        (*convention.quarters[:j], quarters, *convention.quarters[j + 1 :]),
                    )


class _Limits:
    """Whether a joint, counted otherwise, would be outside the URDF's limits and was not; those of zero width count as
    not given. A joint that slides has no quarter turn."""

    def __init__(self, robot: Robot, parts: Sequence[Stretch]) -> None:
        self.turns = [name not in robot.prismatic for name in robot.joint_names]
        self._low, self._high = robot.position_limits
        self._least = np.min([p.q.min(axis=0) for p in parts], axis=0)
        self._most = np.max([p.q.max(axis=0) for p in parts], axis=0)

    def within(self, j: int, sign: int, turn: int) -> int | None:
        """Quarters of the posture ``turn`` (0 to 3) by which joint ``j`` stays within its limits, of several the
        least; None where none is."""
        # A whole turn more or less is the same posture.
        every = sorted((turn, turn - 4, turn + 4), key=abs) if self.turns[j] else [0]
        return next((quarters for quarters in every if self._allow(j, sign, quarters)), None)

    def _allow(self, j: int, sign: int, quarters: int) -> bool:
        """True where joint ``j`` counted so is hardly further outside its limits than it is as it is read."""
        if not self._low[j] < self._high[j]:
            return True
        shift = quarters * np.pi / 2
        ends = sorted(sign * x + shift for x in (self._least[j], self._most[j]))
        read, there = (
            max(self._low[j] - low, high - self._high[j], 0.0) for low, high in ((self._least[j], self._most[j]), ends)
        )
        return bool(there <= read + (OUTSIDE if self.turns[j] else SLID))


def _order(convention: Convention) -> tuple[tuple[int, ...], tuple[int, ...]]:
    return convention.quarters, convention.sign


def _as_read(n: int) -> Convention:
    return Convention((1,) * n, (0,) * n)


def _scores(model: Robot | Completed, parts: Sequence[Stretch], gravity: Array) -> Array:
    """(n,) how well the joints' torque is explained: natural logarithm of the share that is left."""
    q, dq, ddq, tau = (np.concatenate([getattr(p, s) for p in parts]) for s in ("q", "dq", "ddq", "tau"))
    standing = body_of(model).copy()
    standing.model.gravity.linear = gravity
    # Gravity is not asked about: one pass holds it and the motion.
    rigid = standing.inverse_dynamics(q, dq, ddq)
    none = np.zeros((*q.shape, 3))
    columns = Columns(rigid, none, beside_body(model, parts, q, dq, ddq), dq, ddq, direction(dq), tau)
    forms = Forms(columns)
    return np.array([forms.fit(j, gravity).score for j in range(forms.n)])
