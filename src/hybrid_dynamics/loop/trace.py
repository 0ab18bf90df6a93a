"""From what the model leaves to the next named cause: candidates compete on held-out runs.

One step ranks all candidate slots by the held-out error of a joint re-fit of the model with that slot. Among those
within one standard error of the best the simplest wins (Breiman et al. 1984); it is accepted when its gain is certain
and large enough to matter.
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

    def needed(self, slot: Slot) -> int:
        """On how many joints an effect must show: a whole-robot effect seen on one joint is a proxy for a local one."""
        if slot.family().scope != "robot":
            return 1
        return max(min(2, int((self.evidence.samples >= 20).sum())), 1)

    def matters(self, slot: Slot, joint_gain: Array, share: float, decisive: bool = False) -> bool:
        """True where the gain (n,) [N m]^2 is of practical size on enough of the joints on which the effect acts.

        A gain elsewhere comes from what the effect allows the others to do: a proxy, unless it is ``decisive``.
        """
        bar = np.maximum(share * self.floor**2, self.settings.torque_share * self.torque_variance)
        counted = np.ones(self.evidence.n, bool) if decisive else self.evidence.acts(slot)
        return int(np.sum((joint_gain > bar) & counted)) >= self.needed(slot)


def rank(judge: Judge, current: Sequence[Slot], candidates: Sequence[Slot], before: Array) -> list[Candidate]:
    """Evidence table of one step, best first. ``before`` (blocks, n): held-out errors of the current slots.

    Bodies and nonlinear friction are first fitted free; those that come out on top are judged again held physical, so
    that what cannot exist never wins. Where the current model already wants the impossible, that alone would make
    every candidate look good: then all are held physical.
    """
    evidence, settings = judge.evidence, judge.settings
    total = float(evidence.samples[evidence.samples >= 20].sum()) or 1.0
    score_before = judge.score(before)
    pressed = evidence.constrained(current)
    held: dict[Slot, Array] = {}
    for slot in candidates:
        if any(same_place(slot, other) for other in current):
            continue
        if pressed and any(same_place(slot, other) for other in held):
            continue  # its width is chosen afterwards
        held[slot] = evidence.held_out([*current, slot], physical=pressed)
    settled: set[Slot] = {s for s in held if pressed or not evidence.may_break_physics(s)}
    order: list[Slot] = []
    while True:
        order = sorted(held, key=lambda s: (float(judge.score(held[s]).sum()), s.family().size, _key(s)))
        top = order[0] if order else None
        if top is None:
            return []
        best = judge.score(held[top])
        rivals = [
            s
            for s in order
            if float((judge.score(held[s]) - best).sum()) <= judge.standard_error(judge.score(held[s]) - best)
        ]
        open_ones = [s for s in rivals if s not in settled]
        if not open_ones:
            break
        held[open_ones[0]] = evidence.held_out([*current, open_ones[0]], physical=True)
        settled.add(open_ones[0])
    chosen = min(rivals, key=lambda s: (s.family().size, float(judge.score(held[s]).sum()), _key(s)))
    table = []
    for slot in [chosen, *(s for s in order if s != chosen)]:
        difference = score_before - judge.score(held[slot])
        gain, error = float(difference.sum()), judge.standard_error(difference)
        joint_gain = judge.mean_square(before) - judge.mean_square(held[slot])
        # Ten free numbers find something in any few runs: a body must be surer.
        sureness = settings.gain_in_errors * (1.5 if slot.family().size == 10 else 1.0)
        certain = gain > sureness * error and gain > 0
        matters = judge.matters(slot, joint_gain, settings.floor_share, gain > DECISIVE * error)
        accepted = certain and matters
        reason = "accepted" if accepted else ("too small to matter" if certain else "within uncertainty")
        table.append(
            Candidate(
                slot,
                float(judge.score(held[slot]).sum()) / total,
                gain / total,
                error / total,
                tuple(float(g) for g in joint_gain),
                accepted,
                reason,
            )
        )
    return table


def _key(slot: Slot) -> tuple[str, int, str]:
    return slot.effect, -1 if slot.joint is None else slot.joint, repr(slot.settings)
