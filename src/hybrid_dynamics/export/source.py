"""What is exported: a completed model, the URDF it belongs to, and what is said about both in every exported file."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hybrid_dynamics.effects import Effect, family
from hybrid_dynamics.effects.together import together
from hybrid_dynamics.effects.units import unit_of
from hybrid_dynamics.export.carry import OF_THE_RECORDING, carried, losses
from hybrid_dynamics.export.terms import Terms, terms
from hybrid_dynamics.loop.model import Model, load_model, read_model
from hybrid_dynamics.loop.uncertainty import Uncertainty, uncertain_parameters, uncertainty_from
from hybrid_dynamics.robots import Robot

if TYPE_CHECKING:
    from hybrid_dynamics.export.symbolic import SymbolicModel


@dataclass(frozen=True)
class Rendered:
    """What an export consists of: files by name (the first is the one asked for), and notes for the user."""

    files: Mapping[str, bytes]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Source:
    """``model`` with the URDF it was made for; ``lock``: joints fixed at zero; ``uncertainty`` where it is known."""

    model: Model
    urdf: Path
    lock: tuple[str, ...] = ()
    uncertainty: Uncertainty | None = None

    @classmethod
    def read(cls, model: Path, urdf: Path, lock: tuple[str, ...] = ()) -> Source:
        """Read both files; :class:`InputError` names what is unusable or does not fit together."""
        completed = load_model(model, Robot.from_urdf(urdf, lock))
        block = read_model(model).get("uncertainty")
        return cls(completed, urdf, lock, None if block is None else uncertainty_from(block))

    @property
    def robot(self) -> Robot:
        """The robot before any effect."""
        return self.model.robot

    @property
    def inactive(self) -> tuple[Effect, ...]:
        """Effects that ``model.json`` keeps on record without letting them act: they are not exported."""
        return self.model.inactive

    @property
    def effects(self) -> tuple[Effect, ...]:
        """What acts, for people: what was there before and what changed since as one."""
        return tuple(together(self.model.effects, self.robot))

    @cached_property
    def kept(self) -> Model:
        """The model without what belongs to the recording rather than to the robot, which no format carries."""
        own = (e for e in self.model.effects if not set(terms(e, self.robot)) & set(OF_THE_RECORDING))
        return Model(self.robot, tuple(own))

    @property
    def symbolic(self) -> SymbolicModel:
        """What is kept, as CasADi functions."""
        from hybrid_dynamics.export.symbolic import SymbolicModel  # CasADi: the descriptions do without it

        if self.uncertainty is None:
            left = None if self.model.misfit is None else np.array(self.model.misfit)
            return SymbolicModel(self.kept, left)
        kept = [any(e is effect for e in self.kept.effects) for effect in self.model.effects]
        chosen = [kept[k] for k, _ in uncertain_parameters(self.model.effects)]
        correlation = self.uncertainty.correlation
        if correlation is not None:
            fits = len(correlation) == len(chosen)
            correlation = correlation[np.ix_(chosen, chosen)] if fits else None
        return SymbolicModel(self.kept, self.uncertainty.residual, correlation)

    def losses(self, form: str) -> list[str]:
        """One line for every kind of effect that format ``form`` cannot carry, or only in part."""
        return losses(carried(form, self.effects, self.robot))

    def head(self, form: str) -> list[str]:
        """Lines for the head of the exported file: where it comes from, what is in it, what is not."""
        lines = [
            f"Written by hybrid-dynamics {version('hybrid-dynamics')} (export --format {form}).",
            f"Robot {self.robot.name}; joints {', '.join(self.robot.joint_names)}. SI units.",
        ]
        if self.lock:
            lines.append(f"Joints held at zero: {', '.join(self.lock)}.")
        held = [f"  {name(effect)}: {values(effect, self.robot.prismatic)}" for effect in self.effects]
        lines += ["Effects of the completed model:", *(held or ["  none"])]
        lost = self.losses(form)
        if lost:
            lines += ["This format cannot carry:", *(f"  {line}" for line in lost)]
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
    """Effect and place, for people; of what is estimated beside others only, that it is no finding."""
    place = effect.joints[0] if effect.joints else "whole robot"
    return f"{effect.effect} ({place}{'' if effect.is_finding else ', no finding'})"


def values(effect: Effect, slides: Collection[str]) -> str:
    """Parameters with standard errors and units, and settings, in one line; ``slides`` are the prismatic joints."""
    parts = []
    for key, value in effect.parameters.items():
        error = effect.std_errors.get(key)
        unit = unit_of(effect, key, slides)
        spread = "" if error is None else f" +- {error:.2g}"
        parts.append(f"{key} {value:.6g}{spread} {'' if unit == '1' else unit}".rstrip())
    return ", ".join(parts + [f"{key} {value}" for key, value in effect.settings.items()])
