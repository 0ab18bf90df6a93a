"""From the result of a loop to the content of its page: which effects belong together, what each of them adds."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from hybrid_dynamics.effects import Effect, Term, family
from hybrid_dynamics.effects.base import ONLY_RUN
from hybrid_dynamics.effects.inertia import link_parameters, to_body
from hybrid_dynamics.loop.close import LoopResult
from hybrid_dynamics.loop.diagnosis import predict_run, rounded
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.search import Step
from hybrid_dynamics.loop_report.content import KINDS, Candidate, Content, Curve, Group, Law, SearchStep, Trace
from hybrid_dynamics.loop_report.words import placed
from hybrid_dynamics.types import Array

#: Points of a curve and of a torque plot, held-out runs whose torque is drawn, joints drawn for a whole-robot effect.
CURVE_POINTS, TRACE_POINTS, TRACE_RUNS, ROBOT_JOINTS = 600, 1200, 3, 3
#: Significant digits of what is drawn: finer than a screen.
DIGITS = 5


def kind_of(name: str) -> str:
    """The heading of :data:`KINDS` under which effect ``name`` stands."""
    known = family(name)
    if known.momentary:
        return "moment"
    if known.changes_reading:
        return "reading"
    if known.drawn_against == "ddq":
        return "rotor"
    if known.changes_body or known.is_body:
        return "body"
    if name.endswith("friction"):
        # Also where it follows the travel since the last reversal: friction is looked for under friction.
        return "friction"
    return {"dq": "friction", "load": "friction", "q": "position", "time": "offset"}.get(known.drawn_against, "other")


def run_title(name: str) -> str:
    """The run as people know it: files of either split are kept apart as ``train:`` and ``test:`` inside alone."""
    return name.removeprefix("train:").removeprefix("test:")


def gather(result: LoopResult, provenance: str = "") -> Content:
    """The content of the page of ``result``."""
    diagnosis = diagnosis_of(result)
    names = result.model.robot.joint_names
    return Content(
        diagnosis=diagnosis,
        train_runs=tuple(run_title(run.name) for run in result.train),
        test_runs=tuple(run_title(run.name) for run in result.test),
        groups=tuple(_groups(result, diagnosis)),
        traces=tuple(_traces(result)),
        steps=tuple(_steps(result, names)),
        provenance=provenance,
        laws=tuple(_laws(result, diagnosis)),
        described=_described(result, diagnosis),
    )


def diagnosis_of(result: LoopResult) -> dict[str, Any]:
    """``diagnosis.json`` of ``result`` as plain values."""
    return result.diagnosis.to_json()


def _groups(result: LoopResult, diagnosis: dict[str, Any]) -> list[Group]:
    """Effects per place and kind, joints in the robot's order, whole-robot effects last."""
    entries = diagnosis["effects"]
    active = {_key(e.effect, e.joints, e.settings): e for e in result.model.effects[len(result.models[0].effects) :]}
    members: dict[tuple[int, int, str], list[int]] = {}
    names = list(diagnosis["joints"])
    for k, entry in enumerate(entries):
        kind = kind_of(entry["effect"])
        place = names.index(entry["joints"][0]) if entry["joints"] else len(names)
        members.setdefault((place, list(KINDS).index(kind), kind), []).append(k)
    out = []
    for (place, _, kind), own in sorted(members.items()):
        effects = [active.get(_key(entries[k]["effect"], entries[k]["joints"], entries[k]["settings"])) for k in own]
        alone = [np.zeros(len(names)) if e is None else _added_rms(result, [e]) for e in effects]
        there = [e for e in effects if e is not None]
        runs = _acting_in(result, there)
        out.append(
            Group(
                where=names[place] if place < len(names) else "",
                kind=kind,
                effects=tuple(own),
                contribution=tuple(_round(a.max()) for a in alone),
                contribution_joint=tuple(names[int(np.argmax(a))] for a in alone),
                curves=tuple(_curves(result, there, kind, place, runs)) if there else (),
                runs=() if runs is result.test else tuple(run_title(run.name) for run in runs),
            )
        )
    return out


def _key(effect: str, joints: Sequence[str], settings: Any) -> tuple[str, tuple[str, ...], str]:
    # The diagnosis went through JSON, where tuples become lists and numbers are rounded.
    return effect, tuple(joints), json.dumps(rounded(json.loads(json.dumps(dict(settings)))), sort_keys=True)


def _without(model: Model, effects: Sequence[Effect]) -> Model:
    return Model(model.robot, tuple(e for e in model.effects if not any(e is o for o in effects)))


def _acting_in(result: LoopResult, effects: Sequence[Effect]) -> Sequence[Run]:
    """The held-out runs; where all of ``effects`` act in one run each (a push), those training runs."""
    names = {e.settings.get(ONLY_RUN) for e in effects}
    return [run for run in result.train if run.name in names] if names and None not in names else result.test


def _added(result: LoopResult, effects: Sequence[Effect], runs: Sequence[Run]) -> list[Array]:
    """Torque (K, n) [N m] that ``effects`` add to the final model on each of ``runs``."""
    rest = _without(result.model, effects)
    return [predict_run(result.model, run) - predict_run(rest, run) for run in runs]


def _added_rms(result: LoopResult, effects: Sequence[Effect]) -> Array:
    """(n,) [N m]."""
    return np.asarray(
        np.sqrt(np.mean(np.concatenate(_added(result, effects, _acting_in(result, effects))) ** 2, axis=0))
    )


def _curves(result: LoopResult, effects: Sequence[Effect], kind: str, place: int, runs: Sequence[Run]) -> list[Curve]:
    """One curve at the effects' joint; for a body, one on each joint where it adds most, over what it adds."""
    names = result.model.robot.joint_names
    added = _added(result, effects, runs)
    left = [run.tau - predict_run(result.model, run) for run in runs]
    if kind in ("body", "reading", "other") or place >= len(names):
        size = np.sqrt(np.mean(np.concatenate(added) ** 2, axis=0))
        joints = [int(j) for j in np.argsort(-size, kind="stable")[:ROBOT_JOINTS] if size[j] > 0]
        axis = "added"
    else:
        joints, axis = [place], {"rotor": "ddq", "position": "q", "offset": "time", "moment": "time"}.get(kind, "dq")
    count = sum(len(run.time) for run in runs)
    step = max(-(-count // CURVE_POINTS), 1)
    out = []
    for j in joints:
        x = [a[:, j] if axis == "added" else _variable(run, axis)[:, j] for run, a in zip(runs, added, strict=True)]
        owner = np.concatenate([np.full(len(run.time), k) for k, run in enumerate(runs)])[::step]
        own = np.concatenate([a[:, j] for a in added])[::step]
        rest = np.concatenate([e[:, j] for e in left])[::step]
        out.append(
            Curve(
                joint=names[j],
                axis=axis,
                noise=_round(result.floor.value[j]),
                x=_numbers(np.concatenate(x)[::step]),
                missing=_numbers(own + rest),
                added=_numbers(own),
                run=tuple(int(v) for v in owner),
            )
        )
    return out


def _variable(run: Run, axis: str) -> Array:
    if axis == "time":
        return np.repeat((run.time - run.began)[:, None], run.tau.shape[1], axis=1)
    return np.asarray(getattr(run, axis))


def _traces(result: LoopResult) -> list[Trace]:
    names = result.model.robot.joint_names
    out = []
    for run in result.test[:TRACE_RUNS]:
        before, after = (predict_run(model, run) for model in (result.models[0], result.model))
        thin = slice(None, None, max(-(-len(run.time) // TRACE_POINTS), 1))
        time = _numbers((run.time - run.began)[thin])
        for j, name in enumerate(names):
            shown = (_numbers(values[thin, j]) for values in (run.tau, before, after))
            out.append(Trace(run_title(run.name), name, time, *shown))
    return out


def _described(result: LoopResult, diagnosis: dict[str, Any]) -> dict[str, float]:
    """What the URDF says of links whose numbers are found together; nothing where the start had bodies of its own."""
    base = result.models[0]
    found = [e for e in diagnosis["effects"] if family(e["effect"]).all_links]
    if not found or any(family(e.effect).changes_body for e in base.effects):
        return {}
    out: dict[str, float] = {}
    for joint in {p["joint"] for entry in found for p in entry["parameters"]}:
        body = to_body(link_parameters(base.robot, list(diagnosis["joints"]).index(joint)))
        out |= {f"{joint}/{name}": _round(value) for name, value in body.items()}
    return dict(sorted(out.items()))


def _laws(result: LoopResult, diagnosis: dict[str, Any]) -> list[Law]:
    """What every formula for what is left takes of the error of the held-out runs."""
    asked = [entry for entry in diagnosis["unexplained"] if entry["expression"] != "0"]
    if not asked:
        return []
    # Formulas are rare, and their library takes a second to import.
    from hybrid_dynamics.models.expressions import CompiledExpressions, parse_expression

    joints = list(diagnosis["joints"])
    names = [f"{s}{j + 1}" for s in ("q", "dq", "ddq") for j in range(len(joints))]
    law = CompiledExpressions([parse_expression(entry["expression"], names) for entry in asked], names)
    left = [run.tau - predict_run(result.model, run) for run in result.test]
    taken = [law(np.hstack([run.q, run.dq, run.ddq])) for run in result.test]
    out = []
    for k, entry in enumerate(asked):
        j = joints.index(entry["joint"])
        moving = np.concatenate([run.mask[:, j] for run in result.test])
        before = np.concatenate([error[:, j] for error in left])[moving]
        after = before - np.concatenate([torque[:, k] for torque in taken])[moving]
        out.append(Law(entry["joint"], *(_round(np.sqrt(np.mean(error**2))) for error in (before, after))))
    return out


def _steps(result: LoopResult, names: Sequence[str]) -> list[SearchStep]:
    """The search as it went; a candidate counts as added only where this step added it."""
    out: list[SearchStep] = []
    before: tuple[Term, ...] = ()
    for step in result.steps:
        candidates = tuple(
            Candidate(
                effect=c.term.effect,
                joint="" if c.term.joint is None else names[c.term.joint],
                settings=", ".join(f"{key} = {_shown(value)}" for key, value in c.term.settings),
                score=_round(c.score),
                gain=_round(c.gain),
                gain_error=_round(c.gain_error),
                added=step.action == "add" and c.term == step.term,
                why=c.reason,
            )
            for c in step.table
        )
        put, out_of = _swapped(before, step)
        replaced = tuple(placed(*_on(term, names)) for term in out_of)
        out.append(SearchStep(step.action, *_on(put or step.term, names), candidates, replaced))
        before = step.terms
    return out


def _on(term: Term | None, names: Sequence[str]) -> tuple[str, str]:
    """Effect and joint, as text."""
    return ("", "") if term is None else (term.effect, "" if term.joint is None else names[term.joint])


def _swapped(before: Sequence[Term], step: Step) -> tuple[Term | None, tuple[Term, ...]]:
    """What a replacement put into the model and what it took out; nothing for other steps."""
    if step.action != "replace":
        return None, ()
    new = [term for term in step.terms if term not in before]
    return (new[0] if new else None), tuple(term for term in before if term not in step.terms)


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _round(value: Any) -> float:
    return float(f"{float(value):.{DIGITS - 1}e}") if np.isfinite(value) else 0.0


def _numbers(values: Array) -> tuple[float, ...]:
    """Rounded to what a screen shows; below 1e-9 is zero."""
    values = np.where(np.abs(values) < 1e-9, 0.0, values)
    size = np.where(values == 0, 0.0, np.floor(np.log10(np.maximum(np.abs(values), 1e-300))))
    factor = 10.0 ** (DIGITS - 1 - size)
    return tuple(float(f"{v:.{DIGITS}g}") for v in np.round(values * factor) / factor)
