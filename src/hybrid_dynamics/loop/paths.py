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
#: Least spread of a run's positions and speeds, as a share of the other's, with which it may repeat it or a part of it.
ALIKE = 0.5
#: Share of the shorter run's states in motion that are in the other one, too, from which it repeats it.
REPEATED = 0.9
#: States that are looked up, and the first of them that must be there for the rest to be asked.
ASKED, FIRST = 200, 20
#: States of a run that are kept, and states between two of them, linearly: at low rates neighbours are farther apart
#: than runs.
KEPT, BETWEEN = 20_000, 4


def paths_of(runs: Sequence[Run]) -> NDArray[np.int_]:
    """(R,) number of the path of every run: runs that repeat one motion have the same one, numbered from 0.

    Runs in which fewer than two joints move have a path each: the states of one joint are soon the same by chance.
    """
    path = np.arange(len(runs))
    if len(runs) < 2:
        return path
    states = [_states(run) for run in runs]
    low, high, spread = (np.array([f(s, axis=0) for s in states]) for f in (np.min, np.max, np.std))
    size = np.array([len(s) for s in states])
    moves = spread > 0
    for a in map(int, np.argsort(-size, kind="stable")):
        slack = NEAR * np.maximum(spread[a], 1e-12)
        inside = np.all((low >= low[a] - slack) & (high <= high[a] + slack) & (moves == moves[a]), axis=1)
        enough = int(moves[a][: moves.shape[1] // 2].sum()) >= 2
        shorter = np.flatnonzero(inside & (size <= size[a]) & (path != path[a]) & (size > 1)) if enough else ()
        tree = None
        for b in map(int, shorter):
            # A small motion inside a large one is near everything of it.
            if path[b] == path[a] or np.any(spread[b] < ALIKE * spread[a]):
                continue
            scale = np.where(moves[a], spread[a], 1.0)
            tree = KDTree(_finer(states[a]) / scale) if tree is None else tree
            if _repeats(states[b] / scale, tree):
                path[path == path[b]] = path[a]
    return np.unique(path, return_inverse=True)[1]


def _states(run: Run) -> Array:
    """(M, 2n) positions and speeds of rows in which a joint moves, at least one row; 0 for joints that do not."""
    rows = np.flatnonzero(run.mask.any(axis=1))
    rows = rows[:: max(-(-len(rows) // KEPT), 1)]
    states = np.hstack([run.q, run.dq])[rows] * np.tile(run.mask.any(axis=0), 2)
    return states if len(rows) else np.zeros((1, states.shape[1]))


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
