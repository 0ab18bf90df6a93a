"""An arm on a wall or under a ceiling: the search starts from where gravity is, not from where the URDF has it.

The torque of a tilt is linear in the vector of gravity, so a tilt of any angle is found at once. What the other bodies
would do is not: columns of links, payloads and loads are those of the gravity that the search starts from, and a
quarter turn away they are those of another robot. Where the logs show beforehand that the arm is mounted otherwise
(:mod:`hybrid_dynamics.check`), or where the tilt that was found is large, the search (again) starts from the turned
base. The tilt is a finding like any other, its angles those against the level.

Walls and ceilings are upright to a degree, and in few poses a tilt of some degrees and the first moments of all links
are each other's: where gravity is found near an axis of the base the search starts from along it, and the tilt is held
to it (:data:`hybrid_dynamics.effects.gravity_tilt.UPRIGHT`). Found on a Rokae AR5 on its side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hybrid_dynamics.check.guess import angle
from hybrid_dynamics.check.torque import WEIGHED_WRONGLY
from hybrid_dynamics.effects import Effect, Term, mounted
from hybrid_dynamics.effects.gravity_tilt import is_along_an_axis
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.types import Array

#: A base that turned out to be tilted by more than this [rad] is searched once more from there: links that are off are
#: then seen wrongly by a tenth.
MUCH = 0.1
#: What the logs show beforehand, as if links weighed what they should, is a first guess: it is searched once more from
#: where the search has left the base, unless that is as near [rad] as no pose tells.
NEAR = 1e-3
#: Gravity so near [rad] an axis of the base is along it, as far as is known beforehand, and as a search has found it
#: that was held to the axis.
ALONG, STILL_ALONG = np.deg2rad(3.0), np.deg2rad(1.0)


def as_mounted(start: Model, gravity: Array, settings: LoopSettings) -> Model:
    """``start`` with its base turned so that gravity points along ``gravity`` (3,), where that is another mounting.

    Smaller angles links of another weight could feign: there the search decides.
    """
    tilt = mounted(_upright(gravity, ALONG))
    if tilt.effect not in settings.families or angle(gravity, _gravity(start)) <= WEIGHED_WRONGLY:
        return start
    return _with(start, tilt)


def as_found(start: Model, searched: Model, found: Sequence[Effect]) -> Model | None:
    """``start`` with its base turned as the ``found`` effects have it, where that is far from ``searched``, from which
    the search began; else None."""
    gravity = _upright(_gravity(start.adding(found)), STILL_ALONG)
    limit = MUCH if searched is start else NEAR
    return _with(start, mounted(gravity)) if angle(gravity, _gravity(searched)) > limit else None


def _upright(gravity: Array, near: float) -> Array:
    """``gravity`` (3,), along the axis of the base that it is ``near`` [rad] to, if it is to one."""
    axis = int(np.argmax(np.abs(gravity)))
    along = np.zeros(3)
    along[axis] = np.copysign(np.linalg.norm(gravity), gravity[axis])
    return along if angle(gravity, along) <= near else gravity


def turned_by(start: Model, searched: Model) -> list[Term]:
    """What ``searched``, from which a search starts, has beyond ``start``, from which the loop does."""
    return [effect.term(start.robot) for effect in searched.effects[len(start.effects) :]]


def held_upright(start: Model, searched: Model) -> list[str]:
    """A note where ``searched``, from which a search began, has the base of ``start`` on a wall or under a ceiling."""
    if not (turned_by(start, searched) and is_along_an_axis(_gravity(searched))):
        return []
    return [
        "the base is taken to stand upright on its wall or under its ceiling, to half a degree: these runs need not "
        "show that, and a lean of that size may be links that weigh otherwise"
    ]


def _with(start: Model, tilt: Effect) -> Model:
    return replace(start, effects=(*start.effects, tilt))


def _gravity(model: Model) -> Array:
    return np.asarray(model.completed_robot.model.gravity.linear, float)
