"""Coordinates of effects as effects with values; the joint re-fit of all of them; the completed model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.tangents import published_covariance
from hybrid_dynamics.types import Array

#: A Gauss-Newton step is halved so often at most, and the last where the error falls by no more than this share.
HALVINGS, SETTLED = 6, 1e-6
#: A step that lowers the error by this multiple of what its tangent promised is tried at twice the length.
UNDERSTATED = 1.3
#: An error that the linear problem has foretold within this share is at its end. Of 52 re-fits of a recorded arm 24
#: were, and none of them would have come further down than by 6e-7 of it.
FORETOLD = 1e-5


def effects_of(evidence: Evidence, terms: Sequence[Term], x: Array, covariance: Array | None = None) -> list[Effect]:
    """Coordinates ``x`` as effects with published parameters and their standard errors.

    ``covariance`` of the coordinates, or of them and the nonlinear parameters behind them (:mod:`.tangents`).
    """
    layout = evidence.layout(terms)
    behind = layout.total
    names = evidence.robot.joint_names
    out = []
    for term, start in zip(layout.terms, layout.starts, strict=True):
        kind = term.family()
        own = slice(start, start + term.size)
        values = kind.parameters_of(x[own], evidence.robot, term)
        errors: dict[str, float] = {}
        if covariance is not None:
            jacobian, which = kind.jacobian(x[own], evidence.robot, term), list(range(own.start, own.stop))
            refined = len(kind.refined_at(term))
            if len(covariance) > layout.total and refined:
                jacobian = np.hstack([jacobian, kind.setting_jacobian(x[own], evidence.robot, term)])
                which += range(behind, behind + refined)
                behind += refined
            variance = np.einsum("ij,jk,ik->i", jacobian, covariance[np.ix_(which, which)], jacobian)
            errors = {k: float(np.sqrt(max(v, 0.0))) for k, v in zip(values, variance, strict=True)}
        joints = () if term.joint is None else (names[term.joint],)
        out.append(Effect(term.effect, joints, values, dict(term.settings), errors))
    return out


@dataclass(frozen=True)
class Refit:
    """The coordinates ``x`` of a model with ``terms`` that was re-fitted, which leaves ``left`` (K, n) [N m] of every
    run where that was asked for; ``before``: the evidence whose fit it is, as of this model where ``left`` is None."""

    before: Evidence
    terms: tuple[Term, ...]
    x: Array
    left: tuple[Array, ...] | None = None

    @cached_property
    def evidence(self) -> Evidence:
        """The evidence as of this model. Who wants the model alone spares its columns."""
        if self.left is None:
            return self.before
        return _tangent(self.before, self.terms, self.x, self.left)

    def model(self, covariance: bool = True) -> Model:
        """The completed model: the start and the effects, with their standard errors where these are asked for."""
        own = published_covariance(self.evidence, self.terms, self.x) if covariance else None
        return self.before.base.adding(effects_of(self.before, self.terms, self.x, own))


def refit(evidence: Evidence, terms: Sequence[Term], rounds: int = 3) -> Refit:
    """Gauss-Newton re-fit of all coordinates of ``terms`` from where ``evidence`` stands; one round where everything is
    linear.

    Columns that follow the load or the torque, also those of candidates, are then of the model that was fitted.
    """
    kinds = [term.family() for term in terms]
    bodies = any(k.changes_body for k in kinds)
    # What turns all bodies, or gravity, and what changes one of them multiply.
    turned = any(k.uses_body for k in kinds) and any(k.changes_body and not k.uses_body for k in kinds)
    if any(k.nonlinear for k in kinds) or turned or (evidence.problem.base_follows_load and bodies):
        return _descend(evidence, terms, rounds)
    evidence = evidence.with_base_target()
    x = evidence.fit(terms)
    following = bool(evidence.layout(terms).following)
    for _ in range(rounds if following else 1):
        evidence = evidence.at(effects_of(evidence, terms, x), terms)
        x = evidence.fit(terms) if following else x
    return Refit(evidence, tuple(terms), x)


def _descend(evidence: Evidence, terms: Sequence[Term], rounds: int) -> Refit:
    """Gauss-Newton, where a step that makes the training error of the whole model larger is halved.

    The linear problem that comes with them (:attr:`Refit.evidence`) is exact at the coordinates that are returned.
    """
    problem = evidence.problem

    def exact(x: Array) -> tuple[tuple[Array, ...], float]:
        # Far from where a law means something numbers run over: that is a large error, not a fault.
        with np.errstate(over="ignore", invalid="ignore"):
            left = problem.left(effects_of(evidence, terms, x))
            error = evidence.squared_error(left)
        return left, error if np.isfinite(error) else np.inf

    limits = evidence.constraints(evidence.layout(terms))
    start = evidence.squared_error(problem.base_target)
    best = evidence.fit(terms)
    foretold = evidence.squared_error(evidence.residuals(terms, best))
    left, error = exact(best)
    if abs(error - foretold) <= FORETOLD * error <= FORETOLD * start:
        return Refit(evidence, tuple(terms), best, left)
    if error > start:
        # The tangent was that of another model: once more from the model without these effects.
        best = evidence.at([], terms).fit(terms)
        for _ in range(2 * HALVINGS):
            left, error = exact(best)
            if error <= start:
                break
            best = best / 2
        else:
            left, error = exact(best)
    for _ in range(rounds):
        evidence = _tangent(evidence, terms, best, left)
        step = evidence.fit(terms) - best
        promised = error - evidence.squared_error(evidence.residuals(terms, best + step))
        for _ in range(HALVINGS):
            further, trial = exact(best + step)
            if trial <= error:
                break
            step = step / 2
        else:
            break
        # Noise of the motion makes a column (a delay's above all) larger than what it is the derivative of, and steps
        # too short. Only what physics allows: beyond the fit nothing holds the coordinates.
        for _ in range(HALVINGS):
            twice = np.maximum(best + 2 * step, limits.lower)
            if error - trial <= UNDERSTATED * promised or not limits.satisfied(twice):
                break
            longer = exact(twice)
            if not longer[1] < trial:
                break
            step, (further, trial) = twice - best, longer
        settled = trial > (1 - SETTLED) * error
        best, left, error = best + step, further, trial
        if settled:
            break
    return Refit(evidence, tuple(terms), best, left)


def _tangent(evidence: Evidence, terms: Sequence[Term], x: Array, left: Sequence[Array]) -> Evidence:
    """The linear problem that is exact at the coordinates ``x`` of ``terms``, which leave ``left`` of every run."""
    return evidence.tangent(effects_of(evidence, terms, x), left, terms, x)


def model_of(evidence: Evidence, terms: Sequence[Term], covariance: bool = True) -> Model:
    """The completed model: the start and the effects of ``terms`` fitted on all training rows."""
    return refit(evidence, terms).model(covariance)
