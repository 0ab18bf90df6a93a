"""Boxes in time: intervals in which what is left of a joint's torque stands off by a constant, as nothing else does.

For every interval the gain of a constant within it is computed beside the columns of a model (what these take up of the
box is taken off: a scan of likelihood ratios). The best interval counts only where

- it stands out from what else such boxes gain in these runs (:data:`STANDS_OUT`): a law that is missing makes many;
- it is a plateau, flat against its height (:data:`FLAT`), and comes and goes within the filter's window
  (:data:`JUMPS`) as nothing else does (:data:`SUDDEN`): laws of the motion change as slowly as the motion does;
- it does not return with the motion: where another time passes the same states and stands off there too, a law of the
  motion does it (:data:`RETURNS`), or something that cannot be told from one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from hybrid_dynamics.types import Array

#: Boundaries of intervals are looked for in such steps [s]; the shortest box [s]; the largest share of a run.
STEP, SHORTEST, LARGEST_SHARE = 0.1, 0.3, 0.6
#: A box gains so many times what the next best interval does.
STANDS_OUT = 8.0
#: Within it what is left is at most this share of its height (rms); beside its ends the torque jumps by at least that
#: share, over stretches of :data:`BESIDE` [s], and so many times more than it does anywhere else.
FLAT, JUMPS, BESIDE, SUDDEN = 0.6, 0.5, 0.3, 1.5
#: States are the same within this distance (rms over their entries, each in units of its spread). Where so many rows of
#: a box have their like elsewhere, what stands off there is at most the share :data:`RETURNS` of the box's height.
ALIKE, ENOUGH, RETURNS = 0.1, 0.3, 0.5
#: So many boxes of one joint at most.
MOST = 3
#: Lengths that are looked at grow by this factor.
_GROWTH = 1.25
#: Columns are held by this share of their size: where a model is rich and a log short they would follow every sample.
_RIDGE = 1e-5


@dataclass(frozen=True)
class Interval:
    """Rows ``start`` to ``stop`` (excluded) of run number ``run``; of all runs where that is None."""

    run: int | None
    start: int
    stop: int


@dataclass(frozen=True)
class Stretch:
    """One run of a joint as it is scanned: ``columns`` (K, p), what they are to explain ``left`` (K,) [N m], which rows
    count, ``mask`` (K,), and where the robot is, ``states`` (K, s), in units of their spread."""

    columns: Array
    left: Array
    mask: NDArray[np.bool_]
    states: Array


def boxes(runs: Sequence[Stretch], dt: float, window: float) -> list[Interval]:
    """Boxes of one joint in ``runs``, rows ``dt`` [s] apart and smoothed over ``window`` [s]; mostly none.

    Boxes at the same time of every run count as one (``run`` None): what a robot touches in every repetition.
    """
    if sum(int(r.mask.sum()) for r in runs) < 2 * runs[0].columns.shape[1] + 20:
        return []
    found: list[Interval] = []
    gains: list[float] = []
    for _ in range(MOST + 1):
        best = _best(_beside(runs, found), dt, found, window)
        if best is None:
            break
        gains.append(best[0])
        found.append(best[1])
    for many in reversed([k + 1 for k, (a, b) in enumerate(pairwise(gains)) if a >= STANDS_OUT * b]):
        kept = found[:many]
        left = _beside(runs, kept)
        if all(_is_plateau(left, k, many, kept[k], dt, window) for k in range(many)) and not _return(left, kept, dt):
            return kept
    return []


def _beside(runs: Sequence[Stretch], found: Sequence[Interval]) -> list[Stretch]:
    """``runs`` with a column for each interval of ``found`` at the end."""
    out = []
    for number, run in enumerate(runs):
        own = [_box(len(run.left), i) if i.run in (None, number) else np.zeros(len(run.left)) for i in found]
        out.append(replace(run, columns=np.column_stack([run.columns, *own])))
    return out


def _box(rows: int, interval: Interval) -> Array:
    out = np.zeros(rows)
    out[interval.start : interval.stop] = 1.0
    return out


def _best(
    runs: Sequence[Stretch], dt: float, found: Sequence[Interval], window: float
) -> tuple[float, Interval] | None:
    """The largest gain of a box beside the columns of ``runs``, and its interval; none that overlaps or touches
    ``found``: what is left at the ends of a box that is a step off, or smoothed, is no other box."""
    left, basis = _projected(runs)
    step, pad = max(round(STEP / dt), 1), max(round((STEP + window) / dt), 1)
    sums = []
    for own, q, run in zip(left, basis, runs, strict=True):
        taken = np.zeros(len(own), bool)
        for i in found:
            if i.run is None or runs[i.run] is run:
                taken[max(i.start - pad, 0) : i.stop + pad] = True
        stacked = np.column_stack([own, run.mask, taken, q])
        sums.append(np.vstack([np.zeros(stacked.shape[1]), np.cumsum(stacked, axis=0)]))
    common = min(map(len, sums))
    choices = [_best_of([own[:common] for own in sums], step, dt, None)]
    if len(sums) > 1:
        choices += [_best_of([own], step, dt, number) for number, own in enumerate(sums)]
    return max((c for c in choices if c is not None), key=lambda c: c[0], default=None)


def _best_of(whole: Sequence[Array], step: int, dt: float, run: int | None) -> tuple[float, Interval] | None:
    """The same of boxes at one time of all of ``whole``: running sums of what is left, rows that count, rows taken, and
    an orthonormal basis of the columns. Boundaries are looked for in steps, then to the row."""
    sums = [own[::step] for own in whole]
    longest = int(LARGEST_SHARE * (len(sums[0]) - 1))
    shortest = max(round(SHORTEST / (step * dt)), 2)
    lengths = [shortest]
    while lengths[-1] < longest:
        lengths.append(max(lengths[-1] + 1, int(lengths[-1] * _GROWTH)))
    best = max((_at_length(sums, n, step, run) for n in lengths if n <= longest), key=lambda c: c[0], default=None)
    if best is None or best[0] <= 0:
        return None
    # The lengths in between: where an interval ends too early what is left of it looks like another.
    n = (best[1].stop - best[1].start) // step
    near = range(max(int(n / _GROWTH), shortest), min(int(n * _GROWTH) + 1, longest) + 1)
    return _to_the_row(whole, max((best, *(_at_length(sums, n, step, run) for n in near)), key=lambda c: c[0]), step)


def _at_length(sums: Sequence[Array], length: int, step: int, run: int | None) -> tuple[float, Interval]:
    """The best box of ``length`` steps and its gain; 0 where there is none."""
    gain = _gains([own[length:] - own[:-length] for own in sums], np.full(len(sums[0]) - length, length * step))
    k = int(np.argmax(gain))
    return float(gain[k]), Interval(run, k * step, (k + length) * step)


def _to_the_row(whole: Sequence[Array], best: tuple[float, Interval], step: int) -> tuple[float, Interval]:
    """The best box whose boundaries are within a step of those of ``best``."""
    at, rows = best[1], len(whole[0]) - 1
    starts = np.arange(max(at.start - step, 0), at.start + step)
    stops = np.arange(at.stop - step + 1, min(at.stop + step, rows) + 1)
    gain = _gains([own[stops] - own[starts][:, None] for own in whole], stops - starts[:, None])
    k, m = np.unravel_index(np.argmax(gain), gain.shape)
    return max(best, (float(gain[k, m]), Interval(at.run, int(starts[k]), int(stops[m]))), key=lambda c: c[0])


def _gains(inside: Sequence[Array], rows: NDArray[np.int_]) -> Array:
    """What boxes gain (...,) of ``rows`` (...,) in each run, where ``inside`` (..., 3 + p) are the sums in them."""
    along = np.sum([part[..., 0] for part in inside], axis=0)
    count = np.sum([part[..., 1] for part in inside], axis=0)
    taken = np.sum([part[..., 2] for part in inside], axis=0)
    explained = np.sum(np.sum([part[..., 3:] for part in inside], axis=0) ** 2, axis=-1)
    free = count - explained
    # Where the columns make most of a box nothing tells one from the other.
    good = (taken == 0) & (rows > 0) & (count >= 0.5 * rows * len(inside)) & (free > 0.1 * count)
    return np.asarray(np.where(good, along**2 / np.maximum(free, 1e-300), 0.0))


def _projected(runs: Sequence[Stretch]) -> tuple[list[Array], list[Array]]:
    """What a fit of the columns leaves (K,), 0 where rows do not count, and a basis of the columns (K, p) that is
    orthonormal over all rows that do."""
    scaled, target, _, gram = _scaled(runs)
    values, vectors = np.linalg.eigh(gram)
    turned = vectors / np.sqrt(np.maximum(values, _RIDGE))
    basis = [c @ turned for c in scaled]
    x = sum(q.T @ t for q, t in zip(basis, target, strict=True))
    return [t - q @ x for t, q in zip(target, basis, strict=True)], basis


def _scaled(runs: Sequence[Stretch]) -> tuple[list[Array], list[Array], Array, Array]:
    """Columns (K, p) of unit length and the target (K,) of every run, 0 where rows do not count; the lengths (p,); and
    the columns' products (p, p), with a ridge."""
    masked = [np.where(r.mask[:, None], r.columns, 0.0) for r in runs]
    scale = np.sqrt(np.maximum(sum(np.sum(c**2, axis=0) for c in masked), 1e-300))
    scaled = [c / scale for c in masked]
    gram = sum(c.T @ c for c in scaled) + _RIDGE * np.eye(len(scale))
    return scaled, [np.where(r.mask, r.left, 0.0) for r in runs], scale, gram


def _is_plateau(runs: Sequence[Stretch], number: int, many: int, interval: Interval, dt: float, window: float) -> bool:
    """True where the box ``interval``, column ``number`` of the last ``many``, is as flat and as steep as a push."""
    x = _fitted(runs)
    own = runs[0].columns.shape[1] - many + number
    height = float(x[own])
    gap, reach = max(round(0.5 * window / dt), 1), max(round(BESIDE / dt), 2)
    # Boundaries are known to a step: what lies within it of one says nothing.
    near = gap + max(round(STEP / dt), 1)
    smallest, largest = np.inf, 0.0
    for k, run in enumerate(runs):
        other = np.delete(np.arange(len(x)), own)
        seen = run.left - run.columns[:, other] @ x[other]
        jumps = _jumps(seen, run.mask, near, reach)
        far = np.ones(len(jumps), bool)
        if interval.run in (None, k):
            inside = _rows(run.mask, interval.start + gap, interval.stop - gap)
            if len(inside) < 3 or np.sqrt(np.mean((seen[inside] - height) ** 2)) > FLAT * abs(height):
                return False
            for edge, way in ((interval.start, 1), (interval.stop, -1)):
                if near + reach <= edge < len(jumps) - near - reach and np.isfinite(jumps[edge]):
                    smallest = min(smallest, way * np.sign(height) * float(jumps[edge]))
                far[max(edge - 2 * near - reach, 0) : edge + 2 * near + reach] = False
        largest = max(largest, float(np.nanmax(np.abs(jumps[far]), initial=0.0)))
    return smallest >= max(JUMPS * abs(height), SUDDEN * largest)


def _jumps(seen: Array, mask: NDArray[np.bool_], near: int, reach: int) -> Array:
    """By how much the average of ``reach`` rows of ``seen`` (K,) differs after a row from before, each ``near`` rows
    away from it (K + 1,); NaN where fewer than two rows count."""
    total = np.concatenate([[0.0], np.cumsum(np.where(mask, seen, 0.0))])
    count = np.concatenate([[0], np.cumsum(mask)])
    at, last = np.arange(len(seen) + 1), len(seen)

    def average(first: NDArray[np.int_], end: NDArray[np.int_]) -> Array:
        first, end = np.clip(first, 0, last), np.clip(end, 0, last)
        rows = count[end] - count[first]
        return np.where(rows >= 2, (total[end] - total[first]) / np.maximum(rows, 1), np.nan)

    return average(at + near, at + near + reach) - average(at - near - reach, at - near)


def _return(runs: Sequence[Stretch], found: Sequence[Interval], dt: float) -> bool:
    """True where one of the boxes ``found``, the last columns of ``runs``, is there again where its states are."""
    if not found:
        return False
    x, many = _fitted(runs), len(found)
    seen = [run.left - run.columns[:, :-many] @ x[:-many] for run in runs]
    for height, interval in zip(x[-many:], found, strict=True):
        for k in range(len(runs)) if interval.run is None else [interval.run]:
            inside = _rows(runs[k].mask, interval.start, interval.stop)
            pad = max(round(BESIDE / dt), 1)
            away = [r.mask.copy() for r in runs]
            away[k][max(interval.start - pad, 0) : interval.stop + pad] = False
            tree = KDTree(np.concatenate([r.states[m] for r, m in zip(runs, away, strict=True)]))
            states = runs[k].states
            distance, at = tree.query(states[inside], distance_upper_bound=ALIKE * np.sqrt(states.shape[1]))
            alike = np.isfinite(distance)
            if alike.mean() < ENOUGH:
                continue
            there = np.concatenate([own[m] for own, m in zip(seen, away, strict=True)])[np.asarray(at)[alike]]
            if np.mean(there) * np.sign(height) > RETURNS * abs(height):
                return True
    return False


def _fitted(runs: Sequence[Stretch]) -> Array:
    """Coefficients of all columns (p,)."""
    scaled, target, scale, gram = _scaled(runs)
    return np.asarray(np.linalg.solve(gram, sum(c.T @ t for c, t in zip(scaled, target, strict=True))) / scale)


def _rows(mask: NDArray[np.bool_], first: int, last: int) -> NDArray[np.int_]:
    """Rows from ``first`` to ``last`` (excluded) that are there and count."""
    rows = np.arange(max(first, 0), min(max(last, 0), len(mask)))
    return rows[mask[rows]]
