"""Test runs of another set-up than the training runs: another tool, mounting or clock.

A name is then contradicted by runs that say nothing of it, and the training runs know of no fault. What may be another
from one recording to the next (``between_runs`` of a family) is therefore fitted to the test runs alone, on top of the
model as found, and judged on parts of them. It decides nothing: errors stay those of the model as found, and names stay
contradicted. (Found on two logs of a WAM of which one, it seems, was recorded with a hand: four kilograms more on the
elbow were named, the test runs contradicted them, and the reason given was the range of their motion.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_dynamics.effects import Term, catalogue, family
from hybrid_dynamics.effects.units import unit_of
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.confirm import moving_errors
from hybrid_dynamics.loop.diagnosis import rms_in_motion
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.runs import SURE
from hybrid_dynamics.loop.trace import Judge

#: Share of what the model leaves of the test runs beyond the floors that a set-up has to take: half is left (rms).
TAKES = 0.75
#: A parameter is told where it is known so many times better than its size.
KNOWN = 3.0


@dataclass(frozen=True)
class OtherSetup:
    """``what`` is different in the test runs, one clause; ``share`` that it takes of the mean square which the model
    leaves of them."""

    what: str
    share: float

    @property
    def note(self) -> str:
        """One line, with the remedy."""
        return (
            f"{self.what}: that takes {self.share:.0%} of what the model leaves of them; learn from and test on runs "
            "of one tool, mounting and clock, or ask about each set-up by itself"
        )


def other_setup(judge: Judge, model: Model, tests: Sequence[Run]) -> OtherSetup | None:
    """How the set-up of ``tests`` differs from the one that ``model`` was learned in; None where nothing shows that.

    It has to take :data:`TAKES` of the held-out error beyond the floors, and to be sure of that.
    """
    robot, moving = model.completed_robot, judge.floor > 0
    told: dict[Term, tuple[str, tuple[str, ...]]] = {}
    for kind in map(family, catalogue(everything=True)):
        if kind.between_runs is not None:
            (term, *_) = kind.terms(robot, moving, judge.settings.options)
            # What was taken off since is less of what the link has, and no body of its own.
            told[kind.twin(term, robot) or term] = kind.between_runs
    evidence = Evidence.of(model, tests, list(told), judge.settings).weigh(judge.floor).fold_by_time()
    here, nothing = judge.over(evidence), evidence.held([], physical=True)
    beyond = max(nothing.score - float(evidence.samples[moving].sum()), 0.0)
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
    return OtherSetup(_clause(model, refit(evidence, [best]).model(), tests, *told[best]), 1.0 - left / nothing.score)


def _clause(model: Model, otherwise: Model, tests: Sequence[Run], words: str, names: Sequence[str]) -> str:
    """``words`` with what is known of the parameters ``names`` of the effect that ``otherwise`` has beyond ``model``,
    and of its torque."""
    pairs = zip(moving_errors(model, tests), moving_errors(otherwise, tests), strict=True)
    torque = rms_in_motion([before - after for before, after in pairs], tests)
    most = int(np.argmax(torque))
    effect = otherwise.effects[len(model.effects)]
    known = [
        f"{name} {effect.parameters[name]:+.3g} +- {effect.std_errors[name]:.2g} {unit_of(effect, name, ())}"
        for name in names
        if abs(effect.parameters[name]) > KNOWN * effect.std_errors[name] > 0
    ]
    told = "; ".join([f"{torque[most]:.2g} N m rms on {model.robot.joint_names[most]}", *known])
    return f"the test runs look as if {words} than in the training runs ({told})"
