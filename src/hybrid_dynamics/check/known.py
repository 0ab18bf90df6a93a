"""Signs, orders and units of columns under which a completed model explains the torque as it is, nothing fitted.

:mod:`.torque` leaves open what a robot may have beyond its description: a spring or a tool looks like a torque turned
round, a coupling like columns exchanged. A completed model leaves nothing of that open. Where it misses the log as it
stands and hits it once a column is turned round or exchanged, or in another unit, the log is what is wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.check.columns import columns_of, standing
from hybrid_dynamics.check.completed import Completed, body_of, true_stretches
from hybrid_dynamics.check.cures import exchanged, reordered, turned
from hybrid_dynamics.check.findings import Finding, Severity
from hybrid_dynamics.check.forms import FLOOR
from hybrid_dynamics.check.guess import few_rows
from hybrid_dynamics.check.samples import Stretch
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: Shares of a joint's mean square: missed from here on, hit up to here; no joint may get worse by more than the last.
MISSED, HIT, WORSE = 0.3, 0.05, 0.02
#: A torque of so small a mean square [(N m)^2, N^2] is that of a joint that nobody measured, and rounding.
SILENT = 1e-18
#: One factor is that of at least two joints whose torque is this share of the largest (rms), by so much (natural
#: logarithm) at most.
STRONG, ALIKE = 0.05, 0.3
#: Why a joint that looks turned round may be as it is.
ELSEWHERE = "the model was not learnt where the joint is, and a law alike on both sides would look the same"
#: Most of the samples, and of the joints, are more than this share.
MOSTLY = 0.5


@dataclass(frozen=True)
class _Reading:
    """``signals`` of ``joints`` (0-based) among ``n`` are exchanged (two joints) or turned round; or those of all
    joints are ``factor`` times too large."""

    n: int
    joints: tuple[int, ...] = ()
    signals: tuple[str, ...] = ()
    exchanged: bool = False
    factor: float = 1.0

    @property
    def source(self) -> list[int]:
        """Which torque column is each joint's own."""
        moved = self.exchanged and "tau" in self.signals
        return exchanged(self.n, *self.joints) if moved else list(range(self.n))

    @property
    def sign(self) -> list[int]:
        """That of each joint's torque."""
        flipped = self.joints if "tau" in self.signals and not self.exchanged else ()
        return [-1 if j in flipped else 1 for j in range(self.n)]

    def of(self, parts: Sequence[Stretch]) -> list[Stretch]:
        """``parts`` with positions, or torques, that are so many times smaller."""
        scale = 1.0 / self.factor
        moved, torque = (scale if s in self.signals else 1.0 for s in ("q", "tau"))
        return [
            replace(p, q=moved * p.q, dq=moved * p.dq, ddq=moved * p.ddq, tau=torque * p.tau) if scale != 1.0 else p
            for p in parts
        ]

    def is_known(self, known: NDArray[np.bool_]) -> bool:
        """Whether a model that is ``known`` (n,) where joints are can tell it: of torques of theirs; what moves the
        positions moves them away from there."""
        own = known[list(self.joints)] if self.joints else known
        return "q" in self.signals or bool(np.mean(own) > MOSTLY or own.all())

    @property
    def moved(self) -> dict[str, Any]:
        """What happens to the positions, for :func:`columns_of`."""
        if "q" not in self.signals or self.factor != 1.0:
            return {}
        return {"swap": self.joints} if self.exchanged else {"mirror": self.joints[0]}


def check_known(
    model: Robot | Completed, runs: Sequence[Trajectory], gains: bool = False, taught: Sequence[Trajectory] = ()
) -> list[Finding]:
    """A hard finding where ``model`` hits the torque of ``runs`` (``q tau`` on uniform grids) read otherwise only.

    With ``gains`` all torques may be wrong by one factor, too: of a log that is predicted along, none of its business.
    ``taught``: the runs from which the model was learnt, if they are known. Of the torque of a joint that is mostly
    where these have not been it says nothing: there a law that was learnt may have the other sign. And of such a joint
    that is turned round it is only a warning: a law that is alike on both sides, learnt on one, hits it so, too.
    """
    parts = few_rows(true_stretches(model, runs))
    if not parts:
        return []
    gravity = standing(body_of(model))
    names = body_of(model).joint_names

    def left(reading: _Reading) -> Array:
        columns = columns_of(model, reading.of(parts), **reading.moved)
        tau = columns.tau[:, reading.source]
        off = tau * reading.sign - np.column_stack([columns.model(j, gravity) for j in range(len(names))])
        power = np.mean(tau**2, axis=0)
        return np.asarray(np.where(power > SILENT, np.mean(off**2, axis=0) / np.maximum(power, SILENT), 0.0))

    told = left(_Reading(len(names)))
    if not np.any(told > MISSED):
        return []
    known = _been_there(parts, true_stretches(model, taught), len(names))
    readings = (*_readings(len(names)), *_units(model, parts, gains))
    tried = [(reading, left(reading)) for reading in readings if reading.is_known(known)]
    reading, best = min(tried, key=lambda pair: float(np.sum(np.log(pair[1] + FLOOR))))
    better = told - best > MISSED
    if not better.any() or np.any(best[better] > HIT) or np.any(best > told + WORSE):
        return []
    doubtful = "mirror" in reading.moved and not known[list(reading.joints)].all()
    return [_finding(reading, names, float(told[better].max()), float(best[better].max()), doubtful)]


def told_by_model(model: Completed, runs: Sequence[Trajectory], taught: Sequence[Trajectory]) -> list[Finding]:
    """:func:`check_known` of each of ``runs`` that ``model``, learnt from those that ``taught`` it, was not."""
    found = ((run, f) for run in runs for f in check_known(model, [run], gains=True, taught=taught))
    by = {"hard": "; one of the two is read wrongly"}
    return [
        replace(f, run=run.name, text=f"{f.text} (by the model that the training runs teach{by.get(f.severity, '')})")
        for run, f in found
    ]


def _been_there(parts: Sequence[Stretch], taught: Sequence[Stretch], n: int) -> NDArray[np.bool_]:
    """(n,) joints that are mostly at positions between those of the runs that ``taught`` the model; all without any."""
    if not taught:
        return np.ones(n, bool)
    low, high = (f([f(part.q, axis=0) for part in taught], axis=0) for f in (np.min, np.max))
    q = np.concatenate([p.q for p in parts])
    return np.asarray(np.mean((q >= low) & (q <= high), axis=0) >= MOSTLY)


def _readings(n: int) -> Iterator[_Reading]:
    every = ("tau",), ("q", "dq"), ("q", "dq", "tau")
    for signals in every:
        yield from (_Reading(n, (j,), signals) for j in range(n))
        yield from (_Reading(n, pair, signals, exchanged=True) for pair in combinations(range(n), 2))
    if n > 1:
        yield _Reading(n, tuple(range(n)), ("tau",))


def _units(model: Robot | Completed, parts: Sequence[Stretch], gains: bool) -> Iterator[_Reading]:
    """Positions in degrees or in radians that are taken for the other; with ``gains`` torques wrong by one factor."""
    columns, gravity = columns_of(model, parts), standing(body_of(model))
    n = columns.tau.shape[1]
    if not body_of(model).prismatic:
        yield from (_Reading(n, signals=("q", "dq"), factor=float(f)) for f in (np.rad2deg(1.0), np.deg2rad(1.0)))
    if not gains:
        return
    hats = np.column_stack([columns.model(j, gravity) for j in range(n)])
    power = np.einsum("tj,tj->j", hats, hats)
    strong = power > STRONG**2 * power.max(initial=0.0)
    factors = (np.einsum("tj,tj->j", hats, columns.tau) / np.maximum(power, 1e-300))[strong]
    # Of a single joint it may be a load, or friction that has changed.
    if len(factors) > 1 and factors.min() > 0 and np.ptp(np.log(factors)) < ALIKE:
        yield _Reading(n, signals=("tau",), factor=float(np.median(factors)))


def _finding(reading: _Reading, names: Sequence[str], before: float, after: float, doubtful: bool = False) -> Finding:
    joints = [names[j] for j in reading.joints]
    what = {
        ("tau",): "the measured torque",
        ("q", "dq"): "the position",
        ("q", "dq", "tau"): "position and torque",
    }[reading.signals]
    shares = f"the model leaves {before:.0%} of the mean square as it stands, {after:.0%} so"
    if reading.factor != 1.0:
        return _unit(reading, shares)
    if reading.exchanged:
        text = (
            f"{what} of {joints[0]} and {joints[1]} are exchanged ({shares}); expected the columns in the order of the "
            "URDF's joints: exchange the columns"
        )
        cure = reordered(exchanged(len(names), *reading.joints), reading.signals)
        return Finding("joint_order", "hard", text, joint=joints[0], suggestion=cure)
    whose = "of every joint " if len(joints) > 1 else ""
    text = (
        f"{what} {whose}turned round ({shares}); expected the signs of the URDF's axes, and the torque the drive "
        f"delivers: flip the sign of {' and '.join(s for s in reading.signals if s != 'dq')}"
    )
    if doubtful:
        text = f"it looks like {what} turned round ({shares}); {ELSEWHERE}"
    code = "position_sign" if "q" in reading.signals else "torque_sign"
    cure = {} if doubtful else turned(len(names), reading.joints, reading.signals)
    severity: Severity = "warning" if doubtful else "hard"
    return Finding(code, severity, text, joint=joints[0] if len(joints) == 1 else "", suggestion=cure)


def _unit(reading: _Reading, shares: str) -> Finding:
    """All of the signals are so many times too large."""
    times = f"{reading.factor:.3g} times what the model knows of them ({shares})"
    if "tau" in reading.signals:
        text = f"measured torques are {times}; expected N m at the joint: convert the unit, or correct the gain"
        cure = {"gain": {"tau": [round(1.0 / reading.factor, 6)]}}
        return Finding("torque_unit", "hard", text, suggestion=cure)
    large = reading.factor > 1
    text = f"positions are {times}: they are in {'degrees' if large else 'radians, and read as degrees'}; expected rad"
    return Finding("degrees", "hard", text, suggestion={"units": {"q": "deg" if large else "rad"}})
