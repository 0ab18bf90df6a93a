"""Does the motion show what is to be found? Ranges, reversals, condition of the base parameters, expected errors.

The condition number is that of the base regressor with its columns scaled to unit length (Gautier and Khalil, IJRR
11(4), 1992, without weights: units differ); friction columns are part of it, because they are always sought. The
standard errors are those of least squares with the torque's noise above the motion's band.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.check.findings import Finding, Severity
from hybrid_dynamics.check.parameter_names import in_words
from hybrid_dynamics.check.samples import Stretch, direction, stretches
from hybrid_dynamics.effects.units import unit_at
from hybrid_dynamics.identification.base_parameters import base_parameters, full_regressor
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: Rows from which the condition is computed.
ROWS = 1500
#: Condition numbers that are poor and hopeless (Presse and Gautier, ICRA 1993, ask for less than 100 when designing).
POOR, HOPELESS = 300.0, 3000.0
#: Fewest reversals of a joint, and the share of its range that it should cover.
REVERSALS, COVERED = 4, 0.1
#: Parameters that a line names; of further ones the number.
SHOWN = 4


def check_excitation(robot: Robot, runs: Sequence[Trajectory]) -> list[Finding]:
    """Findings on what ``runs`` (``q tau``, uniform grids) can show."""
    parts = stretches(runs)
    if not parts:
        return []
    out = []
    low, high = robot.position_limits
    for j, name in enumerate(robot.joint_names):
        q = np.concatenate([p.q[:, j] for p in parts])
        turns = sum(_reversals(p.dq[:, j]) for p in parts)
        span = float(np.ptp(q))
        speed = max(float(np.abs(p.dq[:, j]).max()) for p in parts)
        allowed = float(high[j] - low[j]) if np.isfinite(high[j] - low[j]) and high[j] > low[j] else 2 * np.pi
        poor = span < COVERED * allowed or turns < REVERSALS
        share = f"{span / allowed:.0%} of its range" if np.isfinite(allowed) else ""
        unit = unit_at("rad", name, robot.prismatic)
        text = f"covers {span:.3g} {unit} ({share}), up to {speed:.3g} {unit}/s, {turns} reversals"
        if poor:
            text += "; move it further and to and fro, or its friction and its body cannot be told apart"
        out.append(Finding("range", "warning" if poor else "note", text, joint=name))
    return [*out, *_condition(robot, parts)]


def _reversals(dq: Array) -> int:
    """How often the direction changes, small trembling left out."""
    sides = np.sign(dq[np.abs(dq) > 0.02])
    return int(np.sum(sides[1:] != sides[:-1]))


def _condition(robot: Robot, parts: Sequence[Stretch]) -> list[Finding]:
    base = base_parameters(robot)
    q, dq, ddq, tau = (np.concatenate([getattr(p, s) for p in parts]) for s in ("q", "dq", "ddq", "tau"))
    step = max(len(q) // ROWS, 1)
    q, dq, ddq, tau = q[::step], dq[::step], ddq[::step], tau[::step]
    n = robot.n_joints
    rows = full_regressor(robot, q, dq, ddq)[:, :, base.independent]
    friction = np.zeros((len(q), n, 3 * n))
    for j in range(n):
        friction[:, j, 3 * j : 3 * j + 3] = np.column_stack([dq[:, j], direction(dq[:, j]), np.ones(len(q))])
    weight = 1.0 / np.maximum(tau.std(axis=0), 1e-9)
    table = (np.concatenate([rows, friction], axis=2) * weight[None, :, None]).reshape(len(q) * n, -1)
    names = [*base.base_names, *(f"{kind}{j + 1}" for j in range(n) for kind in ("Fv", "Fc", "b"))]
    names = [in_words(name, robot.joint_names) for name in names]
    length = np.linalg.norm(table, axis=0)
    alive = length > 1e-9 * length.max()
    unseen = [name for name, seen in zip(names, alive, strict=True) if not seen]
    scaled = table[:, alive] / length[alive]
    gram = scaled.T @ scaled
    values, vectors = np.linalg.eigh(gram)
    condition = float(np.sqrt(values[-1] / max(values[0], 1e-16)))
    weakest = np.argsort(-np.abs(vectors[:, 0]))[:3]
    kept = [name for name, seen in zip(names, alive, strict=True) if seen]
    # One independent sample in half a period of the cut-off; what is left is the noise of the fit itself.
    target = (tau * weight).reshape(-1)
    x = np.linalg.lstsq(scaled, target, rcond=1e-10)[0]
    left = float(np.sqrt(np.mean((target - scaled @ x) ** 2)))
    independent = sum(2 * p.cutoff * p.dt * len(p.q) for p in parts) / len(q)
    errors = left * np.sqrt(
        np.maximum(np.diag(np.linalg.pinv(gram, rcond=1e-12)), 0.0) / max(min(independent, 1.0), 1e-3)
    )
    vague = [kept[k] for k in np.argsort(-errors / np.maximum(np.abs(x), 1e-12)) if errors[k] > np.abs(x[k])]
    severity: Severity = "warning" if condition > POOR or unseen else "note"
    text = f"condition number of the {len(kept)} base and friction parameters is {condition:.3g}"
    if condition <= POOR:
        text += " (below 100 is good)"
    else:
        text += f" (weakest: {', '.join(kept[k] for k in weakest)}): " + (
            "some cannot be told apart at all" if condition > HOPELESS else "some can hardly be told apart"
        )
        text += "; move all joints at once, at different frequencies"
    if unseen:
        text += f"; no motion shows {_some(unseen)}"
    out = [Finding("condition", severity, text)]
    if vague:
        text = (
            f"{len(vague)} of {len(kept)} parameters would come out with an error larger than themselves "
            f"({_some(vague)}): they are small here, or the motion does not show them"
        )
        out.append(Finding("expected_errors", "note", text))
    return out


def _some(names: Sequence[str]) -> str:
    """The first of ``names``, and how many more there are."""
    return ", ".join(names[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")
