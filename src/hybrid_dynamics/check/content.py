"""What is in a log: rate, gaps, jitter, held samples, steps of the converters, joints that stand still."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.check.clipped import MOVING
from hybrid_dynamics.check.findings import Finding
from hybrid_dynamics.check.samples import CUTOFF_SHARE
from hybrid_dynamics.differentiate.butterworth import lowpass
from hybrid_dynamics.trajectory import Trajectory, instant

#: Slowest log [Hz] that is looked at; share of the speed's power beyond what the log resolves: doubted, refused.
SLOWEST, FAST_DOUBTED, FAST_REFUSED = 10.0, 0.05, 0.2
#: A log is fast enough for any arm from here on [Hz].
FAST_ENOUGH = 50.0
#: Independent samples (two per period of the cut-off) below which nothing can be told, and little.
FEWEST, FEW = 60, 300
#: Largest cut-off [Hz] of the loop's own filters.
CUTOFF = 25.0


def check_content(run: Trajectory, joint_names: Sequence[str]) -> list[Finding]:
    """Findings on one run as it was recorded (``q``, ``tau``, perhaps ``dq``; stamps as they are)."""
    steps = np.diff(run.time)
    dt = run.dt
    span = float(run.time[-1] - run.time[0])
    out = [
        Finding(
            "summary",
            "note",
            f"{len(run.time)} samples, {span:.3g} s at {1 / dt:.4g} Hz, signals {', '.join(run.signals)}",
            run=run.name,
        )
    ]
    jitter = float(np.percentile(np.abs(steps - dt), 99)) / dt
    if jitter > 0.1:
        text = (
            f"time stamps jitter by {jitter:.0%} of a step (steps {1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} "
            "ms); the log is resampled; where the controller is periodic, its own clock would be better"
        )
        out.append(Finding("jitter", "note", text, run=run.name))
    missing = steps > 1.5 * dt
    if missing.any():
        gaps, lost = int(missing.sum()), int(np.round(steps[missing] / dt - 1).sum())
        longest = int(np.argmax(steps))
        text = (
            f"{gaps} gap{'s' if gaps > 1 else ''}, about {lost} samples lost, the longest {steps[longest]:.3g} s after "
            f"t = {instant(run.time[longest])} s: short ones are interpolated, the run is split at long ones"
        )
        out.append(Finding("gaps", "warning" if lost > 0.05 * len(run.time) else "note", text, run=run.name))
    return [*out, *_converters(run, joint_names)]


def _converters(run: Trajectory, joint_names: Sequence[str]) -> list[Finding]:
    """Joints at rest, coarse converters, samples that only repeat the last one: one finding a kind."""
    still, coarse, held = [], [], []
    for j, joint in enumerate(joint_names):
        if np.ptp(run["q"][:, j]) < MOVING:
            still.append(joint)
            continue
        for signal in (s for s in ("q", "tau") if s in run):
            kind, clause = _steps(run, signal, j)
            coarse += [clause] if kind == "coarse" else []
            held += [clause] if kind == "held" else []
    told = (
        ("still", "note", still, "stand still; nothing can be found out about their own friction"),
        ("coarse", "note", coarse, "come from a coarse converter"),
        (
            "held",
            "warning",
            held,
            "repeat their last value, also in motion: the log is faster than what it records; log at the source's rate",
        ),
    )
    return [Finding(c, s, f"{', '.join(found)} {what}", run=run.name) for c, s, found, what in told if found]  # type: ignore[arg-type]


def _steps(run: Trajectory, signal: str, j: int) -> tuple[str, str]:
    """What the steps of a signal tell: ``coarse`` or ``held`` with a clause, or nothing."""
    x = run[signal][:, j]
    changes = np.abs(np.diff(x))
    moved = changes[changes > 0]
    if len(moved) < 20:
        return "", ""
    step = float(np.percentile(moved, 2))
    if float(np.mean(np.abs(moved / step - np.round(moved / step)) < 0.02)) > 0.9:
        values = np.ptp(x) / step + 1
        unit = "N m" if signal == "tau" else "rad"
        return (
            ("coarse", f"{signal}{j + 1} ({values:.0f} values, {step:.3g} {unit} apart)") if values < 100 else ("", "")
        )
    speed = np.abs(np.diff(run["q"][:, j]))
    fast = speed > np.percentile(speed, 50)
    repeated, again = float(np.mean(changes == 0)), float(np.mean(changes[fast] == 0)) if fast.any() else 0.0
    return ("held", f"{signal}{j + 1} ({repeated:.0%})") if min(repeated, again) > 0.3 else ("", "")


def check_rate(runs: Sequence[Trajectory]) -> list[Finding]:
    """Is the log fast enough for its motion, and long enough? ``runs`` on uniform grids."""
    out = []
    for run in runs:
        rate = 1.0 / run.dt
        # Stamps are rounded.
        if rate < SLOWEST * (1 - 1e-6):
            text = f"{rate:.3g} Hz is too slow for dynamics; expected at least {SLOWEST:g} Hz, better 100 Hz or more"
            out.append(Finding("too_slow", "hard", text, run=run.name))
            continue
        if rate >= FAST_ENOUGH or len(run.time) < 40:
            continue
        speed = np.gradient(run["q"], run.dt, axis=0)
        power = speed.var(axis=0)
        resolved = lowpass(speed, run.dt, CUTOFF_SHARE * rate)
        beyond = (speed - resolved).var(axis=0)[power > 1e-6] / power[power > 1e-6]
        share = float(np.median(beyond)) if len(beyond) else 0.0
        if share > FAST_DOUBTED:
            text = (
                f"{rate:.3g} Hz is too slow for this motion: {share:.0%} of the speed's power lies beyond the "
                f"{CUTOFF_SHARE * rate:.2g} Hz that can be used; log at {max(100.0, 10 * rate):.0f} Hz or move slower"
            )
            out.append(Finding("too_slow", "hard" if share > FAST_REFUSED else "warning", text, run=run.name))
    samples = sum(
        2 * min(CUTOFF, CUTOFF_SHARE / run.dt) * float(run.time[-1] - run.time[0]) for run in runs if len(run.time) > 1
    )
    if not out and samples < FEW:
        seconds = sum(float(run.time[-1] - run.time[0]) for run in runs)
        text = (
            f"{seconds:.3g} s of log hold about {samples:.4g} independent samples; expected at least {FEWEST}, better "
            "some thousand: record longer runs"
        )
        out.append(Finding("too_short", "hard" if samples < FEWEST else "warning", text))
    return out
