"""Uneven time stamps to a uniform grid, for every reader.

One interpolation serves all signals, because it is linear in the data: torque and regressors then see the same small
distortion, which cancels. A cubic spline over the recorded stamps is accurate to fourth order in the step and needs no
assumption on the noise. (A monotone cubic cannot overshoot, but cuts off every peak that falls into a gap: 20 times the
error at 10 % lost samples.)
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hybrid_dynamics.errors import require
from hybrid_dynamics.readers.clock import truer_stamps
from hybrid_dynamics.readers.jumps import TWO_RUNS, find_jumps, stretches_between
from hybrid_dynamics.readers.repeats import as_sampled
from hybrid_dynamics.trajectory import Trajectory, instant
from hybrid_dynamics.types import Array, Notify

#: What is said of a log of which :func:`resample` leaves nothing.
NO_STRETCH = "no stretch without a gap too long to interpolate; record without losing rows"


@dataclass(frozen=True)
class ResampleSettings:
    """``dt`` [s] of the grid (0: the median step of the recording).

    Gaps up to ``max_gap`` [s] or ``max_gap_samples`` steps, whichever is longer, are interpolated; the run is split at
    longer ones. A part shorter than ``min_rows`` rows is left out. Stamps within ``uniform_tolerance`` steps of a
    uniform grid count as uniform: then no value is changed.
    """

    dt: float = 0.0
    max_gap: float = 0.05
    max_gap_samples: int = 5
    min_rows: int = 50
    uniform_tolerance: float = 0.02

    def __post_init__(self) -> None:
        require(0 <= self.dt < 0.5, f"resample.dt is {self.dt}; expected seconds in [0, 0.5), 0 for automatic")
        require(self.max_gap >= 0, f"resample.max_gap is {self.max_gap}; expected seconds >= 0")
        require(self.max_gap_samples >= 1, f"resample.max_gap_samples is {self.max_gap_samples}; expected >= 1")
        require(self.min_rows >= 4, f"resample.min_rows is {self.min_rows}; expected >= 4")
        require(
            0 <= self.uniform_tolerance < 0.5,
            f"resample.uniform_tolerance is {self.uniform_tolerance}; expected steps in [0, 0.5)",
        )


def find_gaps(time: Array, settings: ResampleSettings) -> NDArray[np.int64]:
    """Rows k (0-based) after which the step to row k+1 is too long to interpolate."""
    steps = np.diff(time)
    limit = max(settings.max_gap, settings.max_gap_samples * float(np.median(steps)))
    return np.flatnonzero(steps > limit * (1 + 1e-9))


def uniform_step(time: Array, settings: ResampleSettings) -> float | None:
    """The step [s] of stamps (T,) that are uniform but for rounding; None where they are not."""
    count = len(time) - 1
    dt = (time[-1] - time[0]) / count
    off = np.abs(time - time[0] - dt * np.arange(count + 1)).max()
    return float(dt) if off <= settings.uniform_tolerance * dt else None


def resample(
    trajectory: Trajectory, settings: ResampleSettings | None = None, notify: Notify | None = None
) -> list[Trajectory]:
    """``trajectory`` (strictly increasing stamps) on a uniform grid; several parts where gaps are too long.

    So it is where positions jump (:mod:`.jumps`). A run in one part keeps its name; parts are called ``name.part1``,
    ``name.part2`` ... Rows that a logger wrote twice are left out, and joined streams taken at the pace of the
    positions (:mod:`.repeats`). Where the positions say that the samples are of an even clock and the stamps are not
    (:func:`.clock.truer_stamps`), they are taken as even.
    ``notify`` is told the grid, every gap and every jump.
    """
    settings = settings or ResampleSettings()
    tell = notify or (lambda message: None)
    trajectory = as_sampled(trajectory, tell)
    cuts = find_gaps(trajectory.time, settings)
    bounds = np.concatenate([[0], cuts + 1, [len(trajectory.time)]])
    dt = settings.dt or round(float(np.median(np.diff(trajectory.time))), 9)
    for k in cuts:
        start, end = trajectory.time[k], trajectory.time[k + 1]
        tell(
            f"{trajectory.name}: no samples for {end - start:.3g} s after t = {instant(start)} s (row {k + 1}), too "
            f"long to interpolate (more than {settings.max_gap:g} s and {settings.max_gap_samples} samples): run split "
            "there"
        )
    stretches = [s for first, last in pairwise(bounds) for s in _without_jumps(trajectory, int(first), int(last), tell)]
    parts: list[Trajectory] = []
    for first, last in stretches:
        if len(stretches) > 1 and last - first < settings.min_rows:
            tell(
                f"{trajectory.name}: rows {first + 1} to {last} left out (fewer than {settings.min_rows} in one piece)"
            )
            continue
        parts.append(_on_grid(trajectory.rows(slice(first, last)), dt, settings, tell))
    if len(parts) > 1:
        parts = [
            Trajectory(f"{part.name}.part{i}", part.split, part.time, part.signals) for i, part in enumerate(parts, 1)
        ]
    return parts


def _without_jumps(trajectory: Trajectory, first: int, last: int, tell: Notify) -> list[tuple[int, int]]:
    """Rows from ``first`` to ``last`` in stretches without a jump, each looked at by itself as whoever gets it will."""
    jumps = find_jumps(trajectory.rows(slice(first, last))) if "q" in trajectory else []
    for jump in jumps:
        still = f", after {jump.row - jump.held} rows that repeat one" if jump.row > jump.held else ""
        tell(
            f"{trajectory.name}: q{jump.joint + 1} jumps by {jump.size:.3g} from one sample to the next at t = "
            f"{instant(trajectory.time[first + jump.row])} s (row {first + jump.row + 1}){still}: {TWO_RUNS}: run "
            "split there"
        )
    if not jumps:
        return [(first, last)]
    parts = stretches_between(last - first, jumps)
    return [s for a, b in parts for s in _without_jumps(trajectory, first + a, first + b, tell)]


def _on_grid(trajectory: Trajectory, dt: float, settings: ResampleSettings, tell: Notify) -> Trajectory:
    even = _if_uniform(trajectory, trajectory.time, settings)
    if even is not None:
        return even
    time = trajectory.time
    if "q" in trajectory and not settings.dt:
        time = truer_stamps(time, trajectory["q"])
    if time is not trajectory.time:
        dt, off = float(np.median(np.diff(time))), float(np.abs(time - trajectory.time).max())
        tell(
            f"{trajectory.name}: the positions are smooth at the ticks of a clock of {1 / dt:.6g} Hz, and not at the "
            f"recorded stamps, which are off by up to {1e3 * off:.2g} ms: the samples are taken as that clock's"
        )
        even = _if_uniform(trajectory, time, settings)
        if even is not None:
            return even
    steps = np.diff(time)
    grid = time[0] + dt * np.arange(int(np.floor((time[-1] - time[0]) / dt + 1e-9)) + 1)
    filled = int(np.sum(steps > 1.5 * np.median(steps)))
    tell(
        f"{trajectory.name}: uneven time stamps (steps {1e3 * steps.min():.4g} to {1e3 * steps.max():.4g} ms): "
        f"resampled to {1 / dt:.6g} Hz, {len(time)} -> {len(grid)} rows"
        + (f", {filled} gaps of up to {1e3 * steps.max():.3g} ms interpolated" if filled else "")
    )
    names = list(trajectory.signals)
    stacked = np.concatenate([trajectory[name] for name in names], axis=1)
    values = CubicSpline(time, stacked)(grid)
    pieces = np.split(values, len(names), axis=1)
    return Trajectory(trajectory.name, trajectory.split, grid, dict(zip(names, pieces, strict=True)))


def _if_uniform(trajectory: Trajectory, time: Array, settings: ResampleSettings) -> Trajectory | None:
    """``trajectory`` at stamps ``time`` where these are uniform but for rounding, and as far apart as is asked for."""
    uniform = uniform_step(time, settings)
    if uniform is None or (settings.dt and abs(uniform / settings.dt - 1) >= settings.uniform_tolerance):
        return None
    # Rounded stamps of an even clock: the clock is the better time, the values stay as recorded.
    grid = time[0] + uniform * np.arange(len(time))
    return Trajectory(trajectory.name, trajectory.split, grid, trajectory.signals)
