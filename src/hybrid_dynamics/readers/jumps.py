"""Places at which a log goes on elsewhere: two recordings in one file, or time that passed without being recorded.

A robot does not leave out a part of its way. Where positions are elsewhere from one sample to the next, and stay there,
the log is of two runs, whatever its stamps say; a derivative across that place is an acceleration that never was. A
bus that hangs repeats its last sample, all of it, until it goes on elsewhere: the repeated ones are no samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: Samples to either side that tell how fast the joint moves, and where it is: more than a glitch lasts.
NEARBY = 7
#: A position is elsewhere where it departs from its own motion by this many times what others of the log do (the
#: share of them), by so many of its resolution, by this share of its range, and by this much [rad or m].
TIMES, OTHERS, COUNTS, RANGE, LEAST = 10.0, 99.5, 10.0, 0.03, 1e-3
#: And by so many times what the steps right beside it do: of a quick move each step is like the next.
BESIDE = 4.0
#: What a jump means.
TWO_RUNS = "two recordings in one, or time that was not recorded"
#: A step of the stamps that is this much longer than others is a gap.
LONGER = 1.5


@dataclass(frozen=True)
class Jump:
    """Positions go on elsewhere after row ``row`` (0-based), by ``size`` at ``joint`` (0-based), most of all; rows from
    ``held`` + 1 to ``row`` repeat row ``held``."""

    row: int
    held: int
    joint: int
    size: float


def find_jumps(trajectory: Trajectory) -> list[Jump]:
    """Where positions of ``trajectory`` (any stamps that increase) jump and stay; none in fewer than 4 ``NEARBY`` rows.

    Single wrong samples are none: the positions come back.
    """
    time, q = trajectory.time, trajectory["q"]
    if len(q) < 4 * NEARBY or not np.isfinite(q).all():
        return []
    steps, dt = np.diff(q, axis=0), np.diff(time)[:, None]
    rows = np.arange(NEARBY, len(steps) - NEARBY)
    speed = np.median(sliding_window_view(steps / dt, NEARBY, axis=0), axis=-1)
    # Speeds of the steps before and after step k, which itself is in neither.
    usual = (speed[rows - NEARBY] + speed[rows + 1]) / 2
    apart: Array = np.abs(steps[rows] - dt[rows] * usual)
    # Where the joint is on the whole before and after: single samples do not move a median.
    place = np.median(sliding_window_view(q, NEARBY, axis=0), axis=-1)
    middle = np.median(sliding_window_view(time, NEARBY), axis=-1)
    way = (middle[rows + 1] - middle[rows - NEARBY + 1])[:, None] * usual
    stays = np.abs(place[rows + 1] - place[rows - NEARBY + 1] - way) > apart / 2
    counts = np.array([np.min(s[s > 0], initial=np.inf) for s in np.abs(steps).T])
    least = np.maximum(
        np.maximum(TIMES * np.percentile(apart, OTHERS, axis=0), RANGE * np.ptp(q, axis=0)),
        np.where(np.isfinite(counts), COUNTS * counts, np.inf),
    )
    padded = np.pad(apart, ((2, 2), (0, 0)))
    beside = np.max([padded[i : i + len(apart)] for i in (0, 1, 3, 4)], axis=0)
    least = np.maximum(np.maximum(least, LEAST), BESIDE * beside)
    # Over time that the stamps count, the motion goes on.
    counted = dt[rows] > LONGER * np.median(dt)
    beyond = np.where(stays & (apart > least) & ~counted, apart / np.maximum(least, 1e-300), 0.0)
    out: list[Jump] = []
    most = beyond.max(axis=1)
    for k in np.flatnonzero(most > 0):
        nearby = most[max(k - NEARBY, 0) : k + NEARBY + 1]
        if most[k] < nearby.max():
            continue
        joint = int(np.argmax(beyond[k]))
        row = int(rows[k])
        out.append(Jump(row, _held_from(trajectory, row), joint, float(apart[k, joint])))
    return out


def _held_from(trajectory: Trajectory, row: int) -> int:
    """The row that the rows up to ``row`` repeat, all signals of it; ``row`` where they do not."""
    everything = np.concatenate(list(trajectory.signals.values()), axis=1)
    first = row
    while first > 0 and bool(np.all(everything[first - 1] == everything[row])):
        first -= 1
    return first


def stretches_between(length: int, jumps: list[Jump]) -> list[tuple[int, int]]:
    """First and last + 1 of the rows between ``jumps``, of ``length``, without those that only repeat."""
    firsts = [0, *(jump.row + 1 for jump in jumps)]
    lasts = [*(jump.held + 1 for jump in jumps), length]
    return [(first, last) for first, last in zip(firsts, lasts, strict=True) if first < last]
