"""Hours of logs as stretches of a minute, evenly spread: as much as a result needs, and as a memory holds.

Runs are taken one after the other as they are read. As long as all of them together are short enough they stay as they
are. Beyond, every second minute is let go whenever more than twice as much is held as was asked for, and at the end as
many as are asked for are picked from the rest: at no time is more held than that and the run that is just read.
"""

from __future__ import annotations

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
    pieces: list[Trajectory] = []
    given, count, every = 0.0, 0, 1
    logs = 0
    for run in runs:
        logs += 1
        given += run.duration
        if given <= longest:
            whole.append(run)
            continue
        for piece in (piece for one in (*whole, run) for piece in _stretches(one)):
            if count % every == 0:
                pieces.append(_alone(piece))
            count += 1
        whole = []
        while sum(piece.duration for piece in pieces) > 2 * longest and len(pieces) > 1:
            every *= 2
            pieces = pieces[::2]
    if given <= longest:
        return whole, []
    held = sum(piece.duration for piece in pieces)
    some = max(min(int(len(pieces) * longest / held), len(pieces)), 1)
    pieces = [pieces[k] for k in np.linspace(0, len(pieces), some, endpoint=False).astype(int)]
    of = f"{logs} {what} runs" if logs > 1 else f"one {what} run"
    note = (
        f"{of} of {_long(given)} last longer than {_long(longest)}: {some} stretches of about a minute, evenly spread, "
        f"are looked at, {_long(sum(piece.duration for piece in pieces))} in all; the setting longest [s] is how much"
    )
    return pieces, [note]


def _stretches(run: Trajectory) -> list[Trajectory]:
    """``run`` in parts of equal length, about :data:`STRETCH`; one that is no longer than that as it is."""
    parts = max(round(run.duration / STRETCH), 1)
    if parts == 1:
        return [run]
    ends = np.linspace(0, len(run.time), parts + 1).astype(int)
    pieces = [run.rows(slice(first, last)) for first, last in pairwise(map(int, ends))]
    return [replace(p, name=f"{run.name} (from {p.time[0] - run.start:.0f} s)") for p in pieces]


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
