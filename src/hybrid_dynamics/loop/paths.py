"""Runs that repeat one motion: held out alone, such a run says whether torques repeat, not whether a model carries over
to another motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.types import Array

#: States are the same where every position and speed agrees to this share of its spread: a controller's tracking and
#: the filtered noise of speeds are well below, two motions through the same ranges far above.
NEAR = 0.05
#: Ranges of positions agree to this share of them where the motion may be the same.
RANGE = 0.05
#: Share of the shorter run's states in motion that are in the other one, too, from which it repeats it.
REPEATED = 0.9
#: States that are looked up, and the first of them that must be there for the rest to be asked.
ASKED, FIRST = 200, 20
#: Rows between two samples, linearly: at low rates neighbours are farther apart than runs.
BETWEEN = 4


def paths_of(runs: Sequence[Run]) -> NDArray[np.int_]:
    """(R,) number of the path of every run: runs that repeat one motion have the same one, numbered from 0.

    Arms of which fewer than two joints move have a path a run: the states of one joint are soon the same by chance.
    """
    states = [_states(run) for run in runs]
    spread = np.sqrt(np.mean([np.var(s, axis=0) if len(s) else np.zeros(s.shape[1]) for s in states], axis=0))
    moves = spread > 0
    path = np.arange(len(runs))
    if np.sum(moves[: len(moves) // 2]) < 2:
        return path
    scaled = [s[:, moves] / spread[moves] for s in states]
    ends = [np.vstack([s.min(axis=0), s.max(axis=0)]) if len(s) else None for s in scaled]
    trees: dict[int, KDTree] = {}
    for b in range(1, len(runs)):
        for a in range(b):
            one, other = ends[a], ends[b]
            if one is None or other is None or path[b] == path[a]:
                continue
            if np.any(np.abs(one - other) > np.maximum(RANGE * np.ptp(one, axis=0), NEAR)):
                continue
            if a not in trees:
                trees[a] = KDTree(_finer(scaled[a]))
            if _repeats(scaled[b], trees[a]):
                path[path == path[b]] = path[a]
    return np.unique(path, return_inverse=True)[1]


def _states(run: Run) -> Array:
    """(M, 2n) positions and speeds of rows in which a joint moves; of joints that do not, nothing."""
    rows = run.mask.any(axis=1)
    return np.hstack([run.q, run.dq])[rows] * np.tile(run.mask.any(axis=0), 2)


def _finer(states: Array) -> Array:
    place = np.arange(0, len(states) - 1 + 0.5 / BETWEEN, 1 / BETWEEN)
    below = np.minimum(place.astype(int), len(states) - 2)
    part = (place - below)[:, None]
    return np.asarray((1 - part) * states[below] + part * states[below + 1])


def _repeats(states: Array, tree: KDTree) -> bool:
    # Not in their order: a run that begins alike is told apart by its first few states, too.
    asked = states[np.random.default_rng(0).permutation(len(states))[:ASKED]]
    for some in (asked[:FIRST], asked):
        distance, _ = tree.query(some, p=np.inf, distance_upper_bound=NEAR)
        if np.mean(np.isfinite(distance)) < REPEATED:
            return False
    return True
