"""Is dq the derivative of q? Its scale, its sign and its lag are measured and said."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.check.cures import reordered, turned
from hybrid_dynamics.check.findings import Finding, Severity
from hybrid_dynamics.check.samples import kept, long_enough, usual_cutoff
from hybrid_dynamics.differentiate.butterworth import lowpass
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

DEGREES = 180 / np.pi
#: A joint is judged where its speed [rad/s] and its range [rad] are at least this much.
SPEED, RANGE = 0.02, 0.03
#: Slopes that are one within this share are right; correlations below which dq is something else.
SLOPE, ALIKE, UNLIKE = 0.2, 0.95, 0.6
#: Lags [s] that are told and refused, and the longest that is looked for.
LAG_TOLD, LAG_REFUSED, LONGEST = 0.01, 0.08, 0.5
#: What is refused must leave so many times less of dq than no lag does: two seconds of steady motion look like
#: themselves a moment later.
PLAIN = 3.0


def check_velocity(joint_names: Sequence[str], runs: Sequence[Trajectory]) -> list[Finding]:
    """Findings on ``dq`` of ``runs`` (uniform grids); those without it are not looked at."""
    pairs = [pair for run in runs if "dq" in run and (pair := _alike(run)) is not None]
    if not pairs:
        return []
    moved = np.concatenate([v for v, _, _ in pairs])
    told = np.concatenate([w for _, w, _ in pairs])
    span = np.max([np.ptp(run["q"], axis=0) for run in runs if "dq" in run], axis=0)
    moving = (np.sqrt(np.mean(moved**2, axis=0)) >= SPEED) & (span >= RANGE)
    if not moving.any():
        return []
    silent = moving & ~np.any(np.concatenate([run["dq"] for run in runs if "dq" in run]), axis=0)
    if silent.any():
        which = (
            "" if silent[moving].all() else f" of {', '.join(joint_names[j] for j in map(int, np.flatnonzero(silent)))}"
        )
        text = (
            f"the velocity{which} is zero throughout while the joints move: dq is not measured here; the derivative of "
            "q is taken instead; leave dq out of the log"
        )
        return [Finding("dq_zero", "warning", text, suggestion={"drop": ["dq"]})]
    correlation = _correlations(moved, told)
    slope = np.einsum("kj,kj->j", moved, told) / np.maximum(np.sum(moved**2, axis=0), 1e-300)
    own = np.diag(correlation)
    lag = _lag([(v[:, moving], w[:, moving], dt) for v, w, dt in pairs])
    out = _order(joint_names, correlation, moving)
    if out:
        return out
    out = _sign(joint_names, moving, slope, own)
    # A lag lowers correlation and slope; it is told as what it is.
    late = abs(lag) >= LAG_REFUSED
    size = np.abs(slope)
    judged = moving & (np.abs(own) > UNLIKE)
    if judged.any() and not late:
        out += _scale(joint_names, size, judged)
    strange = moving & (np.abs(own) < UNLIKE)
    if strange.any() and not late:
        j = int(np.flatnonzero(strange)[0])
        out.append(
            Finding(
                "dq_strange",
                "hard" if np.abs(own[j]) < 0.4 else "warning",
                f"dq is not the derivative of q (correlation {own[j]:.2f}); expected the measured velocity in rad/s: "
                "log it, or leave dq out",
                joint=joint_names[j],
                suggestion={"drop": ["dq"]},
            )
        )
    if abs(lag) >= LAG_TOLD:
        severity: Severity = "hard" if late else "note" if abs(lag) < 0.03 else "warning"
        # Its derivative, the acceleration, would be late by as much: a delay that the torque does not have.
        instead = "" if late else "; the derivative of q is taken instead"
        text = (
            f"dq is {abs(lag):.3g} s {'behind' if lag > 0 else 'ahead of'} the derivative of q{instead}; expected the "
            "same instant: shift it, or leave dq out"
        )
        out.append(Finding("dq_lag", severity, text, suggestion={"velocity_delay": round(lag, 4)}))
    return out


def _alike(run: Trajectory) -> tuple[Array, Array, float] | None:
    """Derivative of q, dq, both with one low-pass (K, n), and the step [s]; None where the run is too short."""
    dt, cutoff = run.dt, usual_cutoff(run)
    if not long_enough(run, cutoff):
        return None
    rows = kept(run, cutoff)
    v = np.gradient(lowpass(run["q"], dt, cutoff), dt, axis=0)
    return v[rows], lowpass(run["dq"], dt, cutoff)[rows], dt * rows.step


def _correlations(a: Array, b: Array) -> Array:
    """(n, n) of the columns of ``a`` with those of ``b``; zero where one is constant."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    size = np.linalg.norm(a, axis=0)[:, None] * np.linalg.norm(b, axis=0)[None, :]
    return np.asarray((a.T @ b) / np.maximum(size, 1e-300))


def _order(names: Sequence[str], correlation: Array, moving: NDArray[np.bool_]) -> list[Finding]:
    """Velocity columns that belong to other joints: clear only where each finds its own."""
    source = np.argmax(np.abs(correlation), axis=1)
    wrong = [
        j for j in map(int, np.flatnonzero(moving)) if source[j] != j and np.abs(correlation[j, source[j]]) > ALIKE
    ]
    wrong = [j for j in wrong if np.abs(correlation[j, j]) < UNLIKE]
    if not wrong:
        return []
    which = "; ".join(f"dq{source[j] + 1} is the derivative of q{j + 1}" for j in wrong)
    order = [int(source[j]) if j in wrong else j for j in range(len(names))]
    cure = reordered(order, ["dq"]) if len(set(order)) == len(order) else {}
    text = f"velocity columns are in another order than the positions: {which}; expected the same order: exchange them"
    return [Finding("dq_order", "hard", text, joint=names[wrong[0]], suggestion=cure)]


def _sign(names: Sequence[str], moving: NDArray[np.bool_], slope: Array, own: Array) -> list[Finding]:
    wrong = [int(j) for j in np.flatnonzero(moving & (own < -UNLIKE))]
    if not wrong:
        return []
    whose = "of every joint" if len(wrong) == moving.sum() else "of " + ", ".join(names[j] for j in wrong)
    n = len(names)
    # Joints that stand still take the side of the others.
    cure = turned(n, [j for j in range(n) if j in wrong or (len(wrong) == moving.sum() and not moving[j])], ["dq"])
    text = (
        f"dq {whose} has the wrong sign (slope {slope[wrong[0]]:.3g} against the derivative of q, correlation "
        f"{own[wrong[0]]:.2f}); expected the velocity of q: turn its sign"
    )
    return [Finding("dq_sign", "hard", text, joint=names[wrong[0]], suggestion=cure)]


def _scale(names: Sequence[str], size: Array, judged: NDArray[np.bool_]) -> list[Finding]:
    """Units: degrees, clocks that are wrong by powers of ten, the motor's side of the gear."""
    s = size[judged]
    off = judged & (np.abs(size - 1) > SLOPE)
    if not off.any():
        return []
    typical = float(np.median(s))
    agree = float(np.max(np.abs(np.log(s / typical)))) < 0.1
    j = int(np.flatnonzero(off)[np.argmax(np.abs(np.log(size[off])))])
    name = names[j]
    measured = f"dq is {size[j]:.4g} times the derivative of q"
    for factor, unit, told in ((DEGREES, "deg/s", "dq is in deg/s"), (60 / (2 * np.pi), "rpm", "dq is in rpm")):
        if agree and abs(typical / factor - 1) < 0.02:
            text = f"{measured}: {told}; expected rad/s: convert it"
            return [Finding("dq_scale", "hard", text, joint=name, suggestion={"units": {"dq": unit}})]
    if agree and abs(typical * DEGREES - 1) < 0.1:
        text = f"{measured}: q is in degrees, dq in rad/s; expected rad and rad/s: convert q"
        return [Finding("dq_scale", "hard", text, joint=name, suggestion={"units": {"q": "deg", "dq": "rad/s"}})]
    power = round(float(np.log10(typical)))
    if agree and power and abs(typical / 10.0**power - 1) < 0.2:
        text = (
            f"{measured}: the time stamps run {10.0 ** abs(power):g} times too {'slow' if power > 0 else 'fast'}, or "
            "dq is in another unit; expected seconds and rad/s: convert them"
        )
        return [Finding("dq_scale", "hard", text, joint=name)]
    gross = bool(np.any((size[off] > 3) | (size[off] < 1 / 3)))
    each = ", ".join(f"{names[k]} {size[k]:.3g}" for k in map(int, np.flatnonzero(off)))
    text = (
        f"{measured} (by joint: {each}); expected rad/s of the joint: "
        + ("divide a motor's speed by its gear ratio, convert other units" if gross else "look at its filter and unit")
        + ", or leave dq out"
    )
    return [Finding("dq_scale", "hard" if gross else "warning", text, joint=name, suggestion={"drop": ["dq"]})]


def _lag(pairs: Sequence[tuple[Array, Array, float]]) -> float:
    """Seconds by which dq is late: the shift under which it is most alike; zero where none makes it alike, or not much
    more alike than none at all."""
    weighted, total = 0.0, 0.0
    # Joints count alike, but by what they move in a run's window: of one that rests there noise has the say.
    scale = [np.maximum(np.concatenate([pair[k] for pair in pairs]).std(axis=0), 1e-300) for k in (0, 1)]
    for v, w, dt in pairs:
        reach = min(int(LONGEST / dt), len(v) // 4)
        if reach < 2:
            continue
        middle = slice(reach, len(v) - reach)
        v, w = v / scale[0], w / scale[1]
        own = v[middle] - v[middle].mean(axis=0)
        alike = np.empty(2 * reach + 1)
        for k in range(2 * reach + 1):
            late = w[k : k + len(own)]
            late = late - late.mean(axis=0)
            size = np.linalg.norm(own) * np.linalg.norm(late)
            alike[k] = np.sum(np.abs(np.sum(own * late, axis=0))) / max(size, 1e-300)
        best = int(np.argmax(alike))
        if not 0 < best < 2 * reach or alike[best] < 0.9:
            continue
        left, mid, right = alike[best - 1 : best + 2]
        bend = float(left - 2 * mid + right)
        shift = best - reach + (0.5 * float(left - right) / bend if bend < 0 else 0.0)
        unlike = 1.0 - alike**2
        if abs(shift) * dt >= LAG_REFUSED and unlike[reach] < PLAIN * unlike[best]:
            continue
        weight = len(v) * dt
        weighted, total = weighted + weight * shift * dt, total + weight
    return weighted / total if total else 0.0
