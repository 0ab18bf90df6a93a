"""Rows that a logger wrote twice: it asks more often than the robot answers, and gets the last answer again.

Where the answers come at no whole multiple of its own step the motion becomes a staircase of uneven steps, which no
filter mends: on a simulated arm whose samples came every 13 ms and were logged every 4 thirty times as much of the
torque was left, and links and a spring were named for it. A row that repeats the one before it in every signal of every
joint, while the arm moves, is no sample: it is left out, and when the samples came is told from the rest
(:mod:`.clock`).

A coarse converter repeats values, too, but one joint at a time and by one step; an arm that rests repeats many rows,
where a logger repeats all as often.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array, Notify

#: Share of the rows that repeat the one before from which on the log is taken to hold such rows.
REPEATED = 0.02
#: Times the usual number of rows of a sample beyond which an arm rests.
RESTS = 2.0
#: Of the rows in which positions are new, the share in which a signal of a joint (their median) is.
TOGETHER = 0.8
#: A signal that is new in fewer of them stands still; signals that there must be beside each other.
STILL, FEWEST = 0.01, 2
#: Share of a position's changes that are by one step of it beyond which it is the converter that is coarse.
BY_ONE_STEP, ONE_STEP = 0.5, 1.5
#: A log of fewer rows says nothing.
FEWEST_ROWS = 50


def without_repeats(run: Trajectory, notify: Notify | None = None) -> Trajectory:
    """``run`` (any stamps) without rows that repeat the one before them in motion; of a rest as many rows as of a
    motion. ``notify`` is told how many."""
    if "q" not in run or len(run.time) < FEWEST_ROWS:
        return run
    # Signal by signal: a log of an hour fills much of a memory.
    same = np.all([(x[1:] == x[:-1]).all(axis=1) for x in run.signals.values()], axis=0)
    first = np.flatnonzero(np.concatenate([[True], ~same]))
    lengths = np.diff(np.append(first, len(run.time)))
    moving = lengths <= RESTS * np.median(lengths)
    hold = float(lengths[moving].mean())
    if 1.0 - 1.0 / hold < REPEATED or not _together(run, ~same & (run["q"][1:] != run["q"][:-1]).any(axis=1)):
        return run
    rests = zip(first[~moving], lengths[~moving], strict=True)
    more = [start + np.round(np.arange(hold, length, hold)).astype(int) for start, length in rests]
    rows = np.unique(np.concatenate([first, *more]))
    if notify is not None:
        notify(
            f"{run.name}: {1.0 - 1.0 / hold:.0%} of the rows in motion repeat the one before them in every signal: a "
            f"sample comes every {1e3 * run.dt * hold:.3g} ms, logged every {1e3 * run.dt:.3g} ms; {len(run.time)} -> "
            f"{len(rows)} rows"
        )
    return run.rows(rows[rows < len(run.time)])


def _together(run: Trajectory, new: NDArray[np.bool_]) -> bool:
    """True where signals are ``new`` (T - 1,) together, and not since positions come in coarse steps."""
    if not new.any():
        return False
    share = np.concatenate([(x[1:][new] != x[:-1][new]).mean(axis=0) for x in run.signals.values()])
    share = share[share > STILL]
    if len(share) < FEWEST or np.median(share) < TOGETHER:
        return False
    return not all(_is_coarse(x) for x in np.abs(run["q"][1:][new] - run["q"][:-1][new]).T if x.any())


def _is_coarse(changes: Array) -> bool:
    """True where most of a position's ``changes`` (T,), those there are, are by the least of them."""
    there = changes[changes > 1e-6 * changes.max()]
    return bool(np.mean(there < ONE_STEP * there.min()) > BY_ONE_STEP)
