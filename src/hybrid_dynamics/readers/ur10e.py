"""UR10e recordings of github.com/shamilmamedov/dynamic_calibration: 31 columns without a header.

Columns: time, q1..6, dq1..6, measured current 1..6 [A], desired current 1..6, desired torque 1..6. Joint torque is
gain times measured current. The controller ticks every 2 ms and logs every fifth or sixth tick, so steps are 10 and
12 ms: the stamps are real (the change of position agrees with velocity times step to 6e-5 rad; with a uniform step it
is off by 6e-4 rad).
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.errors import InputError, require
from hybrid_dynamics.readers.resample import ResampleSettings, resample
from hybrid_dynamics.readers.rows import longest_increasing, row_ranges
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array, Notify

COLUMNS = 31
JOINTS = 6
MAX_PAUSE = 0.5


@dataclass(frozen=True)
class Ur10eSettings:
    """How the recordings are read.

    ``gains`` [N m/A] drive gains. A row is corrupted when it is not 31 finite numbers, or exceeds ``max_position``
    [rad], ``max_velocity`` [rad/s] or ``max_current`` [A], or when its stamp does not fit its place; a file with more
    than ``max_corrupted`` (share) of them is refused. A joint faster than ``motion_threshold`` [rad/s] moves;
    automatic windows keep ``standstill`` [s] around the motion. Single stamps off the controller's ``tick`` [s] are put
    back on it (0: left as they are). ``dt`` [s] fixes the grid (0: median step).
    """

    gains: tuple[float, ...] = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)
    max_position: float = 6.6
    max_velocity: float = 6.3
    max_current: float = 100.0
    max_corrupted: float = 0.01
    motion_threshold: float = 0.005
    standstill: float = 0.1
    tick: float = 0.002
    dt: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "gains", tuple(float(gain) for gain in self.gains))
        require(
            len(self.gains) == JOINTS and all(gain > 0 for gain in self.gains),
            f"ur10e.gains is {self.gains}; expected {JOINTS} values > 0 [N m/A]",
        )
        for name in ("max_position", "max_velocity", "max_current", "motion_threshold"):
            require(getattr(self, name) > 0, f"ur10e.{name} is {getattr(self, name)}; expected > 0")
        require(0 <= self.max_corrupted < 1, f"ur10e.max_corrupted is {self.max_corrupted}; expected a share in [0, 1)")
        require(self.standstill >= 0, f"ur10e.standstill is {self.standstill}; expected seconds >= 0")
        require(0 <= self.tick < 0.01, f"ur10e.tick is {self.tick}; expected seconds in [0, 0.01), 0 for no repair")
        require(0 <= self.dt < 0.5, f"ur10e.dt is {self.dt}; expected seconds in [0, 0.5), 0 for automatic")


def read_ur10e(
    path: str | os.PathLike[str],
    name: str,
    split: str,
    settings: Ur10eSettings | None = None,
    window: tuple[int, int] | None = None,
    notify: Notify | None = None,
) -> Trajectory:
    """One recording as ``q dq tau`` on a uniform grid, time from the start of the window.

    ``window`` gives the first and last row (1-based, as in the file); None finds the motion between two standstills.
    ``notify`` is told dropped rows, the window and the grid. Raises :class:`InputError` for a file that is unusable.
    """
    settings = settings or Ur10eSettings()
    tell = notify or (lambda message: None)
    rows, values, total = _parse(Path(path))
    keep = _sound(values, rows, settings)
    dropped = np.setdiff1d(np.arange(1, total + 1), rows[keep])
    if len(dropped) > settings.max_corrupted * total:
        raise InputError(
            f"{path}: {len(dropped)} of {total} rows are corrupted (rows {row_ranges(dropped)}); expected at most "
            f"{settings.max_corrupted:.1%} of rows that are not {COLUMNS} numbers in range with increasing time: "
            "get an undamaged copy"
        )
    if len(dropped):
        tell(f"{name}: {len(dropped)} corrupted rows of {total} dropped: rows {row_ranges(dropped)}")
    rows, values = rows[keep], values[keep]
    if window is None:
        window = find_window(rows, values[:, 0], values[:, 7:13], settings, str(path))
        tell(f"{name}: usable window found: rows {window[0]} to {window[1]}")
    first, last = window
    if not 1 <= first < last <= total:
        raise InputError(f"{path}: window {first}-{last}; expected rows within 1-{total}, first before last")
    inside = (rows >= first) & (rows <= last)
    chosen = values[inside]
    if settings.tick:
        time, moved = repair_stamps(chosen[:, 0], chosen[:, 1:7], chosen[:, 7:13], settings.tick)
        if moved:
            tell(f"{name}: {moved} of {len(chosen)} time stamps lie between the controller's ticks: moved by half one")
        chosen = np.column_stack([time, chosen[:, 1:]])
    trajectory = Trajectory(
        name=name,
        split=split,
        time=chosen[:, 0] - chosen[0, 0],
        signals={"q": chosen[:, 1:7], "dq": chosen[:, 7:13], "tau": chosen[:, 13:19] * np.array(settings.gains)},
    )
    parts = resample(trajectory, ResampleSettings(dt=settings.dt), tell)
    if len(parts) != 1:
        raise InputError(f"{path}: rows {first}-{last} hold a gap too long to interpolate; choose a window without one")
    return parts[0]


def repair_stamps(time: Array, q: Array, dq: Array, tick: float) -> tuple[Array, int]:
    """Put single stamps that lie half a ``tick`` [s] between their neighbours' ticks on the tick that fits the motion.

    Of the tick before and the one after, the one whose steps agree better with the change of position: for both steps,
    q[k+1] - q[k] = (dq[k] + dq[k+1]) / 2 (t[k+1] - t[k]). Returns the stamps (T,) and how many were moved. On the runs
    of one day (11, 9 and 13 ms steps) it halves the misfit between position and velocity.
    """
    half = np.round(np.diff(time) / (tick / 2)).astype(int)
    off_tick = (half[:-1] % 2 == 1) & (half[1:] % 2 == 1)
    row = np.flatnonzero(off_tick) + 1
    row = row[np.diff(row, prepend=-2) > 1]
    speed = (dq[1:] + dq[:-1]) / 2
    misfit = []
    for shift in (-tick / 2, tick / 2):
        before = q[row] - q[row - 1] - speed[row - 1] * (time[row] + shift - time[row - 1])[:, None]
        after = q[row + 1] - q[row] - speed[row] * (time[row + 1] - time[row] - shift)[:, None]
        misfit.append((before**2 + after**2).sum(axis=1))
    out = time.copy()
    out[row] += np.where(misfit[1] < misfit[0], tick / 2, -tick / 2)
    return out, len(row)


def find_window(rows: NDArray[np.int64], time: Array, dq: Array, settings: Ur10eSettings, path: str) -> tuple[int, int]:
    """First and last row (numbers from ``rows``) of the longest motion, standstill around it included.

    Pauses of up to half a second are part of a motion (point to point); the robot's way to the start is not. Raises
    :class:`InputError` where nothing moves or the recording starts or ends in motion.
    """
    moving = np.flatnonzero(np.abs(dq).max(axis=1) > settings.motion_threshold)
    if len(moving) < 2:
        raise InputError(f"{path}: no joint exceeds {settings.motion_threshold} rad/s; expected a run in motion")
    breaks = np.flatnonzero(np.diff(time[moving]) > MAX_PAUSE)
    starts, ends = moving[np.r_[0, breaks + 1]], moving[np.r_[breaks, len(moving) - 1]]
    longest = int(np.argmax(time[ends] - time[starts]))
    start, end = int(starts[longest]), int(ends[longest])
    if start == 0 or end == len(rows) - 1:
        side = "starts" if start == 0 else "ends"
        raise InputError(f"{path}: {side} in motion; expected standstill at both ends, or give the window in rows")
    first = int(np.searchsorted(time, time[start] - settings.standstill))
    last = int(np.searchsorted(time, time[end] + settings.standstill, side="right")) - 1
    return int(rows[max(first, 0)]), int(rows[min(last, len(rows) - 1)])


def _parse(path: Path) -> tuple[NDArray[np.int64], Array, int]:
    """Row numbers (from 1) and values (T, 31) of the rows that are 31 numbers, and the number of rows in all."""
    try:
        lines = path.read_text(encoding="ascii", errors="replace").splitlines()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; run the fetch stage") from None
    rows, values = [], []
    for number, line in enumerate(lines, 1):
        fields = line.split(",")
        if len(fields) != COLUMNS:
            continue
        try:
            values.append([float(field) for field in fields])
        except ValueError:
            continue
        rows.append(number)
    if len(rows) < 50:
        raise InputError(f"{path}: {len(rows)} rows of {COLUMNS} comma-separated numbers; expected at least 50")
    return np.array(rows), np.array(values), len(lines)


def _sound(values: Array, rows: NDArray[np.int64], settings: Ur10eSettings) -> NDArray[np.bool_]:
    """Which rows are in range and stamped in order."""
    with np.errstate(invalid="ignore"):
        good = np.isfinite(values).all(axis=1)
        good &= np.abs(values[:, 1:7]).max(axis=1) <= settings.max_position
        good &= np.abs(values[:, 7:13]).max(axis=1) <= settings.max_velocity
        good &= np.abs(values[:, 13:31]).max(axis=1) <= 20 * settings.max_current
        good &= np.abs(values[:, 13:19]).max(axis=1) <= settings.max_current
    index = np.flatnonzero(good)
    if len(index) < 2:
        return np.asarray(good)
    # A damaged stamp lies far from the clock line through the others (medians: half the rows may be wrong) ...
    stamp, number = values[index, 0], rows[index].astype(float)
    step = float(np.median(np.diff(stamp) / np.diff(number)))
    off = stamp - step * number
    fits = np.abs(off - np.median(off)) <= 5.0 + 0.05 * step * len(rows)
    good[index[~fits]] = False
    # ... or is out of order: the longest increasing sequence stays.
    index = index[fits]
    good[np.delete(index, longest_increasing(values[index, 0]))] = False
    return np.asarray(good)
