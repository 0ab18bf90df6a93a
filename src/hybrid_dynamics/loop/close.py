"""Close the loop: trace what is missing, add it, re-fit, until nothing is left; report before and after."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from hybrid_dynamics.check import checked
from hybrid_dynamics.effects import Effect, Slot, family
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop.augment import Step, choose_signs, effects_of, model_of, refit, search
from hybrid_dynamics.loop.diagnosis import errors_of, moving_rms, rounded, validate_diagnosis, verdict_of
from hybrid_dynamics.loop.disturbances import describe, disturbances
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.identifiability import inconsistent, indistinguishable, undetermined
from hybrid_dynamics.loop.model import Model, effect_to_json
from hybrid_dynamics.loop.noise import noise_floor, rich_residuals
from hybrid_dynamics.loop.process import Run, moving_joints, process
from hybrid_dynamics.loop.runs import pool, split_by_run, whole_of
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.loop.trace import Judge, same_place
from hybrid_dynamics.loop.unexplained import expression_of
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]


#: How far the filters carry a moment to either side, in periods of their cut-off.
KNOCK_REACH = 2.0


@dataclass(frozen=True)
class LoopResult:
    """``model``: the completed one; ``stages``: the start, then after each named effect; ``steps``: the evidence.

    >>> from hybrid_dynamics import LoopSettings, Robot, close_loop, read_log
    >>> robot = Robot.from_urdf("robot.urdf")
    >>> train = [read_log("train_1.parquet", robot.joint_names)]
    >>> friction = LoopSettings(effects=("viscous_friction", "coulomb_friction"))
    >>> result = close_loop(robot, train, [], friction)  # without a test run the end of the training run is held out
    >>> len(result.stages) == 1 + len(result.model.effects), len(result.test)
    (True, 1)
    """

    model: Model
    diagnosis: dict[str, Any]
    steps: tuple[Step, ...]
    stages: tuple[Model, ...]
    train: tuple[Run, ...]
    test: tuple[Run, ...]
    floor: Array
    notes: tuple[str, ...]


def close_loop(
    robot: Robot,
    train: Sequence[Trajectory],
    test: Sequence[Trajectory],
    settings: LoopSettings | None = None,
    start: Model | None = None,
    progress: Progress | None = None,
) -> LoopResult:
    """Find what ``robot`` (or the model ``start``) lacks on ``train``, prove it on ``test``.

    ``train`` and ``test`` hold ``q tau`` (``dq`` where the log has it) on a uniform grid. Without test runs the last
    part of every training run is held out. Raises :class:`InputError` where no verdict can be given.

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
    # One thread: matrices are small, and the same input gives the same digits on every machine load.
    with threadpool_limits(1):
        return _close(robot, list(train), list(test), settings or LoopSettings(), start or Model(robot), progress)


def _close(
    robot: Robot,
    train: list[Trajectory],
    test: list[Trajectory],
    settings: LoopSettings,
    base: Model,
    progress: Progress | None,
) -> LoopResult:
    tell = progress or (lambda stage, share: None)
    if not train:
        raise InputError("no training run is given; expected at least one log with positions and torques")
    tell("looking at the logs", 0.0)
    plausible = checked(base, train, test)
    train, test, notes = _hold_out(list(plausible.train), list(plausible.test), settings)
    notes += plausible.notes

    tell("reading the motion", 0.05)
    runs = [process(t, base.completed_robot, settings.process) for t in train]
    tests = [process(t, base.completed_robot, settings.process) for t in test]
    moving = moving_joints(runs, settings.process)
    if not moving.any():
        raise InputError(
            f"no joint moves more than {settings.process.moving_range} rad in the training runs; expected logs of a "
            "robot in motion"
        )
    slots = _candidates(base, moving, settings)
    tell("computing what each effect would do", 0.15)
    evidence = Evidence(base, runs, slots, settings)
    tell("measuring the noise", 0.4)
    notes += _leave_out_knocks(evidence)
    floor = noise_floor(evidence)
    torque = np.concatenate([run.tau for run in runs])
    least = settings.resolution * np.maximum(np.sqrt(np.mean(torque**2, axis=0)), 1e-9)
    floor = np.where(evidence.samples >= 20, np.maximum(floor, least), 0.0)
    evidence.weights = np.where(floor > 0, 1.0 / np.where(floor > 0, floor, 1.0) ** 2, 0.0)
    judge = Judge(evidence, settings, floor, torque.var(axis=0))

    tell("tracing", 0.5)
    count = 0

    def report(step: Step) -> None:
        nonlocal count
        count += 1
        what = "" if step.slot is None else f" {step.slot.effect}"
        tell(f"{step.action}{what}", min(0.5 + 0.02 * count, 0.85))

    steps = search(judge, slots, report)
    seen = floor > 0
    tolerated = np.sqrt(1 + settings.floor_tolerance**2) * floor
    torn: list[Slot] = []
    if np.any(seen & (np.array(steps[-1].held_out) > tolerated)):
        tell("comparing the runs", 0.85)
        further = split_by_run(judge, steps[-1].slots, slots, report)
        steps += further
        if further:
            torn = list(steps[-1].slots)
            notes.append("the runs disagree: a whole-robot effect has its own parameters in every training run")
        elif len(runs) > 1:
            evidence.fold_by_run()
    tell("asking what the data cannot tell", 0.9)
    if torn:
        chosen, x = pool(judge, torn)
        held = np.sqrt(judge.mean_square(evidence.held_out(torn, physical=True)))
    else:
        chosen = choose_signs(judge, _drop_guesses(judge, list(steps[-1].slots)))
        x = refit(evidence, chosen)
        held = np.sqrt(judge.mean_square(evidence.held_out(chosen, physical=True)))
    # The rich model bends less to a residual from which the named effects are already gone.
    floor = np.where(seen, np.maximum(np.minimum(floor, noise_floor(evidence, chosen, x)), least), 0.0)
    alternatives = indistinguishable(judge, chosen, slots)
    disagreeing = inconsistent(judge, chosen, x, whole_of(torn))
    open_parameters = {s: undetermined(evidence, chosen, s) for s in chosen}

    models = [base, *(model_of(evidence, chosen[: k + 1]) for k in range(len(chosen)))]
    if torn:
        models[-1] = base.adding(effects_of(evidence, chosen, x, evidence.covariance(chosen, x)))
    model = models[-1]
    notes += model.outrun(np.concatenate([run.motion.dq for run in tests]))
    tolerated = np.sqrt(1 + settings.floor_tolerance**2) * floor
    explained = ~seen | (held <= tolerated)
    # Of what is left on held-out samples, the share that is not noise.
    left = 1.0 - np.minimum(floor / np.where(held > 0, held, 1.0), 1.0) ** 2

    tell("describing what is left", 0.95)
    unexplained = [
        {
            "joint": robot.joint_names[j],
            "share_of_residual_variance": float(left[j]),
            "expression": expression_of(model, runs, int(j), settings.evaluations),
        }
        for j in np.flatnonzero(~explained)
    ]
    rms = [moving_rms(m, tests) for m in models]
    entries = []
    for k, (slot, effect) in enumerate(zip(chosen, model.effects[len(base.effects) :], strict=True)):
        entry = effect_to_json(effect)
        entry["indistinguishable_from"] = alternatives.get(slot, [])
        if open_parameters[slot]:
            entry["undetermined_parameters"] = open_parameters[slot]
        if slot in disagreeing:
            entry["inconsistent_between_runs"] = disagreeing[slot]
            which = ", ".join(d["parameter"] for d in disagreeing[slot])
            notes.append(f"{slot.effect}{_where(robot, slot)}: {which} differ between runs beyond their uncertainty")
        notes += _change(base, effect)
        entry["test_rmse_before"] = [float(v) for v in rms[k]]
        entry["test_rmse_after"] = [float(v) for v in rms[k + 1]]
        entries.append(entry)
    diagnosis = {
        "schema": 1,
        "robot": robot.name,
        "joints": list(robot.joint_names),
        "verdict": verdict_of(bool(chosen), explained),
        "effects": entries,
        "error": _before_after(base, model, runs, tests, False),
        "error_moving": _before_after(base, model, runs, tests, True),
        "noise_floor": [float(v) for v in floor],
        "unexplained": unexplained,
        "not_identifiable": [
            {
                "joint": robot.joint_names[j],
                "why": "the joint never moves in the training runs; its effects are not sought",
            }
            for j in np.flatnonzero(~moving)
        ],
        "notes": notes,
    }
    diagnosis = rounded(diagnosis)
    validate_diagnosis(diagnosis)
    tell("done", 1.0)
    return LoopResult(model, diagnosis, tuple(steps), tuple(models), tuple(runs), tuple(tests), floor, tuple(notes))


def _candidates(base: Model, moving: NDArray[np.bool_], settings: LoopSettings) -> list[Slot]:
    """Places effects could take; friction that ``base`` has already changes by its amount, not by its width."""
    robot, options = base.completed_robot, settings.options
    slots = [s for name in settings.families for s in family(name).slots(robot, moving, options)]
    own = [effect.slot(base.robot) for effect in base.effects]
    own = [s for s in dict.fromkeys(own) if s.family().scope == "joint" and moving[s.index]]
    return [
        *(s for s in slots if not any(same_place(s, o) for o in own)),
        *(o for o in own if o.effect in settings.families),
    ]


def _change(base: Model, effect: Effect) -> list[str]:
    """What became of a joint's effect that ``base`` has already; bodies have their whole inertia in the table."""
    slot = effect.slot(base.robot)
    kind = slot.family()
    old = [e for e in base.effects if e.slot(base.robot) == slot and kind.scope == "joint"]
    return [
        f"{effect.effect} of {effect.joints[0]}: {p.name} changed from {was:.4g} to "
        f"{was + effect.parameters[p.name]:.4g} {p.unit} since the starting model"
        for p in kind.parameters
        if old and (was := sum(e.parameters[p.name] for e in old)) != 0
    ]


def _leave_out_knocks(evidence: Evidence) -> list[str]:
    """Let moments that are no property of the robot count no more; one line for each."""
    found = [
        d
        for r, residual in enumerate(rich_residuals(evidence))
        for d in disturbances(
            r, evidence.runs[r].time, residual, evidence.mask[r], KNOCK_REACH / evidence.runs[r].cutoff
        )
    ]
    for d in found:
        evidence.leave_out(d.run, slice(d.start, d.stop))
    return describe(found, [run.name for run in evidence.runs])


def _where(robot: Robot, slot: Slot) -> str:
    return "" if slot.joint is None else f" of {robot.joint_names[slot.joint]}"


def _before_after(base: Model, model: Model, runs: list[Run], tests: list[Run], moving: bool) -> dict[str, Any]:
    return {
        name: {"before": errors_of(base, part, moving), "after": errors_of(model, part, moving)}
        for name, part in (("train", runs), ("test", tests))
    }


def _hold_out(
    train: list[Trajectory], test: list[Trajectory], settings: LoopSettings
) -> tuple[list[Trajectory], list[Trajectory], list[str]]:
    """Test runs where there are none: the last part of every training run, after a gap."""
    notes = []
    if not test:
        kept = []
        for run in train:
            rows = len(run.time)
            cut = int((1 - settings.held_out_share) * rows)
            gap = min(int(settings.held_out_gap / run.dt), rows // 10)
            kept.append(run.rows(slice(0, cut)))
            test.append(replace(run.rows(slice(cut + gap, rows)), split="test", name=f"{run.name} (held out)"))
        train = kept
        notes.append(
            f"no test run is given: the last {settings.held_out_share:.0%} of every training run are held out; whether "
            "the result carries over to other motions is not shown"
        )
    if len(train) == 1:
        notes.append(
            f"one training run only: candidates are validated on {settings.time_folds} parts of it in turn; what is "
            "particular to this run cannot be told from what belongs to the robot"
        )
    return train, test, notes


def _drop_guesses(judge: Judge, chosen: list[Slot]) -> list[Slot]:
    """Take back single-joint names on joints where more than half of the excess over the floor stays."""
    evidence = judge.evidence
    before = judge.mean_square(evidence.held_out([]))
    after = judge.mean_square(evidence.held_out(chosen, physical=True))
    floor = judge.floor**2
    guessed = (after - floor) > np.maximum(0.5 * (before - floor), judge.settings.floor_tolerance**2 * floor)
    kept = [s for s in chosen if s.family().scope != "joint" or not guessed[int(s.joint or 0)]]
    if len(kept) != len(chosen):
        refit(evidence, kept)
    return kept
