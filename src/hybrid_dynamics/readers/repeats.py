"""Rows that a logger wrote twice: it asks more often than the robot answers, and gets the last answer again.

Where the answers come at no whole multiple of its own step the motion becomes a staircase of uneven steps, which no
filter mends: on a simulated arm whose samples came every 13 ms and were logged every 4 thirty times as much of the
torque was left, and links and a spring were named for it. A row that repeats the one before it in every signal of every
joint, while the arm moves, is no sample: it is left out, and when the samples came is told from the rest
(:mod:`.clock`).

Where positions alone repeat in motion, and other signals are new, the logger writes the latest of several streams, as
joined topics are: the torque of one instant beside the position of an earlier one. The log is taken at the instants of
the positions then. On a simulated arm of which positions came at 100 Hz and torques at 125, each written into every row
until the next, couplings, springs and links were named, and three times as much (rms) was left as least squares leaves.

A coarse converter repeats values, too, but one joint at a time and by one step; an arm that rests repeats many rows,
where a logger repeats all as often.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hybrid_dynamics.readers.clock import truer_stamps
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
#: In the faster half of a motion positions of a slow stream repeat more than so many times as often as in the slower.
AS_OFTEN = 0.5
#: A log of fewer rows says nothing.
FEWEST_ROWS = 50


def as_sampled(run: Trajectory, notify: Notify | None = None) -> Trajectory:
    """``run`` (any stamps) at the instants at which it was sampled: without rows that repeat all signals, and where
    positions come more slowly than the others, at theirs. ``notify`` is told what was found."""
    return at_pace_of_positions(without_repeats(run, notify), notify)


def without_repeats(run: Trajectory, notify: Notify | None = None) -> Trajectory:
    """``run`` (any stamps) without rows that repeat the one before them in motion; of a rest as many rows as of a
    motion. ``notify`` is told how many."""
    found = _samples(run, list(run.signals))
    if found is None:
        return run
    rows, hold = found
    if notify is not None:
        notify(
            f"{run.name}: {1.0 - 1.0 / hold:.0%} of the rows in motion repeat the one before them in every signal: a "
            f"sample comes every {1e3 * run.dt * hold:.3g} ms, logged every {1e3 * run.dt:.3g} ms; {len(run.time)} -> "
            f"{len(rows)} rows"
        )
    return run.rows(rows)


def at_pace_of_positions(run: Trajectory, notify: Notify | None = None) -> Trajectory:
    """``run`` at the instants of its positions, where these repeat in motion while other signals are new: a logger that
    writes the latest of what came at several rates. ``notify`` is told how many rows that leaves.

    What else comes more slowly than the rows is interpolated between its own samples, as all else is between rows.
    """
    found = _samples(run, ["q"])
    if found is None or not _at_any_speed(run["q"], *found):
        return run
    every, hold = found
    # When the first was taken, nothing says.
    rows = every[1:]
    stamps = np.clip(truer_stamps(run.time[rows], run["q"][rows]), run.time[0], run.time[-1])
    signals = {"q": run["q"][rows]}
    for name in (s for s in run.signals if s != "q"):
        own = _samples(run, [name])
        at = np.arange(len(run.time)) if own is None else own[0]
        same = np.array_equal(at, every)
        signals[name] = run[name][rows] if same else CubicSpline(run.time[at], run[name][at])(stamps)
    if notify is not None:
        came, asked = 1e3 * float(np.median(np.diff(stamps))), 1e3 * run.dt
        notify(
            f"{run.name}: positions repeat in {1.0 - 1.0 / hold:.0%} of the rows in motion while other signals are "
            f"new: they come every {came:.3g} ms, logged every {asked:.3g} ms; all signals are taken at the instants "
            f"of the positions, {len(run.time)} -> {len(rows)} rows"
        )
    return replace(run, time=stamps, signals=signals)


def _at_any_speed(q: Array, rows: NDArray[np.intp], hold: float) -> bool:
    """Whether positions ``q`` (T, n) that are new at ``rows`` repeat in fast motion, too: coarse ones do in slow
    motion alone."""
    reach = int(np.ceil(hold)) + 1
    new = np.zeros(len(q), bool)
    new[rows] = True
    speed = np.zeros(len(q))
    speed[reach:-reach] = (np.abs(q[2 * reach :] - q[: -2 * reach]) / np.maximum(np.ptp(q, axis=0), 1e-12)).max(axis=1)
    moving = speed > 0.0
    fast = speed > np.median(speed[moving]) if moving.any() else moving
    return bool(np.mean(~new[fast]) > AS_OFTEN * np.mean(~new[moving & ~fast])) if fast.any() else False


def _samples(run: Trajectory, names: Sequence[str]) -> tuple[NDArray[np.intp], float] | None:
    """Rows in which signals ``names`` are new, of a rest as many as of a motion, and how many rows a sample lasts in
    motion; None where rows repeat no sample."""
    if "q" not in run or len(run.time) < FEWEST_ROWS:
        return None
    # Signal by signal: a log of an hour fills much of a memory.
    same = np.all([(run[s][1:] == run[s][:-1]).all(axis=1) for s in names], axis=0)
    first = np.flatnonzero(np.concatenate([[True], ~same]))
    lengths = np.diff(np.append(first, len(run.time)))
    moving = lengths <= RESTS * np.median(lengths)
    hold = float(lengths[moving].mean())
    moves = (run["q"][1:] != run["q"][:-1]).any(axis=1) if "q" in names else True
    if 1.0 - 1.0 / hold < REPEATED or not _together(run, names, ~same & moves):
        return None
    rests = zip(first[~moving], lengths[~moving], strict=True)
    more = [start + np.round(np.arange(hold, length, hold)).astype(int) for start, length in rests]
    rows = np.unique(np.concatenate([first, *more]))
    return rows[rows < len(run.time)], hold


def _together(run: Trajectory, names: Sequence[str], new: NDArray[np.bool_]) -> bool:
    """True where signals ``names`` are ``new`` (T - 1,) together, and not since they come in coarse steps."""
    if not new.any():
        return False
    share = np.concatenate([(run[s][1:][new] != run[s][:-1][new]).mean(axis=0) for s in names])
    share = share[share > STILL]
    if len(share) < FEWEST or np.median(share) < TOGETHER:
        return False
    signal = run["q" if "q" in names else names[0]]
    return not all(_is_coarse(x) for x in np.abs(signal[1:][new] - signal[:-1][new]).T if x.any())


def _is_coarse(changes: Array) -> bool:
    """True where most of a position's ``changes`` (T,), those there are, are by the least of them."""
    there = changes[changes > 1e-6 * changes.max()]
    return bool(np.mean(there < ONE_STEP * there.min()) > BY_ONE_STEP)
