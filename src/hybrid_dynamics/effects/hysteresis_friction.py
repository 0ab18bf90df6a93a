"""Friction with presliding hysteresis (Dahl, or LuGre): tau = K z (+ c dz/dt), dz/dt = dq - abs(dq) z K/g.

Dahl's (1968): g = Fc, and no c. Written with z scaled to Fc: tau = Fc z, dz/dq = (1 - z sign(dq)) / s with the
presliding displacement s = Fc/K, which is what is refined; given s the torque is linear in Fc. The published stiffness
is K = Fc/s.

LuGre's, setting ``law`` ``lugre``: the level falls with the speed as Stribeck's, g = Fc + (Fs - Fc) exp(-(dq/vs)^2),
and the micro-damping c adds to it (Canudas de Wit, Olsson, Astrom and Lischinsky, IEEE TAC 40(3), 1995, eqs. 1 to 3).
Coordinates (Fc, c); the ratio Fs/Fc and the Stribeck velocity vs are refined, too. A joint that hardly moves slowly
shows the micro-damping and not the fall: ``law`` ``damped`` is LuGre's with g = Fc.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hybrid_dynamics.effects.base import Effect, Family, Term, register
from hybrid_dynamics.effects.sign import SIGN_DISPLACEMENT
from hybrid_dynamics.effects.state import Equivalence, Motion, Parameter, Refined, Settings, State
from hybrid_dynamics.effects.stribeck_friction import MOST_FALL, VELOCITY
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

DISPLACEMENT, RATIO = "presliding_displacement", "static_ratio"
LAW, DAHL, DAMPED, LUGRE = "law", "dahl", "damped", "lugre"
#: Displacements [rad] the search starts from; what is shorter is how Coulomb friction turns over (effects/sign.py).
_GRID = (4e-3, 2e-2, 1e-1)
#: LuGre's law starts from: speeds [rad/s], and friction at rest over that in motion.
_SPEEDS, _RATIO = (0.03, 0.1, 0.3), 1.5
STRIBECK, _DAMPING = "stribeck_friction", "micro_damping"
#: Standard errors beyond which a number of LuGre's law is known.
_SURE = 2.0
#: A ratio this near to one is one.
_ROUNDING = 1e-6
#: Displacement [rad] of no friction.
_LEAST = 1e-9


@register
class HysteresisFriction(Family):
    name = "hysteresis_friction"
    scope = "joint"
    is_friction = True
    known_settings = (LAW,)
    equation = (
        r"\tau = K z,\quad \dot z = \dot q - |\dot q|\,z\,K / g,\quad g = F_c\quad\text{or}\quad "
        r"\tau = K z + c\,\dot z,\ g = F_c + (F_s - F_c)\,e^{-(\dot q / v_s)^2}"
    )
    parameters = (
        Parameter("presliding_stiffness", "N m/rad"),
        Parameter("coulomb_torque", "N m"),
        Parameter("static_torque", "N m"),
        Parameter(_DAMPING, "N m s/rad"),
        Parameter(VELOCITY, "rad/s"),
    )
    size = 1
    searched = False
    says_where = ("presliding_stiffness",)
    nonlinear_settings = (
        Refined(DISPLACEMENT, 1e-3, 0.5),
        Refined(RATIO, 1.0, MOST_FALL),
        Refined(VELOCITY, 0.01, 1.0),
    )
    contains = ("coulomb_friction",)
    drawn_against = "q"
    shown_by = "the joint reverses within a few hundredths of a radian, again and again"
    equivalent_to = (
        Equivalence(
            ("coulomb_friction",),
            "once the joint has moved further than the presliding displacement both are the same",
            "let the joint reverse within a few hundredths of a radian",
        ),
        Equivalence(
            ("joint_spring",),
            "within the presliding displacement friction is a spring",
            "move the joint further than a tenth of a radian",
        ),
    )

    def grid(self, options: Mapping[str, Any]) -> list[Settings]:
        return [((DISPLACEMENT, s),) for s in _GRID]

    def nonlinear_of(self, settings: Mapping[str, Any]) -> tuple[Refined, ...]:
        return self.nonlinear_settings if _falls(settings) else self.nonlinear_settings[:1]

    def richer(self, own: Sequence[Term]) -> list[Term]:
        """LuGre's friction in the place of Dahl's or Stribeck's."""
        alike = [t for t in own if t.effect in (self.name, STRIBECK)]
        if not alike or any(_falls(t.options) for t in own):
            return []
        at = {name: value for t in alike for name, value in t.options.items()}
        ways = [at[DISPLACEMENT]] if DISPLACEMENT in at else _GRID
        speeds = [at[VELOCITY]] if VELOCITY in at else _SPEEDS
        values = [{DISPLACEMENT: s, LAW: LUGRE, RATIO: _RATIO, VELOCITY: v} for s in ways for v in speeds]
        return [Term(self.name, alike[0].joint, tuple(sorted(v.items()))) for v in values]

    def plainer(self, term: Term) -> Term | None:
        """The law with one level in the place of LuGre's, Dahl's in the place of that, and in the place of Dahl's
        Coulomb friction whose sign turns over within that distance: a way of turning over, and no finding."""
        own = (DISPLACEMENT, term.options[DISPLACEMENT])
        if _form(term.options) == DAHL:
            return Term("coulomb_friction", term.joint, ((SIGN_DISPLACEMENT, own[1]),))
        return replace(term, settings=((LAW, DAMPED), own) if _falls(term.options) else (own,))

    def is_known(self, effect: Effect) -> bool:
        """The stiffness and the level, and what one rises over the other and its speed, or else the micro-damping, each
        beyond :data:`_SURE` standard errors; beside a fall micro-damping may be nothing."""
        values, errors = dict(effect.parameters), dict(effect.std_errors)
        if _falls(effect.settings):
            least, most = "coulomb_torque", "static_torque"
            values["rise"] = values[most] - values[least]
            errors["rise"] = float(np.hypot(errors[most], errors[least]))
            del values[_DAMPING]
        return all(v > _SURE * errors[name] for name, v in values.items())

    def size_of(self, term: Term) -> int:
        return 1 if _form(term.options) == DAHL else 2

    def covers(self, term: Term, special: Term) -> bool:
        rise = _falls(term.options) and special.effect == STRIBECK and special.joint == term.joint
        return rise or super().covers(term, special)

    def published(self, settings: Mapping[str, Any]) -> tuple[str, ...]:
        names = tuple(p.name for p in self.parameters)
        return {DAHL: names[:2], DAMPED: (*names[:2], _DAMPING), LUGRE: names}[_form(settings)]

    def in_descriptions(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> dict[str, float]:
        least = parameters["coulomb_torque"]
        out = {"dry_friction": least, "gradual_reversal": 1.0}
        return out | {"stribeck_rise": parameters["static_torque"] - least} if _falls(settings) else out

    def law(self, xp: Any, at: State, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        if at.z is None:
            return _height(xp, at.own_dq, parameters, settings) * xp.sign(at.own_dq)
        held = parameters["coulomb_torque"] * at.z
        if _form(settings) == DAHL:
            return held
        level = self.memory_level(xp, at.own_dq, parameters, settings)
        return held + parameters[_DAMPING] * (at.own_dq - xp.abs(at.own_dq) * at.z / level)

    def presliding(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> float | None:
        # Of what a starting model has too much both numbers are negative, and the distance is its own.
        least, stiffness = parameters["coulomb_torque"], parameters["presliding_stiffness"]
        return least / stiffness if least * stiffness > 0 else None

    def memory_level(self, xp: Any, dq: Any, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        # Numbers may be symbols: asked only where there is a memory, and so friction.
        return _height(xp, dq, parameters, settings) / parameters["coulomb_torque"] if _falls(settings) else 1.0

    def columns(self, motion: Motion, term: Term) -> Array:
        whole = super().columns(motion, term)
        if term.size > 1:
            # Micro-damping alone has no state to follow: beside the level of the first column it has that one's.
            both = self.parameters_of(np.ones(2), motion.robot, term)
            whole[:, 1] = self.along(motion.state(term.index), both, term.options) - whole[:, 0]
        return whole

    def lower_bounds(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        return np.zeros(self.size if term is None else term.size)

    def setting_values(self, parameters: Mapping[str, float]) -> dict[str, float]:
        least, stiffness = parameters["coulomb_torque"], parameters["presliding_stiffness"]
        values = {DISPLACEMENT: _rounded(least / stiffness) if least * stiffness > 0 else _LEAST}
        if VELOCITY not in parameters:
            return values
        ratio = _rounded(parameters["static_torque"] / least) if least else 1.0
        return values | {RATIO: ratio, VELOCITY: parameters[VELOCITY]}

    def forbidden(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> str:
        if not _falls(settings):
            return ""
        # Of a change of a starting model both may be negative.
        least, most = parameters["coulomb_torque"], parameters["static_torque"]
        falls = most == 0.0 if least == 0.0 else most / least >= 1.0 - _ROUNDING
        return "" if falls else "expected a static_torque of at least the coulomb_torque, and this above 0"

    def parameters_of(self, x: Array, robot: Robot, term: Term) -> dict[str, float]:
        least, own = float(x[0]), term.options
        values = {"presliding_stiffness": least / own[DISPLACEMENT], "coulomb_torque": least}
        if _falls(own):
            values |= {"static_torque": least * own[RATIO], _DAMPING: float(x[1]), VELOCITY: float(own[VELOCITY])}
        elif len(x) > 1:
            values |= {_DAMPING: float(x[1])}
        return values

    def coordinates_of(self, parameters: Mapping[str, float], robot: Robot, term: Term) -> Array:
        return np.array([parameters[name] for name in ("coulomb_torque", _DAMPING)[: self.size_of(term)]])


def _form(settings: Mapping[str, Any]) -> str:
    return str(settings.get(LAW, DAHL))


def _falls(settings: Mapping[str, Any]) -> bool:
    """True where the level of friction falls with the speed."""
    return _form(settings) == LUGRE


def _rounded(value: float) -> float:
    """``value`` to the digits to which settings are refined: a change of the same law has the same ones."""
    return float(f"{value:.6g}")


def _height(xp: Any, dq: Any, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
    """Friction [N m] that the joint comes to at the speed ``dq``."""
    least = parameters["coulomb_torque"]
    if not _falls(settings):
        return least
    speed = dq / parameters[VELOCITY]
    return least + (parameters["static_torque"] - least) * xp.exp(-speed * speed)
