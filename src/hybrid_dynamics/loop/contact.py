"""Something that pushes against the arm for a while: a constant torque of one joint that comes and goes at once.

It happened in one part of a run (or in the same part of every run) and says nothing of others, so held-out parts cannot
judge it as they judge a law of the motion; left in, it would be handed to whatever law comes nearest. It is looked for
as what stands out in time (:mod:`.boxes`), before the search, beside a rich model that knows no names. Its rows take no
part in the search. Afterwards its height follows from what the completed model leaves there, and its uncertainty from
what that leaves on the average of other stretches as long.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Effect, catalogue, family
from hybrid_dynamics.effects.base import INTERVALS, ONLY_RUN
from hybrid_dynamics.loop.boxes import SHORTEST, STEP, Interval, Stretch, boxes
from hybrid_dynamics.loop.diagnosis import predict_run
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.noise import rich_rows
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.types import Array

#: A contact is named where its torque exceeds so many of its standard errors, so many times what is left on the average
#: of any other stretch as long, and lasts as long as a box must.
SURE, BEYOND = 5.0, 1.5
#: A joint whose torque departs for a moment only is left to :mod:`.outliers`; ends are known to about this [s].
_PAD = STEP
#: Stretches of other times that its uncertainty is taken from, at least; else from samples that a window apart.
_FEWEST = 4
#: In a test run it is told where it is so many times what is left elsewhere (rms).
_CLEAR = 2.0


@dataclass(frozen=True)
class Contact:
    """Rows of ``interval`` in which something may push against ``joint``."""

    joint: int
    interval: Interval


def wanted(settings: LoopSettings) -> str | None:
    """The family that acts within intervals, where it may be named."""
    names = [name for name in catalogue(everything=True) if family(name).momentary]
    return next((name for name in names if not settings.effects or name in settings.effects), None)


def without_contacts(evidence: Evidence) -> tuple[Evidence, list[Contact]]:
    """``evidence`` in which rows within contacts count no more for the joint that is pushed; and the contacts."""
    if wanted(evidence.settings) is None:
        return evidence, []
    found: list[Contact] = []
    states, alike = _states(evidence.runs), _of_one_rate(evidence.runs)
    for joint, rows in rich_rows(evidence, evidence.problem.base_target):
        parts = [
            Stretch(r[:, :-1], r[:, -1], m[:, joint], s) for r, m, s in zip(rows, evidence.mask, states, strict=True)
        ]
        for own in alike:
            first = evidence.runs[own[0]]
            for i in boxes([parts[r] for r in own], _dt(first), 1.0 / first.cutoff):
                # Rows of one time in every run, where all have the same rate.
                every = i.run is None and len(own) == len(parts)
                among = own if i.run is None else [own[i.run]]
                found += [Contact(joint, replace(i, run=r)) for r in ([None] if every else among)]
    for contact in found:
        for r in _runs(contact.interval, len(evidence.runs)):
            reach = max(round((_PAD + 0.5 / evidence.runs[r].cutoff) / _dt(evidence.runs[r])), 1)
            rows_of_it = slice(max(contact.interval.start - reach, 0), contact.interval.stop + reach)
            evidence = evidence.leave_out(r, rows_of_it, contact.joint)
    return evidence, found


def named(
    model: Model, runs: Sequence[Run], mask: Sequence[NDArray[np.bool_]], contacts: Sequence[Contact], name: str
) -> list[Effect]:
    """Effects of family ``name`` for those of ``contacts`` that surely are: their torque is what ``model`` leaves.

    ``mask`` (K, n) per run: rows that count, none within contacts. One effect where every run has it alike.
    """
    left = [run.tau - predict_run(model, run) for run in runs]
    out = []
    for contact in contacts:
        j, joint = contact.joint, model.robot.joint_names[contact.joint]
        own_left, counts = [e[:, j] for e in left], [m[:, j] for m in mask]
        own = _runs(contact.interval, len(runs))
        first = runs[own[0]]
        at = _sharpened([left[r][:, j] for r in own], [runs[r].mask[:, j] for r in own], contact.interval, _dt(first))
        inside = [left[r][at.start : at.stop, j][runs[r].mask[at.start : at.stop, j]] for r in own]
        height = float(np.mean(np.concatenate(inside)))
        rows = at.stop - at.start
        others = _elsewhere(own_left, counts, rows)
        error = _spread(others, own_left, counts, rows, first) / np.sqrt(len(own))
        least = max(SURE * error, BEYOND * max(map(abs, others), default=0.0))
        if rows * _dt(first) < SHORTEST or abs(height) <= least:
            continue
        times = tuple(_since(first, row) for row in (at.start, at.stop))
        only = {} if contact.interval.run is None else {ONLY_RUN: runs[contact.interval.run].name}
        (parameter,) = (p.name for p in family(name).parameters)
        out.append(Effect(name, (joint,), {parameter: height}, {INTERVALS: (times,), **only}, {parameter: error}))
    return out


def run_by_run(contact: Contact, number: int) -> list[Contact]:
    """``contact`` once for every run in which it is."""
    return [replace(contact, interval=replace(contact.interval, run=r)) for r in _runs(contact.interval, number)]


def worse_with(model: Model, effects: Sequence[Effect], tests: Sequence[Run]) -> bool:
    """True where ``model`` predicts ``tests`` worse with ``effects``."""
    before, after = (
        sum(float(np.sum((run.tau - predict_run(m, run)) ** 2)) for run in tests)
        for m in (model, model.adding(effects))
    )
    return after > before


def pushed_in_tests(model: Model, tests: Sequence[Run], settings: LoopSettings) -> list[str]:
    """A line for each moment of a test run in which ``model`` is off as if something pushed: the errors hold it."""
    lines = []
    for run, states in zip(tests, _states(tests), strict=True) if wanted(settings) else []:
        left = run.tau - predict_run(model, run)
        for j, name in enumerate(model.robot.joint_names):
            part = Stretch(np.ones((len(left), 1)), left[:, j], run.mask[:, j], states)
            for i in boxes([part], _dt(run), 1.0 / run.cutoff):
                inside = slice(i.start, i.stop)
                first, last = run.time[i.start], run.time[min(i.stop, len(run.time) - 1)]
                off = float(np.mean(left[inside, j][run.mask[inside, j]]))
                others = run.mask[:, j].copy()
                others[inside] = False
                if abs(off) < _CLEAR * np.sqrt(np.mean(left[others, j] ** 2)):
                    continue
                lines.append(
                    f"run {run.name}: from {first:.2f} to {last:.2f} s the torque of {name} stands {off:.3g} off, as "
                    "if something pushed against the arm; the errors on test runs hold it"
                )
    return lines


def _states(runs: Sequence[Run]) -> list[Array]:
    """Positions and speeds of all joints (K, 2 n) in units of their spread over all ``runs``."""
    whole = [np.hstack([run.q, run.dq]) for run in runs]
    spread = np.std(np.concatenate(whole), axis=0) if whole else np.zeros(0)
    # A joint that stands still is everywhere in the same state.
    return [np.where(spread > 0, w / np.where(spread > 0, spread, 1.0), 0.0) for w in whole]


def _since(run: Run, row: int) -> float:
    """Time [s] of ``row`` since the run began."""
    return round(float(run.time[min(row, len(run.time) - 1)] - run.began), 4)


def _runs(interval: Interval, number: int) -> list[int]:
    return list(range(number)) if interval.run is None else [interval.run]


def _of_one_rate(runs: Sequence[Run]) -> list[list[int]]:
    """Numbers of the runs that have their rows equally far apart."""
    out: list[list[int]] = []
    for r, run in enumerate(runs):
        own = next((g for g in out if abs(_dt(runs[g[0]]) / _dt(run) - 1.0) < 1e-3), None)
        if own is None:
            out.append([r])
        else:
            own.append(r)
    return out


def _dt(run: Run) -> float:
    return float(run.time[1] - run.time[0])


def _sharpened(left: Sequence[Array], mask: Sequence[NDArray[np.bool_]], interval: Interval, dt: float) -> Interval:
    """``interval`` with the ends, within two steps, for which a constant explains most of ``left`` (K,)."""
    reach = 2 * max(round(STEP / dt), 1)
    sums = [np.cumsum(np.concatenate([[0.0], np.where(m, e, 0.0)])) for e, m in zip(left, mask, strict=True)]
    counts = [np.cumsum(np.concatenate([[0], m])) for m in mask]
    shortest = min(map(len, left))
    starts = np.arange(max(interval.start - reach, 0), interval.start + reach + 1)
    stops = np.arange(max(interval.stop - reach, 1), min(interval.stop + reach, shortest) + 1)
    best, at = -1.0, interval
    for start in starts:
        good = stops[stops > start]
        total = np.sum([s[good] - s[start] for s in sums], axis=0)
        count = np.sum([c[good] - c[start] for c in counts], axis=0)
        gain = total**2 / np.maximum(count, 1)
        k = int(np.argmax(gain)) if len(gain) else -1
        if k >= 0 and gain[k] > best:
            best, at = float(gain[k]), Interval(interval.run, int(start), int(good[k]))
    return at


def _elsewhere(left: Sequence[Array], mask: Sequence[NDArray[np.bool_]], rows: int) -> list[float]:
    """What is left (K,) on the average of every ``rows`` rows that count for the most part."""
    means = []
    for own, seen in zip(left, mask, strict=True):
        for first in range(0, len(own) - rows + 1, max(rows, 1)):
            inside = seen[first : first + rows]
            if inside.mean() > 0.5:
                means.append(float(np.mean(own[first : first + rows][inside])))
    return means


def _spread(
    others: Sequence[float], left: Sequence[Array], mask: Sequence[NDArray[np.bool_]], rows: int, run: Run
) -> float:
    """Standard deviation [N m] of the average of ``rows`` rows: noise, and what the model is off by for as long."""
    rms = float(np.sqrt(np.mean(np.concatenate([own[seen] for own, seen in zip(left, mask, strict=True)]) ** 2)))
    independent = max(rows * _dt(run) * run.cutoff, 1.0)
    least = rms / np.sqrt(independent)
    seen_to = float(np.sqrt(np.mean(np.square(others)))) if len(others) >= _FEWEST else 0.0
    return max(seen_to, float(least))
