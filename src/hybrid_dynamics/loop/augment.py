"""Coordinates of effects as effects with values; the joint re-fit of all of them; the completed model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Effect, Slot
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.tangents import covariance_with_settings

Array = NDArray[np.float64]


def effects_of(evidence: Evidence, slots: Sequence[Slot], x: Array, covariance: Array | None = None) -> list[Effect]:
    """Coordinates ``x`` as effects with published parameters and their standard errors.

    ``covariance`` of the coordinates, or of them and the nonlinear parameters behind them (:mod:`.tangents`).
    """
    layout = evidence.layout(slots)
    behind = layout.total
    names = evidence.robot.joint_names
    out = []
    for slot, start in zip(layout.slots, layout.starts, strict=True):
        kind = slot.family()
        own = slice(start, start + slot.size)
        values = kind.parameters_of(x[own], evidence.robot, slot)
        errors: dict[str, float] = {}
        if covariance is not None:
            jacobian, which = kind.jacobian(x[own], evidence.robot, slot), list(range(own.start, own.stop))
            if len(covariance) > layout.total and kind.nonlinear_settings:
                jacobian = np.hstack([jacobian, kind.setting_jacobian(x[own], evidence.robot, slot)])
                which += range(behind, behind + len(kind.nonlinear_settings))
                behind += len(kind.nonlinear_settings)
            variance = np.einsum("ij,jk,ik->i", jacobian, covariance[np.ix_(which, which)], jacobian)
            errors = {k: float(np.sqrt(max(v, 0.0))) for k, v in zip(values, variance, strict=True)}
        joints = () if slot.joint is None else (names[slot.joint],)
        out.append(Effect(slot.effect, joints, values, dict(slot.settings), errors))
    return out


def refit(evidence: Evidence, slots: Sequence[Slot], rounds: int = 3, everything: bool = False) -> Array:
    """Absolute Gauss-Newton re-fit of all coordinates; one round where everything is linear.

    Columns that follow the load or the torque are those of the model that is being fitted; with ``everything`` also the
    columns of candidates.
    """
    kinds = [s.family() for s in slots]
    nonlinear = any(k.nonlinear for k in kinds) or (evidence.base_follows_load and any(k.changes_body for k in kinds))
    following = [s for s in (evidence.slots if everything else slots) if s.family().uses_load or s.family().uses_torque]
    if not nonlinear:
        evidence.reset()
    x = evidence.fit(slots)
    if nonlinear or any(s in slots for s in following):
        for _ in range(rounds):
            effects = effects_of(evidence, slots, x)
            evidence.renew(effects, [s for s in following if s in slots])
            if nonlinear:
                evidence.relinearise(effects, slots, x)
            x = evidence.fit(slots)
    if everything and following:
        evidence.renew(effects_of(evidence, slots, x), [s for s in following if s not in slots])
    return x


def model_of(evidence: Evidence, slots: Sequence[Slot], covariance: bool = True) -> Model:
    """The completed model: the start and the effects of ``slots`` fitted on all training rows."""
    x = refit(evidence, slots)
    return evidence.base.adding(
        effects_of(evidence, slots, x, covariance_with_settings(evidence, slots, x) if covariance else None)
    )
