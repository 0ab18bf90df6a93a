"""From logs to evidence: runs held out, signals processed, candidates listed, outliers left out, joints weighed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Term, family
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop.blocks import FAR, REPEATED, parted
from hybrid_dynamics.loop.contact import without_contacts
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.floor import FEWEST_ROWS, difference_floor
from hybrid_dynamics.loop.hold_out import hold_out
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.noise import noise_floor, rich_residuals
from hybrid_dynamics.loop.outliers import describe, outlier_segments
from hybrid_dynamics.loop.partner import seen_together, told_apart
from hybrid_dynamics.loop.paths import paths_of
from hybrid_dynamics.loop.process import Run, moving_joints, process
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.loop.trace import Judge, same_place
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: How far the filters carry a moment to either side, in periods of their cut-off.
OUTLIER_REACH = 2.0
#: Share of samples that repeat the one before, beyond which a torque was recorded in steps wider than its noise.
MOST_REPEATS = 0.5
#: A torque whose spread is below this many of its steps is rounded along with the motion; beyond this many, what is
#: rounded away is as good as noise (Widrow, 1956: it follows the torque by exp(-2 pi^2) for a spread of one step).
STEPS, MANY_STEPS = 0.5, 1.0


@dataclass(frozen=True)
class Logs:
    """Processed runs: ``train`` is learned from, ``test`` held out; ``moving`` (n,) joints that move in ``train``.

    ``step`` (n,) [N m]: the steps in which the torque was recorded, where nothing blurs them; else 0. ``silent`` (n,):
    joints that move and whose torque never changes; they count as not moving.
    """

    train: list[Run]
    test: list[Run]
    moving: NDArray[np.bool_]
    step: Array
    silent: NDArray[np.bool_]
    notes: list[str]

    @property
    def rounding(self) -> Array:
        """(n,) [N m] standard deviation of what the steps of the torque round away."""
        return np.asarray(self.step / np.sqrt(12.0))

    @property
    def rounded_away(self) -> Array:
        """(n,) [N m] largest rms of what the steps alone may leave: half a step where the torque hardly leaves one.

        It follows the motion then, and no sample tells it from an effect.
        """
        few = np.sqrt(self.variance) < STEPS * self.step
        return np.asarray(np.where(few, self.step / 2, self.rounding))

    @cached_property
    def untested(self) -> NDArray[np.bool_]:
        """(n,) joints that move in training on too few samples of the test runs for these to say anything of them."""
        return np.asarray(self.moving & (np.sum([run.mask.sum(axis=0) for run in self.test], axis=0) < FEWEST_ROWS))

    @cached_property
    def variance(self) -> Array:
        """(n,) [N m]^2 of the training torque."""
        return np.asarray(np.concatenate([run.tau for run in self.train]).var(axis=0))


def read_motion(robot: Robot, train: Sequence[Trajectory], test: Sequence[Trajectory], settings: LoopSettings) -> Logs:
    """Process all runs; without test runs the last part of every training run is held out."""
    split = hold_out(train, test, settings)
    runs = [process(t, robot, settings.process) for t in split.train]
    tests = [process(t, robot, settings.process) for t in split.test]
    notes = split.notes
    moving = moving_joints(runs, settings.process)
    if not moving.any():
        raise InputError(
            f"no joint moves by more than {settings.process.moving_range} rad, and faster than "
            f"{settings.process.slow_speed} rad/s on {FEWEST_ROWS} samples, in the training runs; expected logs of a "
            "robot in motion, long enough at their rate"
        )
    step = torque_step(split.train)
    silent = moving & np.isinf(step)
    for joint in np.flatnonzero(silent):
        notes.append(
            f"the torque of {robot.joint_names[joint]} never changes in the training runs: nothing is said of this "
            "joint; look whether its sensor is connected and fine enough"
        )
        moving[joint] = False
        for run in [*runs, *tests]:
            run.mask[:, joint] = False
    if not moving.any():
        raise InputError(
            "the torque of every joint that moves never changes in the training runs; expected measured torque [N m]: "
            "look whether the sensors are connected and fine enough"
        )
    logs = Logs(runs, tests, moving, np.where(np.isinf(step), 0.0, step), silent, notes)
    notes += _told_untested(robot, logs, bool(test), settings)
    notes += _told_repeated(logs, len(train), bool(test), settings)
    return logs


def _told_untested(robot: Robot, logs: Logs, given: bool, settings: LoopSettings) -> list[str]:
    """A line for the joints of which the test runs (``given``, or held out) say nothing, if that is not so of all."""
    names = [robot.joint_names[j] for j in np.flatnonzero(logs.untested)]
    if names and bool(np.all(logs.untested == logs.moving)):
        where = "the test runs" if given else "the last part of the training runs, which is held out"
        remedy = (
            "give test runs in motion, or none: the end of every training run is held out then"
            if given
            else "cut off the end at which the robot rests, or give test runs in motion"
        )
        slides = " (m/s where it slides)" if robot.prismatic else ""
        raise InputError(
            f"no joint moves faster than {settings.process.slow_speed} rad/s{slides} on {FEWEST_ROWS} samples of "
            f"{where}, where what is found has to prove itself; {remedy}"
        )
    stand = "stand" if len(names) > 1 else "stands"
    told = f"{', '.join(names)}: {stand} still in the test runs, which say nothing of what is found on it"
    return [told] if names else []


def _told_repeated(logs: Logs, logs_given: int, given: bool, settings: LoopSettings) -> list[str]:
    """Lines for runs that repeat one motion, validated, or tested (where test runs are ``given``), on that alone; and
    for runs that have too little in common."""
    why = parted(logs.train)[1] if logs_given > 1 else ""
    told = []
    if why == REPEATED:
        told.append(
            f"the training runs repeat one motion: candidates are validated on {settings.time_folds} parts of it in "
            "turn; what is particular to this motion cannot be told from what belongs to the robot"
        )
    elif why == FAR:
        told.append(
            "the training runs move each its own way, too little to tell the links' torque on one from the others: "
            "candidates are validated on parts of every run; record longer runs, through more of the joints' ranges"
        )
    if not given:
        return told
    learned, held_out = np.split(paths_of([*logs.train, *logs.test]), [len(logs.train)])
    if again := [run.name for run, path in zip(logs.test, held_out, strict=True) if path in learned]:
        told.append(
            f"{', '.join(again)}: repeats the motion of a training run; whether the result carries over to other "
            "motions is not shown by it"
        )
    return told


def torque_step(runs: Sequence[Trajectory]) -> Array:
    """(n,) [N m] smallest change of the recorded torque where most samples repeat the one before; inf: none changes.

    Where noise blurs the steps (most samples differ) they are part of the noise that second differences see: 0.
    """
    changes = np.concatenate([np.abs(np.diff(run["tau"], axis=0)) for run in runs])
    repeats = np.mean(changes == 0.0, axis=0) > MOST_REPEATS
    smallest = np.min(np.where(changes > 0.0, changes, np.inf), axis=0)
    return np.asarray(np.where(repeats, smallest, 0.0))


def gather(base: Model, logs: Logs, settings: LoopSettings) -> tuple[Judge, list[Term], list[str]]:
    """Evidence for all candidates and the judge over it; notes on what was left out."""
    every = candidates(base, logs.moving, settings)
    terms = seen_together(logs.train, base.completed_robot, every)
    evidence, notes = _without_outliers(Evidence.of(base, logs.train, terms, settings))
    evidence, contacts = without_contacts(evidence)
    least, variance = resolution(logs, settings), logs.variance
    seen = evidence.samples >= FEWEST_ROWS
    # A rich model of few rows follows the noise; second differences see it whatever the model.
    low = difference_floor(logs.train, evidence.problem.base_target, evidence.mask)
    floor = np.where(seen, np.maximum(np.maximum(noise_floor(evidence), low), least), 0.0)
    # No more than the starting model leaves is noise. Where a joint moves for seconds only the rich model goes astray
    # on the parts held out: of joints that move in turn it made floors of millions of newton metres.
    nothing = evidence.held([]).joint_errors / np.maximum(evidence.samples, 1)
    floor = np.minimum(floor, np.maximum(np.sqrt(nothing), np.maximum(low, least)))
    misfit = np.zeros(evidence.n) if base.misfit is None else np.asarray(base.misfit, float)
    # What rounding takes away is no news either. Where the torque goes through many steps it is part of the noise.
    misfit = np.maximum(misfit, np.where(np.sqrt(variance) < MANY_STEPS * logs.step, logs.rounded_away, 0.0))
    judge = Judge(evidence.weigh(floor), settings, floor, variance, misfit, np.maximum(low, least), tuple(contacts))
    return judge, terms, [*notes, *told_apart(base.completed_robot, [t for t in every if t not in terms])]


def resolution(logs: Logs, settings: LoopSettings) -> Array:
    """(n,) [N m] below which no floor lies: a share of the measured torque, and what its steps round away."""
    torque = np.concatenate([run.tau for run in logs.train])
    share = settings.resolution * np.maximum(np.sqrt(np.mean(torque**2, axis=0)), 1e-9)
    return np.asarray(np.maximum(share, logs.rounding))


def candidates(base: Model, moving: NDArray[np.bool_], settings: LoopSettings) -> list[Term]:
    """Places effects could take; friction that ``base`` has already changes by its amount, not by its width."""
    robot, options = base.completed_robot, settings.options
    terms = [s for name in settings.families for s in family(name).terms(robot, moving, options)]
    # What couples joints hides behind their own friction, and so does a late torque: both are looked for from the
    # beginning, as bodies are.
    for name in settings.further:
        kind = family(name)
        if kind.scope == "joint" or kind.changes_reading:
            terms += [s for s in kind.terms(robot, moving, options) if kind.is_wide(s)]
    own = [effect.term(base.robot).as_finding for effect in base.effects]
    own = [s for s in dict.fromkeys(own) if s.family().scope == "joint" and s.joint is not None and moving[s.joint]]
    return [
        *(s for s in terms if not any(same_place(s, o) for o in own)),
        *(o for o in own if o.effect in settings.families),
    ]


def _without_outliers(evidence: Evidence) -> tuple[Evidence, list[str]]:
    """``evidence`` in which moments that are no property of the robot count no more; one line for each."""
    found = [
        d
        for r, residual in enumerate(rich_residuals(evidence))
        for d in outlier_segments(
            r,
            evidence.runs[r].time,
            evidence.runs[r].ddq,
            residual,
            evidence.mask[r],
            OUTLIER_REACH / evidence.runs[r].cutoff,
        )
    ]
    for d in found:
        evidence = evidence.leave_out(d.run, slice(d.start, d.stop))
    return evidence, describe(found, [run.name for run in evidence.runs])
