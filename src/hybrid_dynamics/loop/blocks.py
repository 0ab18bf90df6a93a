"""Runs cut into blocks of time, and blocks into folds: what is held out together, and what is independent of what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.loop.paths import paths_of
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.types import Array

Indices = NDArray[np.int_]

#: A block lasts at least this many windows of the filter.
BLOCK_WINDOWS = 2.0
#: Share of a joint's moving rows in one run beyond which runs cannot stand in for each other.
MOST_IN_ONE = 0.8
#: Share of a run's positions, joint by joint, that others must have been around for them to predict it.
LEAST_COMMON = 0.5
#: Share of a joint's moving rows in one part of a run from which it moves in turn: the other parts say little of it.
#: With fewer rows than these for every part nothing is gained by parts of its motion.
IN_TURN, LEAST_ROWS = 0.45, 10
#: Runs are held out whole where the links' torque on them, learnt from the others, is at most this many times as
#: uncertain as on those; else these few parts of each. States of a run that are looked at, and the least that is
#: taken to be known of what no other run shows, as a share of what is known best.
FARTHEST, FEW_PARTS, STATES, UNKNOWN = 4.0, 3, 300, 1e-3
#: Why runs are parted: there is one motion, no run could be predicted from others, or links' torque not; else whole.
REPEATED, APART, FAR, WHOLE = "one motion", "apart", "far", "whole"
#: Fewest blocks of time from which an uncertainty is taken, and the most that are kept.
FEWEST_BLOCKS, MOST_BLOCKS = 24, 100


@dataclass(frozen=True)
class Blocks:
    """Contiguous pieces of the runs: each one's ``run`` (B,), and its first and last (excluded) row in it."""

    run: Indices
    rows: tuple[tuple[int, int], ...]

    def __len__(self) -> int:
        return len(self.rows)


@dataclass(frozen=True)
class Folds:
    """Which ``number`` of parts are held out in turn: ``of_block`` (B,) tells the fold of every one of ``blocks``."""

    blocks: Blocks
    number: int
    of_block: Indices

    @cached_property
    def own(self) -> list[Indices]:
        """Blocks of every fold."""
        return [np.flatnonzero(self.of_block == f) for f in range(self.number)]

    @cached_property
    def parts(self) -> list[list[slice]]:
        """Blocks of every fold as slices: what they select is no copy."""
        return [_slices(own) for own in self.own]

    @cached_property
    def edges(self) -> list[Indices]:
        """Blocks of other folds that border on a fold within a run; none where nothing else would be left.

        Neighbours are not independent: they take no part in the fit that the fold is predicted from.
        """
        return [self._edge(f) for f in range(self.number)]

    def _edge(self, fold: int) -> Indices:
        mine = self.of_block == fold
        edge = np.zeros(len(mine), bool)
        same = self.blocks.run[1:] == self.blocks.run[:-1]
        edge[1:] |= same & mine[:-1]
        edge[:-1] |= same & mine[1:]
        edge &= ~mine
        return np.flatnonzero(edge) if np.any(~mine & ~edge) else np.zeros(0, int)


def folds_of(runs: Sequence[Run], settings: LoopSettings) -> Folds:
    """The runs in blocks; whole runs are the folds, or parts of them where runs cannot stand in for each other.

    Runs that repeat one motion are held out together; where all do, parts of that motion are.
    """
    owner, fold, bounds = [], [], []
    path, why = parted(runs)
    single = why != WHOLE
    parts = min(FEW_PARTS, settings.time_folds) if why == FAR else settings.time_folds
    folds = parts if single else int(path.max()) + 1
    lengths = [float(run.time[-1] - run.time[0]) for run in runs]
    # Blocks are long against the filter's window; where a log is short, as short as that allows.
    wanted = max(settings.block, sum(lengths) / MOST_BLOCKS)
    for r, (run, length) in enumerate(zip(runs, lengths, strict=True)):
        shortest = int(length * run.cutoff / BLOCK_WINDOWS)
        fewest = min(int(np.ceil(FEWEST_BLOCKS / len(runs))), shortest)
        if single and (turns := turns_of(run.mask, folds)) > 1:
            fewest = max(fewest, min(turns * folds, shortest, max(MOST_BLOCKS // len(runs), folds)))
        per_run = max(round(length / wanted), fewest, folds if single else 1)
        edges = np.linspace(0, len(run.time), per_run + 1).round().astype(int)
        bounds += [(int(low), int(high)) for low, high in pairwise(edges)]
        owner += [r] * per_run
        fold.append(parts_of(run.mask, edges, folds) if single else np.full(per_run, path[r]))
    return Folds(Blocks(np.array(owner), tuple(bounds)), folds, np.concatenate(fold))


def parted(runs: Sequence[Run]) -> tuple[Indices, str]:
    """The path (R,) of every run, and why parts of them are held out: :data:`REPEATED`, :data:`APART` or :data:`FAR`;
    :data:`WHOLE` where whole runs are."""
    path = paths_of(runs)
    if path.max() == 0:
        return path, REPEATED
    if not _share_motion(runs, path):
        return path, APART
    return path, FAR if reach_of(runs, path) > FARTHEST else WHOLE


def turns_of(moving: NDArray[np.bool_], number: int) -> int:
    """How many turns the joints of ``moving`` (K, n) take: 1 where no part of ``number`` of the time has much more of
    a joint's motion (:data:`IN_TURN`) than the others."""
    rows = moving.sum(axis=0)
    part = np.arange(len(moving)) * number // len(moving)
    most = np.max([moving[part == p].sum(axis=0) for p in range(number)], axis=0)
    in_turn = (rows >= LEAST_ROWS * number) & (most >= max(IN_TURN, 1.5 / number) * rows)
    return int(np.ceil(moving.any(axis=1).sum() / rows[in_turn].min())) if number > 1 and in_turn.any() else 1


def parts_of(moving: NDArray[np.bool_], edges: Indices, number: int) -> Indices:
    """(B,) which of ``number`` parts of its joints' motion ``moving`` (K, n) a piece of a run is; ``edges`` (B + 1,).

    Contiguous parts of the time where joints move together. Where they move in turn a part of the time would hold all
    that is known of a joint: there it is a part of each joint's own motion.
    """
    pieces = len(edges) - 1
    if turns_of(moving, number) == 1:
        return np.arange(pieces) * number // pieces
    part: Indices = np.minimum((passed_of(moving, edges) * number).astype(int), number - 1)
    return part


def passed_of(moving: NDArray[np.bool_], edges: Indices) -> Array:
    """(B,) which share of its joints' motion ``moving`` (K, n) has passed in the middle of a piece of a run; ``edges``
    (B + 1,)."""
    pieces = len(edges) - 1
    until = np.vstack([np.zeros(moving.shape[1], int), np.cumsum(moving, axis=0)])
    own = np.diff(until[edges], axis=0) / np.maximum(until[-1], 1)
    before = np.cumsum(own, axis=0) - own / 2
    weight = own.sum(axis=1)
    passed = (own * before).sum(axis=1) / np.where(weight > 0, weight, 1.0)
    # Where nothing moves, the part of what moved last.
    last = np.maximum.accumulate(np.where(weight > 0, np.arange(pieces), 0))
    return np.asarray(passed[last])


def block_starts(time: Array, block: float) -> Indices:
    """First rows of blocks of about ``block`` [s] of a run with the stamps ``time`` (K,), two at least."""
    count = max(round(float(time[-1] - time[0]) / block), 2)
    return np.linspace(0, len(time), count + 1).round().astype(int)[:-1]


def folds_by_time(runs: Sequence[Run], blocks: Blocks, number: int) -> Folds:
    """Parts of every run in turn (:func:`parts_of`), so that every run is in every fit."""
    of_block = np.zeros(len(blocks), int)
    for r, run in enumerate(runs):
        mine = np.flatnonzero(blocks.run == r)
        edges = np.array([*(blocks.rows[b][0] for b in mine), len(run.time)])
        of_block[mine] = parts_of(run.mask, edges, number)
    return Folds(blocks, number, of_block)


def _share_motion(runs: Sequence[Run], path: Indices) -> bool:
    """False where the motions of the runs, one a ``path`` (R,), could not be predicted from the others.

    That is so where there is one only, where a joint moves in hardly more than one, and where most joints are elsewhere
    in every one: what a body fitted to some poses says of others is no measure of whether it is there.
    """
    paths = range(int(path.max()) + 1)
    by_run = np.array([run.mask.sum(axis=0) for run in runs], float)
    rows = np.array([by_run[path == p].sum(axis=0) for p in paths])
    total = rows.sum(axis=0)
    if len(rows) < 2 or np.any(rows.max(axis=0)[total > 0] > MOST_IN_ONE * total[total > 0]):
        return False
    inside = np.zeros(by_run.shape)
    for k, run in enumerate(runs):
        others = np.concatenate([other.q for other, p in zip(runs, path, strict=True) if p != path[k]])
        inside[k] = np.mean((run.q >= others.min(axis=0)) & (run.q <= others.max(axis=0)), axis=0)
    return bool(np.median(inside.mean(axis=0)[total > 0]) >= LEAST_COMMON)


def reach_of(runs: Sequence[Run], path: Indices) -> float:
    """How uncertain the links' torque is on a run's motion, learnt from other paths, as a multiple of on these.

    Mean variance of the predicted torque over that on the states learnt from, every joint weighed by its torque: 1
    where all move alike; the geometric mean over the runs. A matter of the motion alone, whatever is missing.
    """
    mask = np.concatenate([run.mask for run in runs])
    torque = np.concatenate([run.tau for run in runs])
    spread = np.array([np.std(own[some]) if some.any() else 0.0 for own, some in zip(torque.T, mask.T, strict=True)])
    weight = np.where(spread > 0, 1.0 / np.where(spread > 0, spread, 1.0), 0.0)
    seen = [k for k, run in enumerate(runs) if run.mask.any()]
    if len({int(path[k]) for k in seen}) < 2:
        return 1.0
    rows = []
    for run in (runs[k] for k in seen):
        some = np.flatnonzero(run.mask.any(axis=1))
        some = some[np.linspace(0, len(some) - 1, min(STATES, len(some))).astype(int)]
        links = run.motion.robot.regressor(run.q[some], run.dq[some], run.ddq[some])
        rows.append((links * (weight * run.mask[some])[..., None]).reshape(-1, links.shape[-1]))
    size = np.sqrt(np.mean(np.concatenate(rows) ** 2, axis=0))
    by_path: dict[int, list[Array]] = {}
    for k, own in zip(seen, rows, strict=True):
        by_path.setdefault(int(path[k]), []).append(own / np.where(size > 0, size, 1.0))
    gram = {p: np.sum([own.T @ own for own in runs_of], axis=0) for p, runs_of in by_path.items()}
    count = {p: sum(map(len, runs_of)) for p, runs_of in by_path.items()}
    every, total = np.sum(list(gram.values()), axis=0), sum(count.values())
    reach = []
    for p, runs_of in by_path.items():
        known = every - gram[p]
        values, directions = np.linalg.eigh(known)
        # What the others know nothing of is uncertain by a finite amount: nothing hangs on an exact zero.
        values = np.maximum(values, 0.0) + UNKNOWN**2 * values[-1]
        parameters = np.sum(np.diag(directions.T @ known @ directions) / values)
        for own in runs_of:
            variance = np.mean(np.sum((own @ directions) ** 2 / values, axis=1))
            reach.append(variance * (total - count[p]) / parameters)
    return float(np.exp(np.mean(np.log(reach))))


def _slices(index: Indices) -> list[slice]:
    """Ascending ``index`` as slices."""
    parts = np.split(index, np.flatnonzero(np.diff(index) > 1) + 1)
    return [slice(int(p[0]), int(p[-1]) + 1) for p in parts if len(p)]
