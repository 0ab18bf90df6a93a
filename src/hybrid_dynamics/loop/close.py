"""Close the loop: read the motion, gather the evidence, find what is missing, ask the test runs, say it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from importlib import import_module

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from hybrid_dynamics.check import Checked, checked, refuse_hard, told_by_model
from hybrid_dynamics.effects import Effect, Term, family
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop.bandwidth import narrowed
from hybrid_dynamics.loop.carried import carried_over
from hybrid_dynamics.loop.confirm import confirm
from hybrid_dynamics.loop.contact import pushed_in_tests
from hybrid_dynamics.loop.describe import describe_result
from hybrid_dynamics.loop.diagnosis import Diagnosis, predict_run
from hybrid_dynamics.loop.everything import better_with_everything
from hybrid_dynamics.loop.find import find, with_contacts
from hybrid_dynamics.loop.floor import Floor, examine
from hybrid_dynamics.loop.found import Found
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.mounting import as_found, as_mounted, held_upright
from hybrid_dynamics.loop.other_setup import other_setup
from hybrid_dynamics.loop.placeholders import with_unmatched, without_placeholders
from hybrid_dynamics.loop.prepare import Logs, gather, read_motion, resolution
from hybrid_dynamics.loop.process import Run, process
from hybrid_dynamics.loop.search import Step
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.loop.speeds import truer_speeds
from hybrid_dynamics.loop.spoiled import spoiled
from hybrid_dynamics.loop.standing import beyond_friction
from hybrid_dynamics.loop.stretches import spread
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Progress

#: Of the share that is held out of a run, what is left of it at least: a gap comes before it, and a rest may end it.
_LEAST_HELD_OUT = 0.5


@dataclass(frozen=True)
class LoopResult:
    """``model``: the completed one, without what the test runs contradict; ``found``: with it; ``models``: the start,
    then after each named effect; ``steps``: the evidence; ``floor``: noise and alarm of every joint.

    >>> from hybrid_dynamics import LoopSettings, Robot, close_loop, read_log
    >>> robot = Robot.from_urdf("robot.urdf")
    >>> train = [read_log("train_1.parquet", robot.joint_names)]
    >>> friction = LoopSettings(effects=("viscous_friction", "coulomb_friction"))
    >>> result = close_loop(robot, train, [], friction)  # without a test run the end of the training run is held out
    >>> len(result.models) == 1 + len(result.model.effects), len(result.test)
    (True, 1)
    """

    model: Model
    found: Model
    diagnosis: Diagnosis
    steps: tuple[Step, ...]
    models: tuple[Model, ...]
    train: tuple[Run, ...]
    test: tuple[Run, ...]
    floor: Floor


def close_loop(
    robot: Robot,
    train: Iterable[Trajectory],
    test: Iterable[Trajectory],
    settings: LoopSettings | None = None,
    start: Model | None = None,
    progress: Progress | None = None,
    described: Sequence[Effect] = (),
) -> LoopResult:
    """Find what ``robot`` (or the model ``start``) lacks on ``train``, prove it on ``test``.

    ``train`` and ``test`` hold ``q tau`` (``dq`` where the log has it) on a uniform grid; they are taken one by one, so
    that runs read as they are asked for may be longer than memory. Without test runs the last part of every training
    run is held out. ``described``: friction that the URDF gives
    (:func:`~hybrid_dynamics.effects.urdf_dynamics.urdf_dynamics`); it belongs to the start, but for dry friction of
    which the torque holds less than half, or more than twice. Raises :class:`InputError` where no verdict can be given.

    >>> from hybrid_dynamics import Robot, close_loop, read_log
    >>> robot = Robot.from_urdf("robot.urdf")
    >>> train = [read_log(f"train_{k}.parquet", robot.joint_names) for k in (1, 2)]
    >>> test = [read_log("test_1.parquet", robot.joint_names, split="test")]
    >>> result = close_loop(robot, train, test)
    >>> for effect in result.model.effects:
    ...     print(effect.effect, *effect.joints, *(f"{v:.2f}" for v in effect.parameters.values()))
    viscous_friction shoulder 3.00
    coulomb_friction elbow 1.50
    """
    # One thread: matrices are small, and the same input gives the same digits on every machine load. A library that
    # comes later brings threads of its own, so it is loaded before they are limited.
    import_module("sklearn.ensemble")
    with threadpool_limits(1):
        return _close(
            robot,
            train,
            test,
            settings or LoopSettings(),
            start or Model(robot, tuple(described)),
            progress or (lambda share, what: None),
            described if start is None else (),
        )


def _close(
    robot: Robot,
    train: Iterable[Trajectory],
    test: Iterable[Trajectory],
    settings: LoopSettings,
    base: Model,
    progress: Progress,
    described: Sequence[Effect],
) -> LoopResult:
    learned_from, long = spread(train, settings.longest, "training")
    if not learned_from:
        raise InputError("no training run is given; expected at least one log with positions and torques")
    asked, long_too = spread(test, settings.longest, "test")
    progress(0.0, "looking at the logs")
    plausible = checked(base, learned_from, asked)
    share = 1.0 if plausible.test else _LEAST_HELD_OUT * settings.held_out_share
    robot_now = base.completed_robot
    first, second, of_speeds = truer_speeds(robot_now, plausible.train, plausible.test, settings.process, share)
    plausible = replace(plausible, train=first, test=second)
    processed, told = narrowed(robot_now, first, settings.process, second, share)
    settings = replace(settings, process=processed)
    given = base
    if any(family(d.effect).turns_sign for d in described):
        runs = [process(t, robot, settings.process) for t in plausible.train]
        base = without_placeholders(given, described, runs)
    searched = _looked_for(base, plausible, settings, progress)
    kept = with_unmatched(given, base, [*searched.found.terms, *searched.found.beside])
    if kept.effects != base.effects:
        base = kept
        searched = _looked_for(base, plausible, settings, progress)
    logs, terms, judge = searched.logs, searched.terms, searched.found.judge
    found = with_contacts(searched.found, logs)

    progress(0.8, "asking the test runs")
    full = found.model(found.terms)
    # What the training runs teach leaves nothing open of how the test runs are read.
    by_model = told_by_model(full, plausible.test, plausible.train)
    comparable = bool(plausible.test) and not found.inconsistent
    doubted = comparable and any(f.severity == "hard" for f in by_model)
    other = other_setup(judge, full, logs.test) if doubted else None
    if other is not None and not other.misread:
        # Another tool is no fault of a log.
        by_model = [f for f in by_model if f.severity != "hard"]
    refuse_hard(by_model)
    said = confirm(judge, base, full, found, logs.test, terms)
    runs = [*logs.train, *logs.test]
    left = [run.tau - predict_run(said.model, run) for run in runs]
    mask = [*judge.evidence.mask, *(run.mask for run in logs.test)]
    floor = examine(runs, left, mask, resolution(logs, settings), logs.rounded_away, settings)
    parts = list(zip(runs, left, mask, strict=True))
    learned, held_out = parts[: len(logs.train)], parts[len(logs.train) :]
    carried = carried_over(learned, held_out, logs.rounded_away, settings)
    if comparable and not doubted and (said.refused or carried.worse.any()):
        other = other_setup(judge, full, logs.test)
    said = replace(said, other=other.what if other else "")
    standing = beyond_friction(said.model, learned, held_out, np.where(floor.seen, floor.low, 0.0), settings)

    progress(0.9, "describing what is left")
    # Where runs disagree the evidence is of effects with parameters for every run.
    free = judge.over(judge.evidence.holding_links(1.0))
    rival = better_with_everything(free, [] if found.inconsistent else terms, said.model, logs.test, logs.rounded_away)
    worse = spoiled(judge, base, said.model, logs.test)
    only = [f"looked for {', '.join(settings.effects)} and nothing else"] if settings.effects else []
    notes = [
        *only,
        *long,
        *long_too,
        *plausible.notes,
        *(f.line for f in by_model),
        *of_speeds,
        *told,
        *logs.notes,
        *searched.notes,
        *held_upright(base, judge.evidence.base),
        *found.notes,
        *([other.note] if other else []),
        *pushed_in_tests(full, logs.test, settings),
    ]
    diagnosis, models = describe_result(
        judge, base, terms, found, full, said, floor, carried, standing, rival, worse, logs, notes
    )
    after = diagnosis.error_moving["test"].after_confirmed
    assert after is not None
    progress(1.0, "done")
    return LoopResult(
        said.model.with_misfit(after.rmse, settings.process.cutoff if told else None),
        full,
        diagnosis,
        tuple(found.steps),
        tuple(models),
        tuple(logs.train),
        tuple(logs.test),
        floor,
    )


@dataclass(frozen=True)
class _Searched:
    """What was ``found`` in ``logs`` among ``terms``; ``notes`` on what was left out."""

    logs: Logs
    terms: list[Term]
    notes: list[str]
    found: Found

    def left(self, judge: Judge) -> float:
        """Held-out mean squares of what was found, the joints weighed as by ``judge``."""
        own = self.found.judge
        held = own.evidence.held(self.found.terms, physical=True)
        return float(own.mean_square(held) @ (judge.evidence.weights * judge.evidence.samples))


def _looked_for(base: Model, plausible: Checked, settings: LoopSettings, progress: Progress) -> _Searched:
    """What ``base`` lacks, also where it is to be mounted otherwise than the log's gravity says."""
    mounted = as_mounted(base, plausible.gravity, settings)
    searched = _searched(base, mounted, plausible, settings, progress, 0.05)
    turned = as_found(base, mounted, searched.found.effects(False))
    if turned is None:
        return searched
    again = _searched(base, turned, plausible, settings, progress, 0.45)
    return min(searched, again, key=lambda s: s.left(searched.found.judge))


def _searched(
    base: Model, mounted: Model, plausible: Checked, settings: LoopSettings, progress: Progress, begun: float
) -> _Searched:
    """What ``base`` lacks, searched from ``mounted`` on: the same with its base turned, where it is mounted so."""
    progress(begun, "reading the motion")
    logs = read_motion(mounted.completed_robot, plausible.train, plausible.test, settings)
    progress(begun + 0.1, "computing what each effect would do")
    judge, terms, notes = gather(mounted, logs, settings)
    progress(begun + 0.2, "tracing")
    return _Searched(logs, terms, notes, find(judge, terms, _counted(progress, begun + 0.2, 0.8), base))


def _counted(progress: Progress, low: float, high: float) -> Callable[[Step], None]:
    """Progress that comes closer to ``high`` with every step of a search whose length nobody knows."""
    count = 0

    def report(step: Step) -> None:
        nonlocal count
        count += 1
        what = "" if step.term is None else f" {step.term.effect}"
        progress(high - (high - low) * float(np.exp(-count / 40)), f"{step.action}{what}")

    return report
