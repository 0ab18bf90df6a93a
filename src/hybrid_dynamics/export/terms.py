"""An effect in the terms of robot description formats: damping, dry friction, offset, spring, inertia, ...

A format carries some of these terms (see :mod:`.carry`); what an effect has beyond them is a term too, with a name that
says what is lost. A family that says nothing of itself (``Family.in_descriptions``) is a ``law``: only formats that
hold programs carry it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hybrid_dynamics.effects import Effect, family
from hybrid_dynamics.effects.base import ONLY_RUN
from hybrid_dynamics.effects.sign import SIGN_DISPLACEMENT, WIDTH
from hybrid_dynamics.export.body import BodyNumbers
from hybrid_dynamics.robots import Robot

Terms = dict[str, float]

#: What each term is, in words that follow "without the".
WORDS: dict[str, str] = {
    "inertia": "mass, centre of mass and inertia of links",
    "armature": "rotor inertia (armature)",
    "gravity": "direction of gravity (base not level)",
    "damping": "viscous friction",
    "quadratic_damping": "friction with the square of the speed",
    "cubic_damping": "friction with the cube of the speed",
    "dry_friction": "Coulomb friction",
    "gradual_reversal": "gradual turn-over of friction at a reversal (over a speed or a displacement)",
    "stribeck_rise": "rise of friction towards standstill",
    "offset": "constant torque",
    "stiffness": "spring that is linear in the joint's position",
    "position_offset": "offset of a joint's position reading",
    "gain": "gain of a joint's torque reading",
    "delay": "delay of the recording",
    "one_run": "what happened in one recorded run only",
    "law": "torque law that is a program",
}

#: Power of the speed, by the families' ``viscous_powers``.
_DAMPING = {1: "damping", 2: "quadratic_damping", 3: "cubic_damping"}


def terms(effect: Effect, robot: Robot) -> Terms:
    """The terms of ``effect`` in ``robot``, each with its value (1 where it has no single number)."""
    kind = family(effect.effect)
    if ONLY_RUN in effect.settings:
        return {"one_run": 1.0}
    if kind.changes_body:
        return _body_terms(effect, robot)
    if kind.viscous_powers:
        x = kind.coordinates_of(effect.parameters, robot, effect.term(robot))
        return {_DAMPING[power]: float(v) for power, v in zip(kind.viscous_powers, x, strict=True)}
    out = kind.in_descriptions(effect.parameters, effect.settings)
    if {WIDTH, SIGN_DISPLACEMENT} & set(effect.settings) and "law" not in out:
        out["gradual_reversal"] = 1.0
    return out


def _body_terms(effect: Effect, robot: Robot) -> Terms:
    """What of the rigid body changes when the effect enters it."""
    changed = robot.copy()
    family(effect.effect).change(changed, effect)
    before, after = BodyNumbers.of(robot), BodyNumbers.of(changed)
    pairs: dict[str, tuple[Any, Any]] = {
        "inertia": (before.inertias, after.inertias),
        "armature": (before.armature, after.armature),
        "gravity": (before.gravity, after.gravity),
    }
    return {name: 1.0 for name, (old, new) in pairs.items() if not np.array_equal(old, new)}
