"""Coordinates of effects as effects with values; the joint re-fit of all of them; the completed model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop.columns import follows
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.tangents import published_covariance
from hybrid_dynamics.types import Array

#: A Gauss-Newton step is halved so often at most, and the last where the error falls by no more than this share.
HALVINGS, SETTLED = 6, 1e-6
#: A step that lowers the error by this multiple of what its tangent promised is tried at twice the length.
UNDERSTATED = 1.3


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


def refit(evidence: Evidence, terms: Sequence[Term], rounds: int = 3, everything: bool = False) -> Array:
    """Absolute Gauss-Newton re-fit of all coordinates; one round where everything is linear.

    Columns that follow the load or the torque are those of the model that is being fitted; with ``everything`` also the
    columns of candidates.
    """
    kinds = [s.family() for s in terms]
    columns = evidence.columns
    nonlinear = any(k.nonlinear for k in kinds) or (columns.base_follows_load and any(k.changes_body for k in kinds))
    following = [s for s in (columns.terms if everything else terms) if follows(s)]
    if not nonlinear:
        evidence.reset()
    x = evidence.fit(terms)
    own = [s for s in following if s in terms]
    if nonlinear:
        x = _descend(evidence, terms, own, x, rounds)
    elif own:
        for _ in range(rounds):
            evidence.renew(effects_of(evidence, terms, x), own)
            x = evidence.fit(terms)
    if everything and following:
        evidence.renew(effects_of(evidence, terms, x), [s for s in following if s not in terms])
    return x


def _descend(evidence: Evidence, terms: Sequence[Term], own: Sequence[Term], x: Array, rounds: int) -> Array:
    """Gauss-Newton from ``x``, where a step that makes the training error of the whole model larger is halved.

    The linear problem is left exact at the coordinates that are returned.
    """

    def exact(x: Array) -> tuple[list[Array], float]:
        # Far from where a law means something numbers run over: that is a large error, not a fault.
        with np.errstate(over="ignore", invalid="ignore"):
            left = evidence.exact(effects_of(evidence, terms, x))
            error = evidence.squared_error(left)
        return left, error if np.isfinite(error) else np.inf

    def stand(x: Array, left: list[Array]) -> None:
        evidence.renew(effects_of(evidence, terms, x), own)
        evidence.relinearise(left, terms, x)

    limits = evidence.constraints(evidence.layout(terms))
    start = evidence.squared_error(evidence.base_target)
    best = x
    left, error = exact(best)
    if error > start:
        # The tangent was that of another model: once more from the model without these effects.
        evidence.reset()
        evidence.renew([], own)
        best = evidence.fit(terms)
        for _ in range(2 * HALVINGS):
            left, error = exact(best)
            if error <= start:
                break
            best = best / 2
        else:
            left, error = exact(best)
    stand(best, left)
    for _ in range(rounds):
        step = evidence.fit(terms) - best
        promised = error - evidence.squared_error(evidence.residuals(terms, best + step))
        for _ in range(HALVINGS):
            left, trial = exact(best + step)
            if trial <= error:
                break
            step = step / 2
        else:
            break
        # Noise of the motion makes a column (a delay's above all) larger than what it is the derivative of, and steps
        # too short. Only what physics allows: beyond the fit nothing holds the coordinates.
        for _ in range(HALVINGS):
            further = np.maximum(best + 2 * step, limits.lower)
            if error - trial <= UNDERSTATED * promised or not limits.satisfied(further):
                break
            longer = exact(further)
            if not longer[1] < trial:
                break
            step, (left, trial) = further - best, longer
        settled = trial > (1 - SETTLED) * error
        best, error = best + step, trial
        stand(best, left)
        if settled:
            break
    return best


def model_of(evidence: Evidence, terms: Sequence[Term], covariance: bool = True) -> Model:
    """The completed model: the start and the effects of ``terms`` fitted on all training rows."""
    x = refit(evidence, terms)
    return evidence.base.adding(
        effects_of(evidence, terms, x, published_covariance(evidence, terms, x) if covariance else None)
    )
