"""Rows that a logger wrote twice: it asks more often than the robot answers, and gets the last answer again.

Where the answers come at no whole multiple of its own step the motion becomes a staircase of uneven steps, which no
filter mends: on a simulated arm whose samples came every 13 ms and were logged every 4 thirty times as much of the
torque was left, and links and a spring were named for it. A row that repeats the one before it in every signal of every
joint, while the arm moves, is no sample: it is left out, and when the samples came is told from the rest
(:mod:`.clock`). A coarse converter repeats values, too, but one joint at a time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Notify

#: Share of the rows in motion that repeat the one before from which on the log is taken to hold such rows.
REPEATED = 0.02
#: Of the rows that are new, the share in which a signal of a joint (their median) is new.
TOGETHER = 0.8
#: A signal that is new in fewer of them stands still.
STILL = 0.01
#: Rows after which a position changes at the latest while the arm moves; a longer repetition is a rest.
LONGEST = 25


def without_repeats(run: Trajectory, notify: Notify | None = None) -> Trajectory:
    """``run`` (any stamps) without rows that repeat the one before them in motion; of longer rests as many rows as of a
    motion. ``notify`` is told how many."""
    if "q" not in run or len(run.time) < 2 * LONGEST:
        return run
    # Signal by signal: a log of an hour fills much of a memory.
    same = np.all([(x[1:] == x[:-1]).all(axis=1) for x in run.signals.values()], axis=0)
    moving = _moving((run["q"][1:] != run["q"][:-1]).any(axis=1))
    new = moving & ~same
    if np.sum(same & moving) < REPEATED * max(moving.sum(), 1) or not new.any():
        return run
    share = np.concatenate([(x[1:][new] != x[:-1][new]).mean(axis=0) for x in run.signals.values()])
    if not np.any(share > STILL) or np.median(share[share > STILL]) < TOGETHER:
        return run
    rows = _kept(same, moving.sum() / new.sum())
    if notify is not None:
        twice, period = float(np.sum(same & moving) / moving.sum()), run.dt * float(moving.sum() / new.sum())
        notify(
            f"{run.name}: {twice:.0%} of the rows in motion repeat the one before them in every signal: a sample comes "
            f"every {1e3 * period:.3g} ms, logged every {1e3 * run.dt:.3g} ms; {len(run.time)} -> {len(rows)} rows"
        )
    return run.rows(rows)


def _moving(turning: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Steps (T - 1,) that are at most :data:`LONGEST` steps from one that is ``turning`` to the next."""
    at = np.flatnonzero(turning)
    if not len(at):
        return turning
    after = np.searchsorted(at, np.arange(len(turning)))
    known = (after > 0) & (after < len(at))
    apart = at[np.minimum(after, len(at) - 1)] - at[np.maximum(after - 1, 0)]
    return np.asarray(turning | (known & (apart <= LONGEST)))


def _kept(same: NDArray[np.bool_], hold: float) -> NDArray[np.intp]:
    """Rows that are kept: the first of those that repeat each other, and of a rest one every ``hold`` rows."""
    first = np.flatnonzero(np.concatenate([[True], ~same]))
    lengths = np.diff(np.append(first, len(same) + 1))
    out = [first]
    for start, length in zip(first[lengths > LONGEST], lengths[lengths > LONGEST], strict=True):
        out.append(start + np.round(np.arange(hold, length, hold)).astype(int))
    rows = np.unique(np.concatenate(out))
    return rows[rows <= len(same)]
