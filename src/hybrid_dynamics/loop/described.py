"""Friction that the URDF itself gives: part of the starting model, and told apart from what was found.

Descriptions often hold placeholders (10, 1, 20000). The loop then finds a change of them; what a reader wants is the
total, with the URDF's share beside it, and to hear first where that share makes the model worse.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from hybrid_dynamics.effects import Effect, family
from hybrid_dynamics.effects.units import unit_at, unit_of
from hybrid_dynamics.effects.urdf_dynamics import ATTRIBUTES
from hybrid_dynamics.loop.close import LoopResult
from hybrid_dynamics.loop.diagnosis import Change, Diagnosis, Errors, NamedEffect, errors_of, rounded
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.placeholders import harmed

#: How the note on a description that does harm begins.
WORSE = "the URDF's <dynamics> makes the training error larger"


def announced(effects: Sequence[Effect], slides: Sequence[str]) -> str:
    """One line: what the URDF's <dynamics> put into the starting model; ``slides`` are the prismatic joints."""
    listed = "; ".join(
        f"{kind} {_each(own, slides)}"
        for kind, name, _ in ATTRIBUTES
        if (own := [e for e in effects if e.effect == name])
    )
    return f"the URDF's <dynamics> belongs to the starting model ({listed}); --ignore-dynamics leaves it out"


def with_described(result: LoopResult, described: Sequence[Effect]) -> LoopResult:
    """``result`` of a loop that started from ``described``, in totals; where they make it worse is said first."""
    if not described:
        return result
    slides = result.model.robot.prismatic
    kept = [d for d in described if d in result.models[0].effects]
    named, notes = [], []
    for entry in result.diagnosis.effects:
        total = _total(entry, described, kept)
        named.append(total)
        notes += [*_shares(total, slides), *_beside(total, result.diagnosis.effects, kept, slides)]
    gone = [d for d in described if d not in kept]
    first = [*_worse(result, described), *([announced(kept, slides)] if kept else []), *_left_out(gone, slides)]
    # The loop tells the same change in its own words; the total says more.
    rest = [n for n in result.diagnosis.notes if "since the starting model" not in n]
    diagnosis = replace(result.diagnosis, effects=tuple(named), notes=(*first, *notes, *rest))
    if gone:
        diagnosis = _from_the_urdf(diagnosis, result, described)
    return replace(result, diagnosis=diagnosis)


def _from_the_urdf(diagnosis: Diagnosis, result: LoopResult, described: Sequence[Effect]) -> Diagnosis:
    """``diagnosis`` with the errors of the model that the URDF describes, all of it, as those before."""
    urdf = Model(result.model.robot, tuple(described))
    parts = {"train": result.train, "test": result.test}

    def began(change: Mapping[str, Change], moving: bool) -> dict[str, Change]:
        return {
            name: replace(own, before=Errors.of(rounded(errors_of(urdf, parts[name], moving))))
            for name, own in change.items()
        }

    return replace(diagnosis, error=began(diagnosis.error, False), error_moving=began(diagnosis.error_moving, True))


def _total(entry: NamedEffect, described: Sequence[Effect], kept: Sequence[Effect]) -> NamedEffect:
    """``entry`` with its parameters in all, beside those of the URDF; they came on top of what of it was ``kept``."""
    effect = entry.effect
    own = [d for d in described if d.effect == effect.effect and d.joints == effect.joints]
    if not own:
        return entry
    share = own[0].parameters if own[0] in kept else dict.fromkeys(own[0].parameters, 0.0)
    total = {name: value + share[name] for name, value in effect.parameters.items()}
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
    worse = [
        f"{name} {a:.3g} → {b:.3g} {unit_at('N m', name, robot.prismatic)}"
        for name, (a, b) in harmed(robot, described, result.train).items()
    ]
    if not worse:
        return []
    return [
        f"{WORSE}: {', '.join(worse)}; it may be a placeholder: correct it in the URDF, or leave it out with "
        "--ignore-dynamics"
    ]


def _left_out(gone: Sequence[Effect], slides: Sequence[str]) -> list[str]:
    """One line: dry friction that the starting model is without."""
    if not gone:
        return []
    return [
        f"the URDF's <dynamics> friction {_each(gone, slides)} is left out of the starting model: the torque holds "
        "less than half of it, or more than twice; what there is is found in full"
    ]


def _each(effects: Sequence[Effect], slides: Sequence[str]) -> str:
    """The value of each of ``effects``, of one parameter, after its joint."""
    values = [(e, *next(iter(e.parameters.items()))) for e in effects]
    return ", ".join(f"{e.joints[0]} {value:g} {unit_of(e, name, slides)}" for e, name, value in values)
