"""Test runs where none are given: the end of every training run, or of each joint's motion where they move in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.loop.blocks import passed_of, turns_of
from hybrid_dynamics.loop.process import least_rows
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.trajectory import Trajectory

#: Positions this far apart [s] tell whether a joint moves: encoders step, and a step from sample to sample is fast.
APART = 0.05
#: Pieces that a run is looked at in [s].
PIECE = 0.1
#: Largest share of what would be held out that is left out as a gap, and in which the arm may rest at the end.
MOST_GAP, MOST_REST = 0.3, 0.5
#: Rest [s] that is kept after the last motion.
REST = 0.5


def hold_out(
    train: list[Trajectory], test: list[Trajectory], settings: LoopSettings
) -> tuple[list[Trajectory], list[Trajectory], list[str]]:
    """``train``, test runs, and what is to be said of them.

    Without ``test`` it is the last ``settings.held_out_share`` of every training run after a gap; where its joints move
    in turn, of each joint's motion: the last part of the time would hold all that is known of the last joint. An end at
    which the arm rests proves nothing and is left out.
    """
    notes: list[str] = []
    kept, held = train, test
    if not test:
        train = [_until_it_rests(run, settings, notes) for run in train]
        cut = {run.name: _in_turn(run, settings) for run in train}
        kept, held = [], []
        for run in train:
            own = cut[run.name] or _at_the_end(run, settings)
            kept += own[0]
            held += own[1]
        turned = [name for name, own in cut.items() if own]
        of_each = f" (of {', '.join(turned)}, in which joints move in turn, of each joint's motion)" if turned else ""
        notes.append(
            f"no test run is given: the last {settings.held_out_share:.0%} of every training run{of_each} are held "
            "out; whether the result carries over to other motions is not shown"
        )
    if len(train) == 1:
        notes.append(
            f"one training run only: candidates are validated on {settings.time_folds} parts of it in turn; what is "
            "particular to this run cannot be told from what belongs to the robot"
        )
    return kept, held, notes


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
    """Pieces of ``run`` to learn from and to hold out, None where its joints do not move in turn or too shortly."""
    moving = _moving(run, settings)
    if turns_of(moving, settings.time_folds) == 1:
        return None
    edges = np.linspace(0, len(moving), max(round(np.ptp(run.time) / PIECE), 2) + 1).round().astype(int)
    end = passed_of(moving, edges) >= 1 - settings.held_out_share
    bounds = [0, *(edges[1:-1][np.diff(end)]), len(moving)]
    kept: list[Trajectory] = []
    held: list[Trajectory] = []
    least = least_rows(run.dt, settings.process)
    for low, high in pairwise(map(int, bounds)):
        out = bool(end[np.searchsorted(edges, low, side="right") - 1])
        gap = min(int(settings.held_out_gap / run.dt), int(MOST_GAP * (high - low))) if out else 0
        if high - low - gap < least:
            continue
        number = len(held if out else kept) + 1
        if out:
            held.append(_held(run, slice(low + gap, high), f" {number}"))
        else:
            kept.append(replace(run.rows(slice(low, high)), name=f"{run.name} (part {number})"))
    learned = _joints(kept, settings)
    # Where a turn is too short for the filter, the end of the run is held out as ever.
    return (kept, held) if kept and held and np.all(learned == moving.any(axis=0)) else None


def _held(run: Trajectory, rows: slice, number: str = "") -> Trajectory:
    return replace(run.rows(rows), split="test", name=f"{run.name} (held out{number})")


def _joints(runs: Sequence[Trajectory], settings: LoopSettings) -> NDArray[np.bool_]:
    return np.any([_moving(run, settings).any(axis=0) for run in runs], axis=0) if runs else np.zeros(0, bool)


def _moving(run: Trajectory, settings: LoopSettings) -> NDArray[np.bool_]:
    """(K, n) where a joint moves."""
    step = max(round(APART / run.dt), 1)
    q = np.pad(run["q"], ((step, step), (0, 0)), mode="edge")
    speed = np.abs(q[2 * step :] - q[: -2 * step]) / (2 * step * run.dt)
    moving: NDArray[np.bool_] = speed >= settings.process.slow_speed
    return moving
