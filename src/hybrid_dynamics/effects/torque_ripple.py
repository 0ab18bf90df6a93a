"""Torque that repeats with the position (cogging, a gear's teeth): tau = A sin(n q + phi), A >= 0.

Coordinates (a, b) of a sin(n q) + b cos(n q); the harmonic n [1/rad] is refined from values that the residual's
spectrum over the position proposes. Several may sit on one joint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Family, Term, register
from hybrid_dynamics.effects.state import Equivalence, Motion, Parameter, Refined, State
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

HARMONIC = "harmonic"
#: Harmonics a joint is offered at most, and how far their power must stand out of the median of the spectrum.
_OFFERED, _PROMINENCE = 2, 6.0
#: Periods within the range seen that a ripple must have, so that it is none of spring, offset and gravity.
_PERIODS = 2.0
_HIGHEST = 150.0  # 1/rad
_BINS = 4096


def spectrum(q: Array, residual: Array, highest: float = _HIGHEST) -> tuple[Array, Array]:
    """Harmonics [1/rad] and the share (0 to 1) of the variance over positions ``q`` (T,) that each explains.

    Least squares of a sine and a cosine per harmonic on means over narrow bins of position: positions need not be even.
    """
    span = float(np.ptp(q))
    if span <= 0 or len(q) < 20:
        return np.zeros(0), np.zeros(0)
    edges = np.linspace(q.min(), q.max(), _BINS + 1)
    which = np.clip(np.digitize(q, edges) - 1, 0, _BINS - 1)
    weight = np.bincount(which, minlength=_BINS).astype(float)
    total = np.bincount(which, residual, minlength=_BINS)
    middle = 0.5 * (edges[1:] + edges[:-1])
    full = weight > 0
    weight, middle, mean = weight[full], middle[full], total[full] / weight[full]
    # What is slow over the range belongs to gravity, springs and offsets.
    slow = np.polynomial.chebyshev.chebvander(2 * (middle - middle[0]) / span - 1, 4)
    root = np.sqrt(weight)
    mean = mean - slow @ np.linalg.lstsq(slow * root[:, None], mean * root, rcond=None)[0]
    lowest = 2 * np.pi * _PERIODS / span
    top = min(highest, np.pi * 0.25 * len(middle) / span)
    harmonics = np.arange(lowest, max(top, lowest), np.pi / (2 * span))
    power = float(np.sum(weight * mean**2))
    if not len(harmonics) or power <= 0:
        return np.zeros(0), np.zeros(0)
    share = np.empty(len(harmonics))
    for low in range(0, len(harmonics), 128):
        phase = harmonics[low : low + 128, None] * middle
        s, c = np.sin(phase), np.cos(phase)
        ss, cc, sc = (s * s) @ weight, (c * c) @ weight, (s * c) @ weight
        sy, cy = s @ (weight * mean), c @ (weight * mean)
        determinant = np.maximum(ss * cc - sc**2, 1e-12 * ss * cc + 1e-300)
        share[low : low + 128] = (cc * sy**2 - 2 * sc * sy * cy + ss * cy**2) / determinant / power
    return harmonics, np.clip(share, 0.0, 1.0)


@register
class TorqueRipple(Family):
    name = "torque_ripple"
    scope = "joint"
    equation = r"\tau = A \sin(n\,q + \varphi),\quad A \ge 0"
    parameters = (Parameter("amplitude", "N m"), Parameter(HARMONIC, "1/rad"), Parameter("phase", "rad", angle=True))
    size = 2
    searched = False
    several = True
    nonlinear_settings = (Refined(HARMONIC, 0.5, 200.0, log=False),)
    drawn_against = "q"
    shown_by = "the joint moves slowly and evenly over its whole range, in both directions"
    equivalent_to = (
        Equivalence(
            ("joint_spring",),
            "a harmonic near one is a spring of sine and cosine",
            "move the joint over more than one turn, or its whole range",
        ),
    )

    def terms(self, robot: Robot, moving: NDArray[np.bool_], options: Mapping[str, Any]) -> list[Term]:
        return []  # harmonics come from the data, see propose

    def propose(
        self, names: Sequence[str], motions: Sequence[Motion], residuals: Sequence[Array], moving: NDArray[np.bool_]
    ) -> list[Term]:
        """The most prominent harmonics of what is left of each joint's torque, over its position."""
        q, left = np.concatenate([m.q for m in motions]), np.concatenate(list(residuals))
        out = []
        for j in np.flatnonzero(moving):
            harmonics, share = spectrum(q[:, j], left[:, j])
            span = float(np.ptp(q[:, j]))
            level = float(np.median(share)) if len(share) else 0.0
            for _ in range(_OFFERED):
                if not len(share) or share.max() < max(_PROMINENCE * level, 1e-3):
                    break
                # The foot of something slower, fewer than two periods over the range, is no harmonic of a ripple.
                if (top := int(np.argmax(share))) == 0:
                    break
                n = float(harmonics[top])
                out.append(self.at(int(j), n))
                share = np.where(np.abs(harmonics - n) < 2 * np.pi / span, 0.0, share)
        return out

    def at(self, joint: int, harmonic: float) -> Term:
        """The term of one harmonic [1/rad] on ``joint``."""
        return Term(self.name, joint, ((HARMONIC, float(harmonic)),))

    def place(self, term: Term) -> tuple[Any, ...]:
        return (term.effect, term.joint, round(term.options[HARMONIC]))

    def law(self, xp: Any, at: State, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        return parameters["amplitude"] * xp.sin(parameters[HARMONIC] * at.own_q + parameters["phase"])

    def parameters_of(self, x: Array, robot: Robot, term: Term) -> dict[str, float]:
        return {
            "amplitude": float(np.hypot(x[0], x[1])),
            HARMONIC: float(term.options[HARMONIC]),
            "phase": float(np.arctan2(x[1], x[0])),
        }

    def coordinates_of(self, parameters: Mapping[str, float], robot: Robot, term: Term) -> Array:
        return parameters["amplitude"] * np.array([np.cos(parameters["phase"]), np.sin(parameters["phase"])])

    def draw_term(self, robot: Robot, moving: NDArray[np.bool_], rng: np.random.Generator) -> Term:
        return self.at(int(rng.choice(np.flatnonzero(moving))), float(rng.integers(6, 30)))
