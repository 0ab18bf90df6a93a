"""What is exported: a completed model, the URDF it belongs to, and what is said about both in every exported file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

from hybrid_dynamics.effects import Effect, family
from hybrid_dynamics.export.carry import carried
from hybrid_dynamics.export.terms import Terms, terms
from hybrid_dynamics.loop.model import Model, load_model
from hybrid_dynamics.robots import Robot


@dataclass(frozen=True)
class Rendered:
    """What an export consists of: files by name (the first is the one asked for), and notes for the user."""

    files: Mapping[str, bytes]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Source:
    """``model`` with the robot file it was made for, and that file's path; ``lock``: joints fixed at zero."""

    model: Model
    urdf: Path
    lock: tuple[str, ...] = field(default=())

    @classmethod
    def read(cls, model: Path, urdf: Path, lock: tuple[str, ...] = ()) -> Source:
        """Read both files; :class:`InputError` names what is unusable or does not fit together."""
        return cls(load_model(model, Robot.from_urdf(urdf, lock)), urdf, lock)

    @property
    def robot(self) -> Robot:
        """The robot before any effect."""
        return self.model.robot

    @property
    def inactive(self) -> tuple[Effect, ...]:
        """Effects that ``model.json`` keeps on record without letting them act: they are not exported."""
        return tuple(getattr(self.model, "inactive", ()))

    def losses(self, form: str) -> list[str]:
        """One line for every effect that format ``form`` cannot carry, or only in part."""
        return [c.loss for c in carried(form, self.model.effects, self.robot) if c.loss]

    def head(self, form: str) -> list[str]:
        """Lines for the head of the exported file: where it comes from, what is in it, what is not."""
        lines = [
            f"Written by hybrid-dynamics {version('hybrid-dynamics')} (export --format {form}).",
            f"Robot {self.robot.name}; joints {', '.join(self.robot.joint_names)}. SI units.",
        ]
        if self.lock:
            lines.append(f"Joints held at zero: {', '.join(self.lock)}.")
        held = [f"  {name(effect)}: {values(effect)}" for effect in self.model.effects]
        lines += ["Effects of the completed model:", *(held or ["  none"])]
        losses = self.losses(form)
        if losses:
            lines += ["This format cannot carry:", *(f"  {line}" for line in losses)]
        else:
            lines.append("This format carries all of them.")
        if self.inactive:
            lines.append("Left out, because held-out runs contradict them:")
            lines += [f"  {name(effect)}" for effect in self.inactive]
        return lines

    def joint_terms(self, form: str) -> dict[str, Terms]:
        """Sum of the terms that ``form`` carries, for each joint that has any, effects of the body left aside."""
        out: dict[str, Terms] = {}
        for c in carried(form, self.model.effects, self.robot):
            if family(c.effect.effect).changes_body or not c.effect.joints:
                continue
            own = out.setdefault(c.effect.joints[0], {})
            for term, value in terms(c.effect, self.robot).items():
                if term in c.kept:
                    own[term] = own.get(term, 0.0) + value
        return {joint: own for joint, own in out.items() if own}


def name(effect: Effect) -> str:
    """Effect and place, for people."""
    return f"{effect.effect} ({effect.joints[0] if effect.joints else 'whole robot'})"


def values(effect: Effect) -> str:
    """Parameters with standard errors and units, and settings, in one line."""
    units = {p.name: p.unit for p in family(effect.effect).parameters}
    parts = []
    for key, value in effect.parameters.items():
        error = effect.std_errors.get(key)
        unit = units.get(key.rpartition("/")[2], "")
        spread = "" if error is None else f" +- {error:.2g}"
        parts.append(f"{key} {value:.6g}{spread} {'' if unit == '1' else unit}".rstrip())
    return ", ".join(parts + [f"{key} {value}" for key, value in effect.settings.items()])
