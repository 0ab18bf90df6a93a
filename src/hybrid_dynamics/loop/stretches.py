"""Hours of logs as stretches of a minute, spread over all of them: as much as a result needs, and as a memory holds.

Runs are taken one after the other as they are read. As long as all of them together are short enough they stay as they
are. Beyond, one of every two neighbouring stretches is let go whenever more than twice as much is held as was asked
for, and at the end as many as are asked for are picked from the rest: at no time is more held than that and the run
that is just read. Which one of two it is follows no pattern, since logs do: there and back, one tool and the other.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: Length [s] of a stretch: many times the slowest motion of an arm at work, and short beside an hour.
STRETCH = 60.0


def spread(runs: Iterable[Trajectory], longest: float, what: str) -> tuple[list[Trajectory], list[str]]:
    """``runs`` as they are where they last ``longest`` [s] or less together, else stretches of them that do; and what
    is to be said of that (``what``: of which runs).

    A stretch knows when its run began, and holds nothing of the rest of it in memory.
    """
    whole: list[Trajectory] = []
    pieces: list[tuple[int, Trajectory]] = []
    given, count, every, logs = 0.0, 0, 1, 0
    for run in runs:
        logs += 1
        given += _lasts(run)
        if given <= longest:
            whole.append(run)
            continue
        for piece in (piece for one in (*whole, run) for piece in _stretches(one)):
            if count % every == _any_of(every, count // every):
                pieces.append((count, piece))
            count += 1
            while sum(_lasts(piece) for _, piece in pieces) > 2 * longest and len(pieces) > 1:
                every *= 2
                pieces = _one_a_cell(pieces, every)
        pieces = [(k, _alone(piece)) for k, piece in pieces]
        whole = []
    if given <= longest:
        return whole, []
    held = sum(_lasts(piece) for _, piece in pieces)
    some = min(max(int(len(pieces) * longest / held), 1), len(pieces)) if held > 0 else len(pieces)
    cells = np.array_split(np.arange(len(pieces)), some)
    kept = [pieces[cell[_any_of(len(cell), k)]][1] for k, cell in enumerate(cells)]
    of = f"{logs} {what} runs" if logs > 1 else f"one {what} run"
    lasts = "last" if logs > 1 else "lasts"
    which = f"{some} stretches, spread over them all, are" if some > 1 else "one stretch of it is"
    note = (
        f"{of} of {_long(given)} {lasts} longer than {_long(longest)}: {which} looked at, "
        f"{_long(sum(map(_lasts, kept)))} in all; the setting longest [s] is how much"
    )
    return kept, [note]


def _any_of(number: int, cell: int) -> int:
    """One of ``number``, the same every time for the same ``cell``, and of neighbouring cells in no order."""
    return zlib.crc32(f"{number} {cell}".encode()) % number


def _one_a_cell(pieces: list[tuple[int, Trajectory]], every: int) -> list[tuple[int, Trajectory]]:
    """One of the ``pieces``, numbered in the order of time, in every cell of ``every`` numbers."""
    cells: dict[int, list[tuple[int, Trajectory]]] = {}
    for k, piece in pieces:
        cells.setdefault(k // every, []).append((k, piece))
    return [own[_any_of(len(own), cell)] for cell, own in cells.items()]


def _lasts(run: Trajectory) -> float:
    """Duration [s]; of stamps that are none, which are refused later, nothing."""
    return run.duration if np.isfinite(run.duration) else 0.0


def _stretches(run: Trajectory) -> list[Trajectory]:
    """``run`` in parts of equal length, about :data:`STRETCH`; one that is no longer than that as it is."""
    parts = max(round(_lasts(run) / STRETCH), 1)
    if parts == 1:
        return [run]
    ends = np.linspace(0, len(run.time), parts + 1).astype(int)
    pieces = [run.rows(slice(first, last)) for first, last in pairwise(map(int, ends))]
    return [replace(p, name=f"{run.name} (from {p.time[0] - run.start:.0f} s)", whole=run.whole_name) for p in pieces]


def _alone(piece: Trajectory) -> Trajectory:
    """``piece`` without the memory of the run that it was cut from."""
    return replace(piece, time=_own(piece.time), signals={s: _own(x) for s, x in piece.signals.items()})


def _own(x: Array) -> Array:
    return x if x.base is None else x.copy()


def _long(seconds: float) -> str:
    """``seconds`` as a person says them."""
    if seconds >= 5400.0:
        return f"{seconds / 3600:.1f} h"
    return f"{seconds / 60:.0f} min" if seconds >= 120.0 else f"{seconds:.0f} s"
