"""From what the model leaves to the next named cause: candidates compete on held-out runs.

One step ranks all candidate slots by the held-out error of a joint re-fit of the model with that slot. Among those
within one standard error of the best, or worse by nothing that matters, the simplest wins (Breiman et al. 1984); it is
accepted when its gain is certain and large enough to matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Slot
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.settings import LoopSettings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Candidate:
    """One row of the evidence table. ``score``: held-out squared error in squared noise floors, per sample.

    ``gain`` and its standard error ``gain_error`` in the same unit; ``joint_gain`` (n,) [N m]^2 per joint.
    """

    slot: Slot
    score: float
    gain: float
    gain_error: float
    joint_gain: tuple[float, ...]
    accepted: bool
    reason: str


#: A gain of this many standard errors is no accident, wherever it shows.
DECISIVE = 3.0


def same_place(a: Slot, b: Slot) -> bool:
    """True where two slots are the same effect on the same joint, whatever their settings."""
    return a.effect == b.effect and a.joint == b.joint


@dataclass(frozen=True)
class Judge:
    """Decides what a change of held-out error is worth."""

    evidence: Evidence
    settings: LoopSettings
    floor: Array
    torque_variance: Array

    def score(self, errors: Array) -> Array:
        """Weighted squared error (blocks,)."""
        return np.asarray(errors @ self.evidence.weights)

    def mean_square(self, errors: Array) -> Array:
        """(n,) [N m]^2."""
        return np.asarray(errors.sum(axis=0) / np.maximum(self.evidence.samples, 1))

    def standard_error(self, difference: Array) -> float:
        """Standard error of the sum of block-wise differences (blocks,)."""
        return float(np.sqrt(len(difference) * np.var(difference, ddof=1))) if len(difference) > 1 else 0.0

    def as_good(self, errors: Array, best: Array) -> bool:
        """True where ``errors`` (blocks, n) exceed ``best`` within one standard error, or by nothing that matters."""
        difference = self.score(errors) - self.score(best)
        growth = self.mean_square(errors) - self.mean_square(best)
        return bool(
            difference.sum() <= self.standard_error(difference) or np.all(growth <= self._bar(self.settings.keep_share))
        )

    def _bar(self, share: float) -> Array:
        """Mean square (n,) [N m]^2 below which a change is of no practical size."""
        return np.maximum(share * self.floor**2, self.settings.torque_share * self.torque_variance)

    def needed(self, slot: Slot) -> int:
        """On how many joints an effect must show: a whole-robot effect seen on one joint is a proxy for a local one."""
        if slot.family().scope != "robot":
            return 1
        return max(min(2, int((self.evidence.samples >= 20).sum())), 1)

    def matters(self, slot: Slot, joint_gain: Array, share: float, decisive: bool = False) -> bool:
        """True where the gain (n,) [N m]^2 is of practical size on enough of the joints on which the effect acts.

        A gain elsewhere comes from what the effect allows the others to do: a proxy, unless it is ``decisive``.
        """
        counted = np.ones(self.evidence.n, bool) if decisive else self.evidence.acts(slot)
        return int(np.sum((joint_gain > self._bar(share)) & counted)) >= self.needed(slot)


def rank(judge: Judge, current: Sequence[Slot], candidates: Sequence[Slot], before: Array) -> list[Candidate]:
    """Evidence table of one step, best first. ``before`` (blocks, n): held-out errors of the current slots.

    All fits are held physical, so that what cannot exist never wins.
    """
    evidence = judge.evidence
    pressed = evidence.constrained(current)
    held: dict[Slot, Array] = {}
    for slot in candidates:
        if any(same_place(slot, other) for other in current):
            continue
        if pressed and any(same_place(slot, other) for other in held):
            continue  # every fit takes a while then; its settings are chosen afterwards
        held[slot] = evidence.held_out([*current, slot], physical=True)
    order = sorted(held, key=lambda s: (float(judge.score(held[s]).sum()), s.family().size, _key(s)))
    rows = {s: _judged(judge, s, before, held[s]) for s in order}
    # Of those that may be named the best, and of its rivals the simplest; without any, the same of all.
    pool = [s for s in order if rows[s].accepted] or order
    if not pool:
        return []
    rivals = [s for s in pool if judge.as_good(held[s], held[pool[0]])]
    chosen = min(rivals, key=lambda s: (s.family().size, float(judge.score(held[s]).sum()), _key(s)))
    return [rows[chosen], *(rows[s] for s in order if s != chosen)]


def _judged(judge: Judge, slot: Slot, before: Array, errors: Array) -> Candidate:
    """The row of ``slot`` in the evidence table, from held-out errors (blocks, n) without and with it."""
    total = float(judge.evidence.samples[judge.evidence.samples >= 20].sum()) or 1.0
    difference = judge.score(before) - judge.score(errors)
    gain, error = float(difference.sum()), judge.standard_error(difference)
    joint_gain = judge.mean_square(before) - judge.mean_square(errors)
    # Ten free numbers find something in any few runs: a body must be surer.
    sureness = judge.settings.gain_in_errors * (1.5 if slot.family().size == 10 else 1.0)
    certain = gain > sureness * error and gain > 0
    accepted = certain and judge.matters(slot, joint_gain, judge.settings.floor_share, gain > DECISIVE * error)
    return Candidate(
        slot,
        float(judge.score(errors).sum()) / total,
        gain / total,
        error / total,
        tuple(float(g) for g in joint_gain),
        accepted,
        "accepted" if accepted else ("too small to matter" if certain else "within uncertainty"),
    )


def _key(slot: Slot) -> tuple[str, int, str]:
    return slot.effect, -1 if slot.joint is None else slot.joint, repr(slot.settings)
