"""What is missing, found on the training runs alone: both ends of the search, the better one, what is surely there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Effect, Slot
from hybrid_dynamics.loop.augment import effects_of, model_of, refit
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.prune import choose, from_everything, keep_sure
from hybrid_dynamics.loop.runs import pool, split_by_run, whole_of
from hybrid_dynamics.loop.search import Step, choose_signs, search
from hybrid_dynamics.loop.trace import Judge

Array = NDArray[np.float64]

#: A joint whose held-out mean square exceeds that of the floor by this share has something left to find.
LEFT = 0.25


@dataclass(frozen=True)
class Found:
    """``slots`` and their coordinates ``x``; ``torn``: those whose parameters differ between runs; ``steps``."""

    slots: list[Slot]
    x: Array
    torn: list[Slot]
    steps: list[Step]
    notes: list[str]

    def effects(self, judge: Judge, covariance: bool = True) -> list[Effect]:
        """With published parameters and standard errors."""
        evidence = judge.evidence
        return effects_of(evidence, self.slots, self.x, evidence.covariance(self.slots, self.x) if covariance else None)

    def model(self, judge: Judge, slots: Sequence[Slot], covariance: bool = True) -> Model:
        """The completed model with ``slots`` of these alone: re-fitted, but where runs disagree."""
        if not slots:
            return judge.evidence.base
        if not self.torn:
            return model_of(judge.evidence, slots, covariance)
        kept = [e for s, e in zip(self.slots, self.effects(judge, covariance), strict=True) if s in slots]
        return judge.evidence.base.adding(kept)


def find(judge: Judge, candidates: Sequence[Slot], report: Callable[[Step], None]) -> Found:
    """Search from everything and from nothing, keep the better end, then only what is surely there."""
    evidence = judge.evidence
    looked = len({(s.effect, s.joint) for s in candidates})
    notes: list[str] = []
    everything = from_everything(judge, candidates, report)
    if everything:
        everything += search(judge, candidates, report, everything[-1].slots)
    nothing = search(judge, candidates, report)
    ends = [nothing[-1].slots] + ([everything[-1].slots] if everything else [])
    chosen = choose(judge, ends)
    steps = nothing if list(nothing[-1].slots) == chosen else everything
    held = judge.mean_square(evidence.held(chosen, physical=True))
    torn: list[Slot] = []
    if len(evidence.runs) > 1 and np.any((judge.floor > 0) & (held > (1 + LEFT) * judge.floor**2)):
        further = split_by_run(judge, chosen, candidates, report)
        if further:
            steps = [*steps, *further]
            notes.append("the runs disagree: a whole-robot effect has its own parameters in every training run")
            parts = list(steps[-1].slots)
            chosen, x = pool(judge, parts)
            return Found(chosen, x, whole_of(parts), steps, notes)
        evidence.fold_by_run()
    refit(evidence, chosen)
    chosen, _, weak = keep_sure(judge, _drop_guesses(judge, chosen), looked, report)
    chosen = choose_signs(judge, chosen)
    return Found(chosen, refit(evidence, chosen), torn, [*steps, *weak], notes)


def _drop_guesses(judge: Judge, chosen: list[Slot]) -> list[Slot]:
    """Take back single-joint names on joints where more than half of the excess over the floor stays."""
    evidence = judge.evidence
    before = judge.mean_square(evidence.held([]))
    after = judge.mean_square(evidence.held(chosen, physical=True))
    floor = judge.floor**2
    guessed = (after - floor) > np.maximum(0.5 * (before - floor), LEFT * floor)
    kept = [s for s in chosen if s.family().scope != "joint" or s.joint is None or not guessed[s.joint]]
    if len(kept) != len(chosen):
        refit(evidence, kept)
    return kept
