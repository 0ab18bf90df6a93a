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
#: Degree of the slow curve; harmonics whose waves are made at once; what keeps waves apart that are nearly alike.
_DEGREE, _AT_ONCE, _RIDGE = 4, 32, 1e-6
#: Harmonics that are asked between two neighbours.
_BETWEEN = 33
#: A harmonic and its double are offered where they leave less than this share of what one harmonic leaves.
_DOUBLE = 0.5


def spectrum(
    q: Array,
    residual: Array,
    highest: float = _HIGHEST,
    multiples: tuple[int, ...] = (1,),
    asked: Array | None = None,
) -> tuple[Array, Array]:
    """Harmonics [1/rad] and the share (0 to 1) of the variance over positions ``q`` (T,) that each explains, together
    with its ``multiples``; ``asked``: of these harmonics alone.

    Least squares of sines and cosines beside a slow curve, on means over narrow bins of position: positions need not be
    even, and may lie in patches shorter than a period.
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
    # What is slow over the range belongs to gravity, springs and offsets. Sines are asked beside it, not after it: over
    # a few patches it makes much of a sine.
    root = np.sqrt(weight)
    slow = np.linalg.qr(
        np.polynomial.chebyshev.chebvander(2 * (middle - middle[0]) / span - 1, _DEGREE) * root[:, None]
    )[0]
    rest = root * mean - slow @ (slow.T @ (root * mean))
    lowest = _least(q)
    top = min(highest / max(multiples), np.pi * 0.25 * len(middle) / span)
    harmonics = np.arange(lowest, max(top, lowest), np.pi / (2 * span)) if asked is None else asked
    power = float(rest @ rest)
    if not len(harmonics) or power <= 0:
        return np.zeros(0), np.zeros(0)
    share = np.empty(len(harmonics))
    for low in range(0, len(harmonics), _AT_ONCE):
        some = harmonics[low : low + _AT_ONCE]
        phase = np.multiply.outer(some, np.outer(multiples, middle))
        waves = np.concatenate([np.sin(phase), np.cos(phase)], axis=1) * root
        waves -= (waves @ slow) @ slow.T
        size = np.maximum(np.linalg.norm(waves, axis=2), 1e-12 * np.sqrt(weight.sum()))
        waves /= size[:, :, None]
        product = waves @ rest
        gram = waves @ waves.transpose(0, 2, 1) + _RIDGE * np.eye(waves.shape[1])
        share[low : low + _AT_ONCE] = (
            np.sum(product * np.linalg.solve(gram, product[:, :, None])[:, :, 0], axis=1) / power
        )
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
    like_noise = True
    says_where = ("phase",)
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
            out += [self.at(int(j), n) for n in _prominent(q[:, j], left[:, j])]
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


def _least(q: Array) -> float:
    """The lowest harmonic [1/rad] of a ripple: so many periods lie within the range of positions ``q`` (T,)."""
    return 2 * np.pi * _PERIODS / float(np.ptp(q))


def _prominent(q: Array, left: Array) -> list[float]:
    """Harmonics [1/rad] that stand out of what is ``left`` (T,) [N m] over the positions ``q`` (T,)."""
    harmonics, share = spectrum(q, left)
    if not len(share):
        return []
    twice, both = spectrum(q, left, multiples=(1, 2))
    top = int(np.argmax(both)) if len(both) else 0
    lowest = _least(q)
    # Teeth and poles make a wave and its double; where both are large neither stands out alone.
    if len(both) and both[top] > _PROMINENCE * np.median(both) and 1.0 - both[top] < _DOUBLE * (1.0 - share.max()):
        n = _sharper(q, left, float(twice[top]), (1, 2))
        if n >= lowest:
            return [n, 2.0 * n]
    out: list[float] = []
    level = float(np.median(share))
    for _ in range(_OFFERED):
        if share.max() < max(_PROMINENCE * level, 1e-3):
            break
        n = float(harmonics[int(np.argmax(share))])
        sharp = _sharper(q, left, n, (1,))
        # The foot of something slower, fewer than two periods over the range, is no harmonic of a ripple.
        if sharp < lowest:
            break
        out.append(sharp)
        share = np.where(np.abs(harmonics - n) < 2 * np.pi / float(np.ptp(q)), 0.0, share)
    return out


def _sharper(q: Array, left: Array, harmonic: float, multiples: tuple[int, ...]) -> float:
    """The best harmonic [1/rad] between the neighbours of ``harmonic`` in the spectrum: from one patch of positions to
    another far from it a small difference is another phase."""
    step = np.pi / (2 * float(np.ptp(q)))
    asked, share = spectrum(q, left, multiples=multiples, asked=harmonic + step * np.linspace(-1.0, 1.0, _BETWEEN))
    return float(f"{asked[int(np.argmax(share))]:.6g}")
