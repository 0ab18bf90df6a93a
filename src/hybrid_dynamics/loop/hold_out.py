"""Test runs where none are given: the end of every training run, or of each joint's motion where they move in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop.blocks import passed_of
from hybrid_dynamics.loop.process import least_rows
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.trajectory import Trajectory

#: Positions this far apart [s] tell whether a joint moves: encoders step, and a step from sample to sample is fast.
APART = 0.05
#: Pieces that a run is looked at in [s].
PIECE = 0.1
#: Largest share of what would be held out that is left out as a gap, and in which the arm may rest at the end.
MOST_GAP, MOST_REST = 0.3, 0.5
#: Samples that tell nothing of any motion.
FEWEST_SAMPLES = 10
#: Rest [s] that is kept after the last motion.
REST = 0.5


@dataclass(frozen=True)
class Split:
    """Runs, or pieces of them, to learn from and held out, and what is to be said."""

    train: list[Trajectory]
    test: list[Trajectory]
    notes: list[str]


def hold_out(train: Sequence[Trajectory], test: Sequence[Trajectory], settings: LoopSettings) -> Split:
    """``train`` and ``test``.

    Without ``test`` it is the last ``settings.held_out_share`` of every training run after a gap; where a joint moves
    in that part alone, of each joint's motion. An end at which the arm rests proves nothing and is left out.
    """
    for run in (*train, *test):
        if len(run.time) < FEWEST_SAMPLES:
            raise InputError(f"run {run.name}: holds {len(run.time)} samples; expected a run of some seconds")
    notes: list[str] = []
    learned, held = list(train), list(test)
    if not test:
        learned, turned = [], []
        for run in (_until_it_rests(run, settings, notes) for run in train):
            own = _in_turn(run, settings)
            turned += [run.name] if own else []
            first, second = own or _at_the_end(run, settings)
            learned += first
            held += second
        of_each = f" (of {', '.join(turned)}, in which joints move in turn, of each joint's motion)" if turned else ""
        notes.append(
            f"no test run is given: the last {settings.held_out_share:.0%} of every training run{of_each} are held "
            "out; whether the result carries over to other motions is not shown"
        )
    if len({run.whole_name for run in train}) == 1:
        notes.append(
            f"one training run only: candidates are validated on {settings.time_folds} parts of it in turn; what is "
            "particular to this run cannot be told from what belongs to the robot"
        )
    return Split(learned, held, notes)


def _until_it_rests(run: Trajectory, settings: LoopSettings, notes: list[str]) -> Trajectory:
    """``run`` without an end at which the arm rests and that would be most of what is held out, which ``notes`` say."""
    moving = np.flatnonzero(_moving(run, settings).any(axis=1))
    rest = len(run.time) - 1 - (moving[-1] if len(moving) else 0)
    if not len(moving) or rest < MOST_REST * settings.held_out_share * len(run.time):
        return run
    end = min(int(moving[-1]) + 1 + round(REST / run.dt), len(run.time))
    left = run.time[-1] - run.time[end - 1]
    notes.append(f"{run.name}: the arm rests over the last {left:.1f} s, which are left out")
    return run.rows(slice(0, end))


def _at_the_end(run: Trajectory, settings: LoopSettings) -> tuple[list[Trajectory], list[Trajectory]]:
    rows = len(run.time)
    cut = int((1 - settings.held_out_share) * rows)
    gap = min(int(settings.held_out_gap / run.dt), rows // 10)
    return [run.rows(slice(0, cut))], [_held(run, slice(cut + gap, rows))]


def _in_turn(run: Trajectory, settings: LoopSettings) -> tuple[list[Trajectory], list[Trajectory]] | None:
    """Pieces of ``run`` to learn from and to hold out of each joint's motion; None where the end of the run loses no
    joint, or where turns are too short for the filter."""
    least = least_rows(run.dt, settings.process)
    whole = _moves(run, settings, least)
    if not np.any(whole & ~_moves(_at_the_end(run, settings)[0][0], settings, least)):
        return None
    moving = _moving(run, settings)
    pieces = min(max(round(np.ptp(run.time) / PIECE), 2), len(moving) // 2)
    edges = np.linspace(0, len(moving), pieces + 1).round().astype(int)
    end = passed_of(moving, edges) >= 1 - settings.held_out_share
    bounds = [0, *(edges[1:-1][np.diff(end)]), len(moving)]
    kept: list[Trajectory] = []
    held: list[Trajectory] = []
    for low, high in pairwise(map(int, bounds)):
        out = bool(end[np.searchsorted(edges, low, side="right") - 1])
        gap = min(int(settings.held_out_gap / run.dt), int(MOST_GAP * (high - low))) if out else 0
        if high - low - gap < least:
            continue
        if out:
            held.append(_held(run, slice(low + gap, high), f" {len(held) + 1}"))
        else:
            kept.append(replace(run.rows(slice(low, high)), name=f"{run.name} (part {len(kept) + 1})"))
    learned = np.any([_moves(piece, settings, 1) for piece in kept], axis=0) if kept else np.zeros_like(whole)
    return (kept, held) if held and np.all(learned[whole]) else None


def _held(run: Trajectory, rows: slice, number: str = "") -> Trajectory:
    return replace(run.rows(rows), split="test", name=f"{run.name} (held out{number})")


def _moves(run: Trajectory, settings: LoopSettings, least: int) -> NDArray[np.bool_]:
    """(n,) which joints move far enough to be learned from, on ``least`` samples or more."""
    rows = _moving(run, settings).sum(axis=0)
    return np.asarray((rows >= least) & (np.ptp(run["q"], axis=0) > settings.process.moving_range))


def _moving(run: Trajectory, settings: LoopSettings) -> NDArray[np.bool_]:
    """(K, n) where a joint moves."""
    step = max(round(APART / run.dt), 1)
    q = np.pad(run["q"], ((step, step), (0, 0)), mode="edge")
    speed = np.abs(q[2 * step :] - q[: -2 * step]) / (2 * step * run.dt)
    moving: NDArray[np.bool_] = speed >= settings.process.slow_speed
    return moving
