"""Add an effect, re-fit everything jointly, drop what is no longer needed, until nothing is left to name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Effect, Slot
from hybrid_dynamics.effects.sign import travel_settings
from hybrid_dynamics.loop.evidence import ONLY_RUN, Evidence
from hybrid_dynamics.loop.likeness import LIKENESS_OF_PAIR, overlap, pairs
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.trace import DECISIVE, Candidate, Judge, rank, same_place

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Step:
    """One change of the model: ``action`` is add, drop, replace or stop; ``slots`` the model's after it."""

    action: str
    slot: Slot | None
    slots: tuple[Slot, ...]
    table: tuple[Candidate, ...]
    held_out: tuple[float, ...]


def effects_of(evidence: Evidence, slots: Sequence[Slot], x: Array, covariance: Array | None = None) -> list[Effect]:
    """Coordinates ``x`` as effects with published parameters and their standard errors."""
    layout = evidence.layout(slots)
    names = evidence.robot.joint_names
    out = []
    for slot, start in zip(layout.slots, layout.starts, strict=True):
        kind = slot.family()
        own = slice(start, start + kind.size)
        errors: dict[str, float] = {}
        if covariance is not None:
            jacobian = kind.jacobian(x[own], evidence.robot, slot)
            variance = np.einsum("ij,jk,ik->i", jacobian, covariance[own, own], jacobian)
            errors = {p.name: float(np.sqrt(max(v, 0.0))) for p, v in zip(kind.parameters, variance, strict=True)}
        joints = () if slot.joint is None else (names[slot.joint],)
        values = kind.parameters_of(x[own], evidence.robot, slot)
        out.append(Effect(slot.effect, joints, values, dict(slot.settings), errors))
    return out


def refit(evidence: Evidence, slots: Sequence[Slot], rounds: int = 3) -> Array:
    """Absolute Gauss-Newton re-fit of all coordinates; one round where everything is linear.

    Columns that depend on the load follow the rigid body of the model that is being fitted.
    """
    kinds = [s.family() for s in slots]
    body = any(k.changes_body for k in kinds)
    loaded = body and any(s.family().uses_load for s in evidence.slots)
    nonlinear = any(k.nonlinear for k in kinds) or (body and evidence.base_follows_load)
    if not nonlinear:
        evidence.reset()
    x = evidence.fit(slots)
    coupled = loaded and any(k.uses_load for k in kinds)
    if nonlinear or coupled:
        for _ in range(rounds):
            effects = effects_of(evidence, slots, x)
            if loaded:
                evidence.renew_load(effects)
            if nonlinear:
                evidence.relinearise(effects, slots, x)
            x = evidence.fit(slots)
    elif loaded:
        evidence.renew_load(effects_of(evidence, slots, x))
    return x


def search(
    judge: Judge, candidates: Sequence[Slot], report: Callable[[Step], None], start: Sequence[Slot] = ()
) -> list[Step]:
    """Stepwise search, forward and backward, with replacements, from ``start``; returns the steps taken."""
    evidence, settings = judge.evidence, judge.settings
    current: list[Slot] = list(start)
    steps: list[Step] = []
    seen: set[frozenset[Slot]] = {frozenset(current)}

    def record(action: str, slot: Slot | None, table: Sequence[Candidate] = ()) -> None:
        rms = np.sqrt(judge.mean_square(evidence.held_out(current, physical=True)))
        steps.append(Step(action, slot, tuple(current), tuple(table), tuple(float(v) for v in rms)))
        report(steps[-1])

    while True:
        before = evidence.held_out(current, physical=True)
        table = rank(judge, current, candidates, before)
        room = len(current) < settings.max_effects
        choice = next((c for c in table if room and c.accepted and frozenset([*current, c.slot]) not in seen), None)
        if choice is None:
            replaced = _replace(judge, current, candidates, before, seen)
            if replaced is None:
                replaced = _lighter(judge, current, candidates, before, seen)
            if replaced is None:
                record("stop", None, table)
                break
            current[:] = replaced
            seen.add(frozenset(current))
            refit(evidence, current)
            record("replace", None, table)
        else:
            current.append(choice.slot)
            seen.add(frozenset(current))
            refit(evidence, current)
            record("add", choice.slot, table)
        current[:] = _settings(judge, current, candidates)
        while (useless := _useless(judge, current)) is not None:
            current.remove(useless)
            seen.add(frozenset(current))
            refit(evidence, current)
            record("drop", useless)
    return steps


def _settings(judge: Judge, current: Sequence[Slot], candidates: Sequence[Slot]) -> list[Slot]:
    """Choose again among the settings of each effect (the width of a sign, say)."""
    best = list(current)
    score = float(judge.score(judge.evidence.held_out(best)).sum())
    for i, slot in enumerate(current):
        if ONLY_RUN in dict(slot.settings):
            continue
        for other in candidates:
            if other != slot and same_place(other, slot):
                trial = [*best[:i], other, *best[i + 1 :]]
                value = float(judge.score(judge.evidence.held_out(trial)).sum())
                if value < score:
                    best, score = trial, value
    return best


def choose_signs(judge: Judge, current: Sequence[Slot]) -> list[Slot]:
    """Friction whose sign turns over, joint by joint, as predicts standing rows best, where moving rows leave it open.

    What a joint does below the slow speed has no say in what is named; but of two settings that are as good above it
    the one is kept that is also right below. Friction of the starting model stays as it is.
    """
    evidence = judge.evidence
    turning = [s for s in current if s.family().turns_sign and not evidence.in_base(s)]
    evidence.add_slots(
        [replace(s, settings=settings) for s in turning for settings in travel_settings(judge.settings.sign_travels)]
    )
    best = list(current)
    refit(evidence, best)
    ways = sorted({s.settings for s in evidence.slots if s.family().turns_sign})
    for joint in sorted({s.index for s in turning}):
        own = [i for i, s in enumerate(best) if s.joint == joint and s in turning]
        reference = evidence.held_out(best)
        error = evidence.held_out_all_rows(best, joint)
        start = list(best)
        for settings in ways:
            trial = [replace(s, settings=settings) if i in own else s for i, s in enumerate(start)]
            if trial == start or not all(evidence.has(s) for s in trial):
                continue
            errors = evidence.held_out(trial)
            difference = judge.score(errors) - judge.score(reference)
            growth = judge.mean_square(errors) - judge.mean_square(reference)
            certain = float(difference.sum()) > judge.standard_error(difference)
            if certain and np.any(growth > judge.settings.floor_share * judge.floor**2):
                continue
            value = evidence.held_out_all_rows(trial, joint)
            if value < error:
                best, error = trial, value
    return best


def _useless(judge: Judge, current: Sequence[Slot]) -> Slot | None:
    """The effect that others explain by now, if any: without it held-out error hardly grows."""
    if len(current) < 2:
        return None
    evidence, settings = judge.evidence, judge.settings
    pressed = evidence.constrained(current)
    full = evidence.held_out(current, pressed)
    worst: tuple[float, Slot] | None = None
    for slot in current:
        rest = [s for s in current if s != slot]
        errors = evidence.held_out(rest, pressed or evidence.constrained(rest))
        difference = judge.score(errors) - judge.score(full)
        loss = float(difference.sum())
        joint_loss = judge.mean_square(errors) - judge.mean_square(full)
        error = judge.standard_error(difference)
        needed = loss > error and judge.matters(slot, joint_loss, settings.keep_share, loss > DECISIVE * error)
        if not needed and (worst is None or loss < worst[0]):
            worst = (loss, slot)
    return None if worst is None else worst[1]


def _replace(
    judge: Judge, current: Sequence[Slot], candidates: Sequence[Slot], before: Array, seen: set[frozenset[Slot]]
) -> list[Slot] | None:
    """One or two effects replaced by another candidate: surely better, or as good and simpler.

    A newcomer must surely explain something itself: by being simpler alone nothing gets in.
    Trials are screened without the constraints of bodies; what passes is judged with them.
    """
    evidence = judge.evidence
    free = judge.score(evidence.held_out(current))
    physical = judge.score(before)
    groups: list[tuple[Slot, ...]] = [(s,) for s in current]
    if len(current) <= 8:
        groups += [(a, b) for i, a in enumerate(current) for b in current[i + 1 :]]
    best: tuple[float, list[Slot]] | None = None
    for group in groups:
        rest = [s for s in current if s not in group]
        size = sum(s.family().size for s in group)
        without: Array | None = None
        for slot in candidates:
            trial = [*rest, slot]
            if any(same_place(slot, s) for s in current) or frozenset(trial) in seen:
                continue
            simpler = slot.family().size < size
            difference = judge.score(evidence.held_out(trial)) - free
            if not _better(judge, difference, simpler):
                continue
            difference = judge.score(evidence.held_out(trial, physical=True)) - physical
            loss = float(difference.sum())
            if not _better(judge, difference, simpler) or (best is not None and loss >= best[0]):
                continue
            if without is None:
                without = judge.score(evidence.held_out(rest, physical=True))
            gain = without - physical - difference
            if float(gain.sum()) > judge.settings.gain_in_errors * judge.standard_error(gain):
                best = (loss, trial)
    return None if best is None else best[1]


def _lighter(
    judge: Judge, current: Sequence[Slot], candidates: Sequence[Slot], before: Array, seen: set[frozenset[Slot]]
) -> list[Slot] | None:
    """A body replaced by two effects of one coefficient each that explain as much.

    A body found first takes what several simple effects have in common; without this they would never be looked at,
    since each alone adds nothing beside it.
    """
    evidence = judge.evidence
    x, layout = evidence.fit(current), evidence.layout(current)
    free = [c for c in candidates if not any(same_place(c, s) for s in current)]
    best: tuple[float, list[Slot]] | None = None
    for slot, start in zip(layout.slots, layout.starts, strict=True):
        size = slot.family().size
        if size != 10 or ONLY_RUN in dict(slot.settings):
            continue
        rest = [s for s in current if s != slot]
        for pair in pairs(slot, free):
            trial = [*rest, *pair]
            if frozenset(trial) in seen or overlap(evidence, slot, x[start : start + size], *pair) < LIKENESS_OF_PAIR:
                continue
            errors = evidence.held_out(trial, physical=True)
            loss = float((judge.score(errors) - judge.score(before)).sum())
            if judge.as_good(errors, before) and (best is None or loss < best[0]):
                best = (loss, trial)
    return None if best is None else best[1]


def _better(judge: Judge, difference: Array, simpler: bool) -> bool:
    """Whether block-wise ``difference`` of scores (new less old) speaks for the new."""
    loss, error = float(difference.sum()), judge.standard_error(difference)
    return loss < -judge.settings.gain_in_errors * error or (simpler and loss <= error)


def model_of(evidence: Evidence, slots: Sequence[Slot]) -> Model:
    """The completed model: the start and the effects of ``slots`` fitted on all training rows."""
    x = refit(evidence, slots)
    return evidence.base.adding(effects_of(evidence, slots, x, evidence.covariance(slots, x)))
