"""Friction or rotors that are the same on every joint, as different drives have not: told, since a controller's are.

A commanded torque is what the gains of a controller make of the motion. Where these gains are the same for all joints,
so is what it looks like: rotors and viscous friction of one size, whatever the joint carries. (Found on a public
recording of a Kinova Gen3: 9 kg m^2 and 9 N m s/rad on every joint, the last one included.)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.effects import Effect, family
from hybrid_dynamics.effects.base import ONLY_RUN
from hybrid_dynamics.effects.units import unit_of
from hybrid_dynamics.robots import Robot

#: Joints that have it, at least; and how far one may be from their mean, as a share of it or in its standard errors.
FEWEST, SHARE, ERRORS = 5, 0.1, 2.0
#: Two standard errors of what is known are at most this share of the mean.
KNOWN = 0.4


def same_everywhere(robot: Robot, effects: Sequence[Effect]) -> list[str]:
    """A sentence on coefficients among ``effects`` that are surely alike on all joints of ``robot`` but one, if any.

    Of plain effects of one coefficient that follow speed or acceleration: dry friction and offsets are a few newton
    metres on many arms. Not of a robot with slides: a newton second per metre is no newton metre second per radian.
    """
    told = []
    if robot.prismatic:
        return []
    for name in sorted({e.effect for e in effects if e.joints and _grows(e)}):
        own = {e.joints[0]: e for e in effects if e.effect == name and e.is_finding and ONLY_RUN not in e.settings}
        values = np.array([next(iter(e.parameters.values())) for e in own.values()])
        errors = np.array([next(iter(e.std_errors.values()), 0.0) for e in own.values()])
        if len(own) < max(FEWEST, robot.n_joints - 1) or np.median(values) <= 0:
            continue
        mean = float(np.median(values))
        alike = np.abs(values - mean) <= np.maximum(SHARE * mean, ERRORS * errors)
        # What nothing is known of is alike to anything.
        known = alike & (errors > 0) & (ERRORS * errors < KNOWN * mean)
        if known.sum() >= max(FEWEST, robot.n_joints - 2) and alike.sum() >= robot.n_joints - 1:
            one = next(iter(own.values()))
            unit = unit_of(one, next(iter(one.parameters)), ())
            told.append(f"{name} is {mean:.2g} {unit} on {alike.sum()} of {robot.n_joints} joints")
    if not told:
        return []
    return [
        f"{' and '.join(told)}, whatever these carry: identical drives, or not a measured torque but what a controller "
        "with one gain for all joints commands; see what the log's torque is"
    ]


def _grows(effect: Effect) -> bool:
    """True for what is zero at rest: one coefficient times speed or acceleration."""
    kind = family(effect.effect)
    return kind.everywhere and not kind.turns_sign and kind.drawn_against in ("dq", "ddq")
