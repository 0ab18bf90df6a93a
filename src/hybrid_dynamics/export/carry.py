"""What each format can carry: one table, from which the writers, the file heads, the console and the docs take it."""

from __future__ import annotations

from collections.abc import Mapping
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

    @property
    def where(self) -> str:
        """The effect and its place, for messages."""
        return f"{self.effect.effect} ({self.effect.joints[0] if self.effect.joints else 'whole robot'})"

    @property
    def loss(self) -> str:
        """One line on what is lost, empty where nothing is."""
        if not self.lost:
            return ""
        what = "; ".join(WORDS[term] for term in self.lost)
        return f"{self.where}{' in full: without the ' if self.kept else ': '}{what}"


def carried(form: str, effects: tuple[Effect, ...], robot: Robot) -> list[Carried]:
    """What becomes of ``effects`` in format ``form``."""
    table = CARRIES[form]
    out = []
    for effect in effects:
        own = terms(effect, robot)
        kept = {term: table[term] for term in own if term in table}
        out.append(Carried(effect, kept, tuple(term for term in own if term not in table)))
    return out
