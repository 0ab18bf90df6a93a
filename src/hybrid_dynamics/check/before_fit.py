"""Plausibility before physics: what ``close-loop`` looks at before anything is fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid_dynamics.check.centres import check_centres
from hybrid_dynamics.check.clipped import check_clipped
from hybrid_dynamics.check.columns import of_each, standing
from hybrid_dynamics.check.completed import Completed, body_of
from hybrid_dynamics.check.content import check_rate
from hybrid_dynamics.check.duplicates import check_duplicates
from hybrid_dynamics.check.findings import Finding, Severity, ordered, refuse_hard
from hybrid_dynamics.check.guess import SAME_MOUNTING, angle
from hybrid_dynamics.check.known import check_known
from hybrid_dynamics.check.limits import check_angles, check_limits
from hybrid_dynamics.check.magnitude import check_magnitude
from hybrid_dynamics.check.torque import check_torque, outvoted
from hybrid_dynamics.check.velocity import check_velocity
from hybrid_dynamics.check.weight import without_weight
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.readers.glitches import MANY, repair, told
from hybrid_dynamics.readers.jumps import TWO_RUNS, find_jumps
from hybrid_dynamics.readers.resample import NO_STRETCH, resample
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory, instant
from hybrid_dynamics.types import Array


@dataclass(frozen=True)
class Checked:
    """Runs without their glitches and without a velocity that is none; what was found, worst first; ``gravity`` (3,)
    [m/s^2] in the base frame as the training torque has it."""

    train: tuple[Trajectory, ...]
    test: tuple[Trajectory, ...]
    findings: tuple[Finding, ...]
    gravity: Array

    @property
    def notes(self) -> list[str]:
        """One line a finding."""
        return [f.line for f in self.findings]


def check_before_fit(robot: Robot | Completed, runs: Sequence[Trajectory]) -> list[Finding]:
    """Findings on ``runs`` (``q tau``, perhaps ``dq``), worst first; :class:`InputError` for hard ones."""
    return list(checked(robot, runs, ()).findings)


def checked(
    robot: Robot | Completed, train: Sequence[Trajectory], test: Sequence[Trajectory], refuse: bool = True
) -> Checked:
    """Look at training and test runs on uniform grids; mend what is mended without a doubt.

    With ``refuse`` hard findings raise :class:`InputError`; without, they are among the findings. Signals that are
    missing or of another robot are refused in any case.
    """
    body = body_of(robot)
    check_shape(body, [*train, *test])
    findings: list[Finding] = []
    mended: list[Trajectory] = []
    for run in [*train, *test]:
        findings += check_clipped(run, body)
        clean, found = repair(run)
        most = max((len(g.rows) for g in found), default=0) / max(len(run.time), 1)
        severity: Severity = "warning" if most > MANY else "note"
        findings += [
            Finding("glitch", severity, line, run=run.name) for line in told(found, body.joint_names, len(run.time))
        ]
        mended.append(clean)
    findings += _not_finite(mended)
    _stop(findings, refuse)
    findings += [*check_angles(body, mended), *_jumps(body, mended)]
    if any(f.severity == "hard" for f in findings):
        _stop(findings, refuse)
        return Checked(
            tuple(mended[: len(train)]), tuple(mended[len(train) :]), tuple(ordered(findings)), standing(body)
        )
    first, second = mended[: len(train)], mended[len(train) :]
    findings += check_duplicates(first, second)
    findings += check_rate(first)
    findings += [f for f in check_rate(second) if f.code != "too_short"]
    findings += [*check_centres(body), *check_limits(body, mended)]
    gravity = standing(body)
    for part in (first, second):
        if not part:
            continue
        velocity = check_velocity(body.joint_names, part)
        findings += velocity
        if _of_no_use(velocity):
            part[:] = [run.without("dq") for run in part]
        of_torque, found_gravity = _torque(robot, part)
        of_torque = [_of_held_signals(f, part) for f in of_torque]
        if part is second and angle(found_gravity, gravity) < SAME_MOUNTING:
            of_torque = [f for f in of_torque if f.code != "mounting"]
        # What both say is told once; a hard finding is never left out.
        told_of = {(f.code, f.joint) for f in findings}
        findings += [f for f in of_torque if f.severity == "hard" or (f.code, f.joint) not in told_of]
        gravity = found_gravity if part is first else gravity
    findings = _once(findings)
    _stop(findings, refuse)
    return Checked(tuple(first), tuple(second), tuple(ordered(findings)), gravity)


def _jumps(robot: Robot, runs: Sequence[Trajectory]) -> list[Finding]:
    """Runs that are two, since their positions go on elsewhere; logs that are read from files are split there."""
    return [
        Finding(
            "jump",
            "hard",
            f"position jumps by {jump.size:.3g} from one sample to the next at t = {instant(run.time[jump.row])} s and "
            f"stays there: {TWO_RUNS}; expected one recording a run: split it there",
            run=run.name,
            joint=robot.joint_names[jump.joint],
        )
        for run in runs
        for jump in find_jumps(run)
    ]


def checked_log(model: Robot | Completed, log: Trajectory, refuse: bool = True) -> tuple[Trajectory, list[Finding]]:
    """``log`` (its own stamps) without a velocity that is none, and what was found, before ``model`` predicts along it.

    The torque, where there is one that varies, is looked at with all of the model's effects: what it knows is no fault.
    With ``refuse`` a log that cannot be of this robot as it stands raises :class:`InputError`: what is computed along
    it would be wrong without a word. Without, that is among the findings, and single wrong samples are.
    """
    body = body_of(model)
    # A log without torque is one that check looks at beside a model alone.
    options = "" if isinstance(model, Robot) else " --model MODEL"
    clean, glitches = repair(log)
    pieces = resample(clean)
    findings = check_angles(body, pieces)
    if not pieces:
        findings.append(Finding("no_stretch", "hard", NO_STRETCH, run=log.name))
    # What a slow log resolves is predicted all the same; that it is little must be known.
    slow = [replace(f, severity="warning") for f in _once(check_rate(pieces)) if f.code == "too_slow"]
    if not findings:
        findings = check_velocity(body.joint_names, pieces) + check_limits(body, pieces) + slow
        _stop(findings, refuse, options)
        if any(f.severity == "hard" for f in findings):
            pieces = [piece.without("dq") for piece in pieces]
        if "tau" in log and not slow and np.ptp(log["tau"], axis=0).any():
            of_torque = _torque(model, pieces, fixed=True)[0]
            certain = any(f.severity == "hard" for f in of_torque)
            of_torque = of_torque if certain else [*check_known(model, pieces), *of_torque]
            findings += [*check_clipped(log, body), *(_of_held_signals(f, [log]) for f in of_torque)]
    _stop(findings, refuse, options)
    if not refuse:
        findings += [
            Finding("glitch", "note", line, run=log.name) for line in told(glitches, body.joint_names, len(log.time))
        ]
    return log.without("dq") if _of_no_use(findings) else log, ordered(findings)


def _of_no_use(velocity: Sequence[Finding]) -> bool:
    """True where the derivative of q is taken instead of a velocity that is zero throughout, or of other instants."""
    return any(f.code in ("dq_zero", "dq_lag") for f in velocity)


def check_shape(robot: Robot, runs: Sequence[Trajectory]) -> None:
    """Raise :class:`InputError` for missing signals, those of another robot, no torque, and names given twice."""
    for run in runs:
        for signal in ("q", "tau"):
            if signal not in run:
                raise InputError(
                    f"run {run.name}: no signal {signal!r}; expected {signal}1 to {signal}{robot.n_joints}"
                )
        if run.n_joints != robot.n_joints:
            raise InputError(
                f"run {run.name}: holds {run.n_joints} joints; robot {robot.name} has {robot.n_joints}; give the "
                "matching URDF or lock joints"
            )
        if len(run.time) < 2:
            raise InputError(f"run {run.name}: holds {len(run.time)} samples; record a longer run")
        tau = np.where(np.isfinite(run["tau"]), run["tau"], 0.0)
        if not np.any(np.ptp(tau, axis=0) > 0):
            raise InputError(f"run {run.name}: all torques are constant; expected measured joint torques in N m")
    names = [run.name for run in runs]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"run {name}: the name is given twice; give every run its own file name")


def _not_finite(runs: Sequence[Trajectory]) -> list[Finding]:
    return [
        Finding("not_finite", "hard", f"{signal} holds values that are not finite; repair the log", run=run.name)
        for run in runs
        for signal in run.signals
        if not np.isfinite(run[signal]).all()
    ]


def _torque(model: Robot | Completed, runs: Sequence[Trajectory], fixed: bool = False) -> tuple[list[Finding], Array]:
    """Whether it has a sign; all runs together, then those alone that the others may have outvoted, or that hold no
    weight among others."""
    body = body_of(model)
    unsigned = check_magnitude(body, runs)
    if unsigned:
        # Signs and gravity that explain a magnitude better are no cure.
        return unsigned, standing(body)
    findings, gravity = check_torque(model, runs, fixed)
    if len(runs) > 1 and not any(f.severity == "hard" for f in findings):
        seen = of_each(model, runs)
        voted = {run.name: joints for run, joints in outvoted(body, seen, gravity)}
        light = {run.name for run in without_weight(seen, standing(body))}
        for run in (run for run in runs if run.name in voted or run.name in light):
            alone, _ = check_torque(model, [run], fixed)
            accused = ("", *voted[run.name]) if run.name in voted else ()
            of_it = (
                f
                for f in alone
                if (f.severity == "hard" and f.joint in accused) or (f.code == "torque_weight" and run.name in light)
            )
            findings += [replace(f, run=run.name) for f in of_it]
    return findings, gravity


def _of_held_signals(finding: Finding, runs: Sequence[Trajectory]) -> Finding:
    """``finding`` with a cure for signals that all ``runs`` hold: naming columns that are not there cures nothing."""
    held = set.intersection(*(set(run.signals) for run in runs))
    cure = {
        key: {signal: v for signal, v in value.items() if signal in held} if isinstance(value, Mapping) else value
        for key, value in finding.suggestion.items()
    }
    return replace(finding, suggestion=cure)


def _once(findings: Sequence[Finding]) -> list[Finding]:
    """Without those that say the same of training and test runs."""
    out: dict[tuple[str, str, str, str], Finding] = {}
    for f in findings:
        out.setdefault((f.code, f.run, f.joint, f.text), f)
    return list(out.values())


def _stop(findings: Sequence[Finding], refuse: bool, options: str = "") -> None:
    if refuse:
        refuse_hard(findings, options)
