"""The result in the words and numbers of ``diagnosis.json`` (schema 2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Effect, Term, family
from hybrid_dynamics.effects.inertial_parameters import LINKS
from hybrid_dynamics.effects.together import added_up
from hybrid_dynamics.effects.units import unit_of
from hybrid_dynamics.loop.alternatives import indistinguishable
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.carried import Carried
from hybrid_dynamics.loop.confirm import Confirmation, TestChange
from hybrid_dynamics.loop.diagnosis import Diagnosis, errors_of, moving_rms, rms_in_motion, rounded, verdict_of
from hybrid_dynamics.loop.everything import Everything
from hybrid_dynamics.loop.extrapolation import extrapolation
from hybrid_dynamics.loop.floor import Floor
from hybrid_dynamics.loop.found import Found
from hybrid_dynamics.loop.identifiability import inconsistent, undetermined
from hybrid_dynamics.loop.model import Model, effect_to_json
from hybrid_dynamics.loop.mounting import turned_by
from hybrid_dynamics.loop.prepare import Logs
from hybrid_dynamics.loop.spoiled import Spoiled
from hybrid_dynamics.loop.standing import Standing
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.loop.unexplained import expression_of
from hybrid_dynamics.loop.uniform import same_everywhere
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: Why a joint's effects are not sought: it does not move, or its torque says nothing.
STILL, SILENT = "the joint never moves", "its torque never changes"
#: Relative held-out rmse from which on a constant would have predicted as well, where that is so many times what
#: second differences call noise, and this share of the torque (rms), which may be a constant for the most part; and how
#: the note on it begins.
CONSTANT, BEYOND, OF_TORQUE = 0.9, 2.0, 0.5
NO_BETTER = "a constant would predict the test runs' torque as well"


def describe_result(
    judge: Judge,
    base: Model,
    terms: Sequence[Term],
    found: Found,
    full: Model,
    said: Confirmation,
    floor: Floor,
    carried: Carried,
    standing: Standing,
    rival: Everything,
    worse: Spoiled,
    logs: Logs,
    notes: Sequence[str],
) -> tuple[Diagnosis, list[Model]]:
    """The diagnosis and the model after each effect; ``notes`` are what the earlier steps told."""
    robot, evidence = base.robot, judge.evidence
    alternatives = indistinguishable(judge, found.terms, terms, found.instead, found.beside)
    # Nothing else turns an arm onto a wall: what could stand for the rest of such a tilt says nothing.
    alternatives |= {term: [] for term in turned_by(found.start, evidence.base)}
    beside = [] if found.inconsistent else found.beside
    x = refit(judge.evidence, [*found.terms, *beside]).x if beside else found.x
    disagreeing = inconsistent(judge, found.terms, x, found.inconsistent, beside)
    open_parameters = {s: undetermined(evidence, [*found.terms, *found.beside], s) for s in found.terms}
    models = found.steps_to(full)
    rms = [moving_rms(m, logs.test) for m in models]
    outside = extrapolation(robot, logs.train, logs.test)
    lines: list[str] = []
    entries = []
    for k, (term, effect) in enumerate(zip(found.terms, found.named(full), strict=True)):
        entry = effect_to_json(effect, robot.prismatic)
        entry["indistinguishable_from"] = alternatives.get(term, [])
        if open_parameters[term]:
            entry["undetermined_parameters"] = open_parameters[term]
        if term in disagreeing:
            entry["inconsistent_between_runs"] = disagreeing[term]
            which = ", ".join(d["parameter"] for d in disagreeing[term])
            lines.append(f"{term.effect}{_where(robot, term)}: {which} differ between runs beyond their uncertainty")
        if changed := _in_all(base, effect):
            entry["in_all"] = changed
        lines += [*_change(effect, changed, robot.prismatic), *_unbelievable(robot, term, effect, changed)]
        entry["test_rmse_before"] = [float(v) for v in rms[k]]
        entry["test_rmse_after"] = [float(v) for v in rms[k + 1]]
        entry |= _confirmed(robot, term, said, outside, entry, len(logs.train))
        if not entry["confirmed"]:
            lines.append(f"{term.effect}{_where(robot, term)}: contradicted by the test runs ({entry['why_not']})")
        entries.append(entry)
    for k, effect in enumerate(found.contacts, len(entries)):
        entries.append(
            {
                **effect_to_json(effect, robot.prismatic),
                "indistinguishable_from": [],
                "test_rmse_before": [float(v) for v in rms[k]],
                "test_rmse_after": [float(v) for v in rms[k + 1]],
                # A moment of training runs: others neither confirm nor contradict it, but where all have it.
                "confirmed": True,
                "test_change": _relative(rms[k], rms[k + 1]),
            }
        )
    added = said.model.effects[len(base.effects) :]
    unsure, alike = _beside(added)
    lines += _estimated("beside all links, which can look the same", alike, robot.prismatic)
    why = "beside what is named, too unsure to be named itself, or another one in every run"
    lines += _estimated(why, unsure, robot.prismatic)
    lines += [
        f"{g.effect}{_where(robot, g)}: estimated beside what is named, and taken back: with it "
        f"{', '.join(robot.joint_names[j] for j in worse)} ended worse on the test runs than the starting model"
        for g, worse in said.guesses
    ]
    lines += [] if base.effects else same_everywhere(robot, added)
    lines += said.model.extrapolation_warnings(np.concatenate([run.motion.dq for run in logs.test]))
    for j in np.flatnonzero(floor.cannot_tell):
        if floor.unproven[j]:
            why = f"{floor.unproven[j]:.0%} of what is left follows the motion on held-out parts, which may be chance"
            remedy = "an effect that is missing from noise: record longer and more runs"
        else:
            why = f"what is left changes slowly (autocorrelation {floor.autocorrelation[j]:.2f})"
            remedy = "slow noise from an effect that is missing: record runs that pass the same states"
        lines.append(f"{robot.joint_names[j]}: {why}; these runs cannot tell {remedy}")
    for j in np.flatnonzero(carried.worse):
        lines.append(
            f"{robot.joint_names[j]}: the test runs leave {carried.times[j]:.3g} times as much as the training runs: "
            "the model does not carry over to them; learn from runs that move as they do"
        )
    moving = _errors(base, full, said.model, logs, True)
    held_out = np.array(moving["test"]["after_confirmed"]["relative_rmse"], float)
    least = np.maximum(BEYOND * floor.low, OF_TORQUE * rms_in_motion([run.tau for run in logs.test], logs.test))
    useless = logs.moving & ~logs.untested & (held_out > CONSTANT) & (moving_rms(said.model, logs.test) > least)
    lines = [
        *_no_better(robot, useless, held_out),
        *worse.notes(robot.joint_names, robot.prismatic),
        *rival.notes(robot.joint_names),
        *lines,
        *standing.notes(robot.joint_names, robot.prismatic),
    ]
    something = floor.motion_dependent | floor.cannot_tell | carried.worse | standing.seen | rival.better | worse.seen
    explained = ~floor.seen | ~something
    diagnosis = {
        "schema": 2,
        "robot": robot.name,
        "joints": list(robot.joint_names),
        "verdict": verdict_of(
            any(e["confirmed"] for e in entries), explained & ~logs.silent & (not (unsure or said.guesses))
        ),
        "effects": entries,
        "error": _errors(base, full, said.model, logs, False),
        "error_moving": moving,
        "noise_floor": floor.value.tolist(),
        "noise_floor_low": floor.low.tolist(),
        "noise_floor_high": floor.high.tolist(),
        "learnable_share": floor.learnable_share.tolist(),
        "motion_dependent": [bool(v) for v in floor.motion_dependent],
        "cannot_tell": [bool(v) for v in floor.cannot_tell],
        "unproven_share": floor.unproven.tolist(),
        "worse_on_test": [bool(v) for v in carried.worse],
        "beyond_friction": standing.rms.tolist(),
        "better_with_everything": [bool(v) for v in rival.better],
        "worse_than_start": [bool(v) for v in worse.seen],
        "untested": [bool(v) for v in logs.untested],
        "autocorrelation": floor.autocorrelation.tolist(),
        "extrapolation": outside,
        "unexplained": [
            _unexplained(robot, said.model, logs, judge, floor, carried, standing, rival, worse, int(j))
            for j in np.flatnonzero(~explained)
        ],
        "not_identifiable": [
            {
                "joint": robot.joint_names[j],
                "why": f"{SILENT if logs.silent[j] else STILL} in the training runs; its effects are not sought",
            }
            for j in np.flatnonzero(~logs.moving)
        ],
        **({"prismatic": list(robot.prismatic)} if robot.prismatic else {}),
        "notes": [*notes, *lines],
    }
    return Diagnosis.from_json(rounded(diagnosis)), models


def _unexplained(
    robot: Robot,
    model: Model,
    logs: Logs,
    judge: Judge,
    floor: Floor,
    carried: Carried,
    standing: Standing,
    rival: Everything,
    worse: Spoiled,
    joint: int,
) -> dict[str, Any]:
    # Of what is left, the share that a black box removes; where none can be learned, what second differences deny;
    # where the test runs alone leave more, what they leave beyond the training runs; what stands beyond
    # friction; what a fit of everything takes; what the starting model does not leave.
    share = float(floor.learnable_share[joint])
    if not floor.motion_dependent[joint]:
        share = max(1.0 - float(floor.low[joint] / max(floor.value[joint], 1e-300)) ** 2, 0.0)
    if carried.worse[joint]:
        share = max(share, 1.0 - 1.0 / float(carried.times[joint]) ** 2)
    share = max(share, float(standing.share[joint]), 1.0 - 1.0 / float(rival.times[joint]), float(worse.share[joint]))
    return {
        "joint": robot.joint_names[joint],
        "share_of_residual_variance": share,
        "expression": expression_of(model, logs.train, logs.test, joint, judge.settings.evaluations),
    }


def _relative(before: Array, after: Array) -> dict[str, float]:
    """Relative change of the joints' mean square errors together."""
    whole = max(float(np.sum(np.square(before))), 1e-300)
    return {"value": float(np.sum(np.square(after))) / whole - 1.0, "std_error": 0.0}


def _confirmed(
    robot: Robot, term: Term, said: Confirmation, outside: list[dict[str, Any]], entry: dict[str, Any], runs: int
) -> dict[str, Any]:
    change = said.changes[term]
    out: dict[str, Any] = {
        "confirmed": term not in said.refused,
        "test_change": {"value": change.relative, "std_error": change.error},
    }
    if term in said.unknown:
        out["why_not"] = "known only beside names that the test runs contradict"
    elif term in said.at_rest:
        out["why_not"] = "it asks more of a joint that stands in the test runs than was measured"
    elif term in said.refused:
        out["why_not"] = _why_not(robot, term, change, outside, entry, runs, said.other)
    return out


def _why_not(
    robot: Robot,
    term: Term,
    change: TestChange,
    outside: list[dict[str, Any]],
    entry: dict[str, Any],
    runs: int,
    setup: str,
) -> str:
    """The probable reason, one clause."""
    if setup:
        return setup
    own = [
        o
        for o in outside
        if (term.joint is None or o["joint"] == robot.joint_names[term.joint]) and o["share_outside"] > 0.05
    ]
    if own:
        o = own[0]
        return (
            f"the test motion lies outside the training range: {100 * o['share_outside']:.0f} % of {o['variable']} of "
            f"{o['joint']}"
        )
    if entry["indistinguishable_from"]:
        other = entry["indistinguishable_from"][0]["effects"][0]
        return f"a correlated partner, {other['effect']}, explains as much"
    if runs == 1:
        return "found in one training run only: it may be particular to that run"
    what = "its joint is" if change.alone else "the test runs are"
    return f"{what} predicted better without it ({100 * change.relative:+.1f} % mean square error with it)"


def _beside(added: Sequence[Effect]) -> tuple[list[Effect], list[Effect]]:
    """Of what is no finding, what is too unsure to be named, and what the links, if these are named, can look like."""
    links = any(family(e.effect).all_links and e.is_finding for e in added)
    alike = [e for e in added if not e.is_finding and links and family(e.effect).like_weight]
    return [e for e in added if not e.is_finding and e not in alike], alike


def _estimated(why: str, effects: Sequence[Effect], slides: Sequence[str]) -> list[str]:
    """``effects`` that are no finding, in one line."""
    told = [
        f"{e.effect} of {e.joints[0]} {value:.3g} +- {e.std_errors[name]:.2g} {unit_of(e, name, slides)}"
        for e in effects
        if e.joints
        for name, value in e.parameters.items()
    ]
    # Ten numbers a link are no line of text; they are in the model.
    told += [f"{e.effect} of {', '.join(e.settings[LINKS])}" for e in effects if family(e.effect).all_links]
    return [f"estimated {why}, and no finding: {'; '.join(told)}"] if told else []


def _in_all(base: Model, effect: Effect) -> dict[str, dict[str, float]]:
    """Parameters of a joint's effect that ``base`` has already: there, and with the change; bodies have their whole
    inertia in the table."""
    term = effect.term(base.robot)
    kind = term.family()
    old = [e for e in base.effects if e.term(base.robot).as_finding == term and kind.scope == "joint"]
    if not old:
        return {}
    start, now = added_up(old, base.robot).parameters, added_up([*old, effect], base.robot).parameters
    return {name: {"start": was, "now": now[name]} for name, was in start.items() if was not in (0, now[name])}


def _change(effect: Effect, in_all: Mapping[str, Mapping[str, float]], slides: Sequence[str]) -> list[str]:
    """What became of an effect of the starting model, a line a parameter."""
    where = " ".join(effect.joints) or "all joints"
    return [
        f"{effect.effect} of {where}: {name} changed from {ends['start']:.4g} to {ends['now']:.4g} "
        f"{unit_of(effect, name, slides)} since the starting model"
        for name, ends in in_all.items()
    ]


def _no_better(robot: Robot, useless: NDArray[np.bool_], held_out: Array) -> list[str]:
    """One line where ``useless`` joints (n,) are left with their torque, by ``held_out`` relative rmse (n,)."""
    if not useless.any():
        return []
    each = ", ".join(f"{robot.joint_names[j]} (rmse {held_out[j]:.2g} of its spread)" for j in np.flatnonzero(useless))
    return [
        f"{NO_BETTER}: {each}; before anything is made of this model, see that the log is of this robot and read as it "
        "is meant (hybrid-dynamics check), and that the test runs move as the training runs do"
    ]


def _unbelievable(robot: Robot, term: Term, effect: Effect, in_all: Mapping[str, Mapping[str, float]]) -> list[str]:
    """A line for each parameter of ``effect``, ``in_all`` where the starting model has it too, that is larger or
    smaller than such a thing is."""
    values = {**effect.parameters, **{name: ends["now"] for name, ends in in_all.items()}}
    return [
        f"{effect.effect}{_where(robot, term) or ' of all joints'}: {name} is {values[name]:.3g}; expected {low:g} to "
        f"{high:g}: {why}"
        for name, (low, high, why) in term.family().believable.items()
        if not low <= values[name] <= high
    ]


def _where(robot: Robot, term: Term) -> str:
    return "" if term.joint is None else f" of {robot.joint_names[term.joint]}"


def _errors(base: Model, full: Model, confirmed: Model, logs: Logs, moving: bool) -> dict[str, Any]:
    return {
        name: {
            "before": errors_of(base, part, moving),
            "after": errors_of(full, part, moving),
            "after_confirmed": errors_of(confirmed, part, moving),
        }
        for name, part in (("train", logs.train), ("test", logs.test))
    }
