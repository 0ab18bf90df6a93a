"""What each format can carry: one table, from which the writers, the file heads, the console and the docs take it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.export.terms import WORDS, terms
from hybrid_dynamics.robots import Robot

#: Terms that no format carries: they belong to the recording, not to the robot.
OF_THE_RECORDING = ("delay", "one_run")
_PROGRAM = {term: "computed" for term in WORDS if term not in OF_THE_RECORDING}

#: Per format the terms it carries, and how. What is not listed is lost, and that is said.
CARRIES: Mapping[str, Mapping[str, str]] = {
    "urdf": {
        "inertia": "<inertial> of the links",
        "damping": '<dynamics damping="...">',
        "dry_friction": '<dynamics friction="...">',
    },
    "mjcf": {
        "inertia": "<inertial>",
        "armature": "joint armature",
        "gravity": "option gravity",
        "damping": "joint damping",
        "quadratic_damping": "joint damping, second number",
        "cubic_damping": "joint damping, third number",
        "dry_friction": "joint frictionloss",
        "offset": "joint stiffness (very soft) and springref (far away)",
        "stiffness": "joint stiffness and springref",
        "position_offset": "joint ref",
        "gain": "gear of the joint's motor",
    },
    "c": _PROGRAM,
    "python": _PROGRAM,
    "casadi": _PROGRAM,
}


@dataclass(frozen=True)
class Carried:
    """What becomes of one effect: ``kept`` maps the terms that the format carries to how; ``lost`` lists the others."""

    effect: Effect
    kept: Mapping[str, str]
    lost: tuple[str, ...]


def losses(effects: Sequence[Carried]) -> list[str]:
    """One line on each thing that is lost, with the joints where it is: the same loss of several joints is one line."""
    places: dict[tuple[str, bool, tuple[str, ...]], list[str]] = {}
    for c in effects:
        if c.lost:
            own = places.setdefault((c.effect.effect, bool(c.kept), c.lost), [])
            own.append(c.effect.joints[0] if c.effect.joints else "whole robot")
    out = []
    for (name, in_part, lost), where in places.items():
        several = f" of {len(where)} joints" if len(where) > 1 else ""
        what = "; ".join(WORDS[term] for term in lost)
        out.append(f"{name}{several} ({', '.join(where)}){' in full: without the ' if in_part else ': '}{what}")
    return out


def carried(form: str, effects: tuple[Effect, ...], robot: Robot) -> list[Carried]:
    """What becomes of ``effects`` in format ``form``."""
    table = CARRIES[form]
    out = []
    for effect in effects:
        own = terms(effect, robot)
        kept = {term: table[term] for term in own if term in table}
        out.append(Carried(effect, kept, tuple(term for term in own if term not in table)))
    return out
