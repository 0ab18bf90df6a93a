"""Test runs of another set-up than the training runs: another tool, mounting or clock.

A name is then contradicted by runs that say nothing of it, and the training runs know of no fault. What may be another
from one recording to the next (``between_runs`` of a family) is therefore fitted to the test runs alone, on top of the
model as found, and judged on parts of them. It decides nothing: errors stay those of the model as found, and names stay
contradicted. (Found on two logs of a WAM of which one, it seems, was recorded with a hand: four kilograms more on the
elbow were named, the test runs contradicted them, and the reason given was the range of their motion.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid_dynamics.effects import Term, catalogue, family
from hybrid_dynamics.effects.units import unit_at, unit_of
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.confirm import moving_errors
from hybrid_dynamics.loop.diagnosis import rms_in_motion
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.floor import FEWEST_ROWS
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.runs import SURE
from hybrid_dynamics.loop.trace import Judge

#: Share of what the model leaves of the test runs beyond the floors that a set-up has to take: half is left (rms).
TAKES = 0.75
#: It is asked of samples at positions and speeds that the joint had in the training runs, and of a quarter of all at
#: least: elsewhere a law that the model lacks looks like a load, too (of nine small arms with a cubic spring, learned
#: from on one side and tested on the other, it did on all).
BEEN_THERE = 0.25
#: A parameter is told where it is known so many times better than its size.
KNOWN = 3.0
#: Test runs up to which each is asked by itself where all together show nothing.
FEW = 6


@dataclass(frozen=True)
class OtherSetup:
    """``what`` is different in the test runs, one clause; ``share`` that it takes of the mean square which the model
    leaves of them; ``misread``: the signals are, and not the arm."""

    what: str
    share: float
    misread: bool

    @property
    def note(self) -> str:
        """One line, with the remedy."""
        return (
            f"{self.what}: that takes {self.share:.0%} of what the model leaves where the training runs have been; "
            "learn from and test on runs of one tool, mounting and clock, or ask about each set-up by itself"
        )


def other_setup(judge: Judge, model: Model, tests: Sequence[Run]) -> OtherSetup | None:
    """How the set-up of ``tests`` differs from the one that ``model`` was learned in, or that of one of them; None
    where nothing shows that.

    It has to take :data:`TAKES` of the held-out error beyond the floors, and to be sure of that.
    """
    found = _differs(judge, model, tests, "the test runs look")
    if found is None and 1 < len(tests) <= FEW:
        each = (_differs(judge, model, [run], f"run {run.name} looks") for run in tests)
        found = next((one for one in each if one is not None), None)
    return found


def _been_there(run: Run, train: Sequence[Run]) -> Run:
    """``run`` of which only rows count at which a joint is where, and as fast as, it was in ``train``."""
    inside = run.mask
    for name in ("q", "dq"):
        seen, asked = np.concatenate([getattr(r, name) for r in train]), getattr(run, name)
        inside = inside & (asked >= seen.min(axis=0)) & (asked <= seen.max(axis=0))
    return replace(run, mask=inside)


def _differs(judge: Judge, model: Model, runs: Sequence[Run], look: str) -> OtherSetup | None:
    tests = [_been_there(run, judge.evidence.runs) for run in runs]
    robot, moving = model.completed_robot, judge.floor > 0
    told: dict[Term, tuple[str, tuple[str, ...]]] = {}
    for kind in map(family, catalogue(everything=True)):
        if kind.between_runs is not None:
            (term, *_) = kind.terms(robot, moving, judge.settings.options)
            # What was taken off since is less of what the link has, and no body of its own.
            told[(kind.twin(term, robot) if kind.detachable else None) or term] = kind.between_runs
    evidence = Evidence.of(model, tests, list(told), judge.settings).weigh(judge.floor).fold_by_time()
    samples = float(evidence.samples[moving].sum())
    moved = sum(int(np.sum(run.mask[:, moving])) for run in runs)
    if samples < BEEN_THERE * moved or samples < FEWEST_ROWS:
        return None
    here, nothing = judge.over(evidence), evidence.held([], physical=True)
    beyond = max(nothing.score - samples, 0.0)
    best, left = None, np.inf
    for term in told:
        held = evidence.held([term], physical=True)
        # By its tangent it is sure; how much it takes, its law says.
        least = refit(evidence, [term]).evidence.held([term], physical=True).score
        sure = here.gain(held, nothing).surer_than(SURE)
        if sure and nothing.score - least > TAKES * beyond and least < left:
            best, left = term, least
    if best is None:
        return None
    clause = _clause(model, refit(evidence, [best]).model(), tests, *told[best])
    return OtherSetup(f"{look} as if {clause}", 1.0 - left / nothing.score, best.family().changes_reading)


def _clause(model: Model, otherwise: Model, tests: Sequence[Run], words: str, names: Sequence[str]) -> str:
    """``words`` with what is known of the parameters ``names`` of the effect that ``otherwise`` has beyond ``model``,
    and of its torque."""
    pairs = zip(moving_errors(model, tests), moving_errors(otherwise, tests), strict=True)
    torque = rms_in_motion([before - after for before, after in pairs], tests)
    most = int(np.argmax(torque))
    effect, joint, slides = otherwise.effects[len(model.effects)], model.robot.joint_names[most], model.robot.prismatic
    known = [
        f"{name} {effect.parameters[name]:.3g} +- {effect.std_errors[name]:.2g} {unit_of(effect, name, slides)}"
        for name in names
        if abs(effect.parameters[name]) > KNOWN * effect.std_errors[name] > 0
    ]
    told = "; ".join([f"{torque[most]:.2g} {unit_at('N m', joint, slides)} rms on {joint}", *known])
    return f"{words} than in the training runs ({told})"
