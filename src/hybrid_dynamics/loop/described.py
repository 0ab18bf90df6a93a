"""Friction that the URDF itself gives: part of the starting model, and told apart from what was found.

Descriptions often hold placeholders (10, 1, 20000). The loop then finds a change of them; what a reader wants is the
total, with the URDF's share beside it, and to hear first where that share makes the model worse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hybrid_dynamics.effects import Effect, family
from hybrid_dynamics.effects.units import unit_at, unit_of
from hybrid_dynamics.effects.urdf_dynamics import ATTRIBUTES
from hybrid_dynamics.loop.close import LoopResult
from hybrid_dynamics.loop.diagnosis import NamedEffect, predict_run
from hybrid_dynamics.loop.model import Model

#: How the note on a description that does harm begins.
WORSE = "the URDF's <dynamics> makes the training error larger"


def announced(effects: Sequence[Effect], slides: Sequence[str]) -> str:
    """One line: what the URDF's <dynamics> put into the starting model; ``slides`` are the prismatic joints."""
    each = []
    for e in effects:
        name, value = next(iter(e.parameters.items()))
        each.append(f"{e.joints[0]} {value:g} {unit_of(e, name, slides)}")
    listed = "; ".join(
        f"{kind} {', '.join(text for text, e in zip(each, effects, strict=True) if e.effect == name)}"
        for kind, name, _ in ATTRIBUTES
        if any(e.effect == name for e in effects)
    )
    return f"the URDF's <dynamics> belongs to the starting model ({listed}); --ignore-dynamics leaves it out"


def with_described(result: LoopResult, described: Sequence[Effect]) -> LoopResult:
    """``result`` of a loop that started from ``described``, in totals; where they make it worse is said first."""
    if not described:
        return result
    slides = result.model.robot.prismatic
    named, notes = [], []
    for entry in result.diagnosis.effects:
        total = _total(entry, described)
        named.append(total)
        notes += [*_shares(total, slides), *_beside(total, result.diagnosis.effects, described, slides)]
    first = [*_worse(result, described), announced(described, slides)]
    # The loop tells the same change in its own words; the total says more.
    kept = [n for n in result.diagnosis.notes if "since the starting model" not in n]
    diagnosis = replace(result.diagnosis, effects=tuple(named), notes=(*first, *notes, *kept))
    return replace(result, diagnosis=diagnosis)


def _total(entry: NamedEffect, described: Sequence[Effect]) -> NamedEffect:
    """``entry`` with its parameters in all, where the URDF has a share in them."""
    effect = entry.effect
    own = [d for d in described if d.effect == effect.effect and d.joints == effect.joints]
    if not own:
        return entry
    total = {name: value + own[0].parameters[name] for name, value in effect.parameters.items()}
    shares = {name: {"urdf": own[0].parameters[name], "now": value} for name, value in total.items()}
    return replace(entry, effect=replace(effect, parameters=total), in_all=shares)


def _shares(entry: NamedEffect, slides: Sequence[str]) -> list[str]:
    return [
        f"{entry.effect.effect} of {entry.effect.joints[0]}: {name} is {ends['now']:.4g} "
        f"{unit_of(entry.effect, name, slides)} in all, of which the URDF gives {ends['urdf']:.4g}"
        for name, ends in entry.in_all.items()
    ]


def _beside(
    entry: NamedEffect, named: Sequence[NamedEffect], described: Sequence[Effect], slides: Sequence[str]
) -> list[str]:
    """Where a richer law comes to what the URDF gives of a plainer one, which stays as it is."""
    effect, places = entry.effect, {(e.effect.effect, e.effect.joints) for e in named}
    return [
        f"{effect.effect} of {effect.joints[0]} comes on top of the URDF's {d.effect} of {value:.4g} "
        f"{unit_of(d, name, slides)}"
        for d in described
        if d.joints == effect.joints and d.effect in family(effect.effect).contains
        if (d.effect, d.joints) not in places
        for name, value in d.parameters.items()
    ]


def _worse(result: LoopResult, described: Sequence[Effect]) -> list[str]:
    """Joints whose training error the description's friction makes larger."""
    robot = result.model.robot
    bare, start = Model(robot), Model(robot, tuple(described))

    def rmse(model: Model) -> np.ndarray:
        left = np.concatenate([run.tau - predict_run(model, run) for run in result.train])
        return np.asarray(np.sqrt(np.mean(left**2, axis=0)))

    without, with_it = rmse(bare), rmse(start)
    worse = [
        f"{name} {a:.3g} → {b:.3g} {unit_at('N m', name, robot.prismatic)}"
        for name, a, b in zip(robot.joint_names, without, with_it, strict=True)
        if b > 1.02 * a and any(d.joints == (name,) for d in described)
    ]
    if not worse:
        return []
    return [
        f"{WORSE}: {', '.join(worse)}; it may be a placeholder: correct it in the URDF, or leave it out with "
        "--ignore-dynamics"
    ]
