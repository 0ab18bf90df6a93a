"""What is noise, as an interval, and whether what is left depends on the motion. No list of known laws decides that.

``low``: second differences just beyond the filter's window (Gasser, Sroka and Jennen-Steinmetz, Biometrika 73(3),
1986): true for white noise even under a law of several floors, too low for coloured noise. ``high``: what a black box
leaves (:mod:`~hybrid_dynamics.loop.blackbox`). The alarm: the black box's held-out prediction has to do with what is
left, more than with what is left at another time, and removes a share of it that matters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.loop.binned import curves_of
from hybrid_dynamics.loop.blackbox import holm, learnable, state_features
from hybrid_dynamics.loop.blocks import parts_of, turns_of
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.loop.warming import friction_in_time
from hybrid_dynamics.types import Array

Mask = NDArray[np.bool_]

#: A residual that is noise has forgotten itself after this many windows of the filter.
FORGOTTEN = 2.5
#: Autocorrelation beyond which a residual without an alarm is no noise that this library knows.
STRANGE = 0.7
#: Beyond this a residual is coloured; noise that is coloured is no more than twice its second differences.
REMEMBERS, TWICE = 0.3, 2.0
#: Share of what is left that a black box removes on held-out rows, beyond which that it may be chance is no all-clear.
#: Of 2,700 joints of simulated arms whose model was whole none had half of it.
UNPROVEN = 0.1
#: Share of states outside those of the other folds beyond which parts of one run say nothing about each other.
UNSHARED = 0.5
#: Fewer moving rows and a joint says nothing.
FEWEST_ROWS = 20
#: Folds of the black box at most; runs share folds where there are more.
MOST_FOLDS = 5


@dataclass(frozen=True)
class Floor:
    """Per joint (n,): noise ``value`` between ``low`` and ``high`` [N m]; ``learnable_share`` of what is left that a
    black box trained on other runs removes; ``p_value`` of no dependence on the motion; ``motion_dependent``, the
    alarm; ``cannot_tell`` where neither alarm nor all-clear can be given; ``autocorrelation`` beyond the filter's
    window. ``seen``: joints that move; all else is 0 there. ``unproven``: of what is left the share that a black box
    removes on held-out rows, where that is much and may be chance; else 0."""

    value: Array
    low: Array
    high: Array
    learnable_share: Array
    p_value: Array
    motion_dependent: Mask
    cannot_tell: Mask
    autocorrelation: Array
    seen: Mask
    unproven: Array


def difference_floor(runs: Sequence[Run], residual: Sequence[Array], mask: Sequence[Mask]) -> Array:
    """Noise (n,) [N m] from second differences of ``residual`` (K, n) over the filter's window; 0: too few rows."""
    squares, count = 0.0, 0.0
    for run, left, keep in zip(runs, residual, mask, strict=True):
        lag = window_rows(run, 1.0) + 1
        if len(left) <= 2 * lag:
            continue
        difference = left[lag:-lag] - 0.5 * (left[: -2 * lag] + left[2 * lag :])
        counted = keep[lag:-lag] & keep[: -2 * lag] & keep[2 * lag :]
        squares = squares + np.sum(difference**2 * counted, axis=0)
        count = count + counted.sum(axis=0)
    if np.ndim(count) == 0:
        return np.zeros(runs[0].tau.shape[1])
    total = np.asarray(count, float)
    return np.asarray(np.where(total >= FEWEST_ROWS, np.sqrt(squares / 1.5 / np.maximum(total, 1.0)), 0.0))


def window_rows(run: Run, windows: float) -> int:
    """Rows that ``windows`` of the filter last."""
    step = float(np.median(np.diff(run.time)))
    return max(int(np.ceil(windows / run.cutoff / step)), 1)


def autocorrelation(runs: Sequence[Run], residual: Sequence[Array], mask: Sequence[Mask]) -> Array:
    """Autocorrelation (n,) of ``residual`` (K, n) after :data:`FORGOTTEN` windows of the filter."""
    product, size = 0.0, 0.0
    for run, left, keep in zip(runs, residual, mask, strict=True):
        lag = window_rows(run, FORGOTTEN)
        if len(left) <= lag:
            continue
        both = keep[lag:] & keep[:-lag]
        product = product + np.sum(left[lag:] * left[:-lag] * both, axis=0)
        size = size + np.sum(0.5 * (left[lag:] ** 2 + left[:-lag] ** 2) * both, axis=0)
    if np.ndim(size) == 0:
        return np.zeros(runs[0].tau.shape[1])
    return np.asarray(np.where(size > 0, product / np.where(size > 0, size, 1.0), 0.0))


def examine(
    runs: Sequence[Run],
    residual: Sequence[Array],
    mask: Sequence[Mask],
    resolution: Array,
    rounded_away: Array,
    settings: LoopSettings,
) -> Floor:
    """The floor of every joint from what a model leaves, ``residual`` (K, n) [N m] per run over rows ``mask`` (K, n).

    Single runs are cut into ``settings.time_folds`` parts. ``resolution`` (n,) [N m]: smaller differences are nothing.
    What is no larger than ``rounded_away`` (n,) [N m] may be the steps of the torque alone: it is not asked of.
    """
    n = residual[0].shape[1]
    count = np.sum([m.sum(axis=0) for m in mask], axis=0)
    seen = count >= FEWEST_ROWS
    square = np.sum([np.sum(r**2 * m, axis=0) for r, m in zip(residual, mask, strict=True)], axis=0)
    rms = np.sqrt(square / np.maximum(count, 1))
    low = np.minimum(difference_floor(runs, residual, mask), rms)
    colour = autocorrelation(runs, residual, mask)
    folds = _folds(runs, settings.time_folds)
    share, p, most, strange = np.zeros(n), np.ones(n), np.zeros(n), np.zeros(n, bool)
    longest = max(float(run.time[-1] - run.began) for run in runs)
    for j in np.flatnonzero(seen & (rms > np.maximum(resolution, rounded_away))):
        features = [state_features(run, int(j)) for run in runs]
        curves = [curves_of(run, int(j)) for run in runs]
        warming = [friction_in_time(run, int(j), longest) for run in runs]
        found = learnable(features, curves, [r[:, j] for r in residual], [m[:, j] for m in mask], folds, warming)
        share[j], p[j], most[j] = found.share, found.p_value, found.most
        remembers = colour[j] > REMEMBERS and (
            rms[j] > TWICE * low[j] or _unshared(runs, mask, folds, int(j)) > UNSHARED
        )
        strange[j] = colour[j] > STRANGE or remembers
    alarm = holm(p, settings.alarm_level) & (share > settings.alarm_share)
    unproven = ~alarm & (most > max(UNPROVEN, settings.alarm_share))
    # One standard deviation of the estimate on top: rows that remember each other count less.
    effective = np.maximum(count * (1 - colour.clip(0, 0.99)) / (1 + colour.clip(0, 0.99)) / 4, 4)
    high = rms * np.sqrt(1.0 - share.clip(0, 1)) * (1 + 1 / np.sqrt(effective))
    high = np.maximum(np.where(alarm, high, np.maximum(high, rms)), low)
    value = np.where(alarm, np.minimum(high, rms), rms)
    tiny = np.where(seen, np.minimum(resolution, np.inf), 0.0)
    value, low, high = (np.where(seen, np.maximum(v, tiny), 0.0) for v in (value, low, high))
    doubtful = (strange & ~alarm) | unproven
    return Floor(value, low, high, share, p, alarm, doubtful, colour, seen, np.where(unproven, most, 0.0))


def _folds(runs: Sequence[Run], time_folds: int) -> list[NDArray[np.int_]]:
    """Fold of every row: whole runs where there are enough, else parts of them with a gap (-1) between."""
    parts = max(round(time_folds / len(runs)), 1)
    out = []
    for r, run in enumerate(runs):
        part = _parts(run, parts)
        fold = (r * parts + part) % max(MOST_FOLDS, parts)
        gap = window_rows(run, FORGOTTEN)
        for e in np.flatnonzero(np.diff(part)):
            fold[max(e - gap + 1, 0) : e + gap + 1] = -1
        out.append(fold)
    return out


def _parts(run: Run, number: int) -> NDArray[np.int_]:
    """Part of every row: of the time, or of each joint's motion where joints move in turn, two then: gaps are many."""
    if turns_of(run.mask, number) == 1:
        return np.arange(len(run.time)) * number // len(run.time)
    pieces = max(int(np.ptp(run.time) * run.cutoff), 2)
    edges = np.linspace(0, len(run.time), pieces + 1).round().astype(int)
    return np.repeat(parts_of(run.mask, edges, min(number, 2)), np.diff(edges))


def _unshared(runs: Sequence[Run], mask: Sequence[Mask], folds: Sequence[NDArray[np.int_]], joint: int) -> float:
    """Share of rows whose position or speed lies outside that of the other folds."""
    outside = total = 0
    for run, keep, fold in zip(runs, mask, folds, strict=True):
        state = np.column_stack([run.q[:, joint], run.dq[:, joint]])
        for f in np.unique(fold[fold >= 0]):
            own, other = keep[:, joint] & (fold == f), keep[:, joint] & (fold != f) & (fold >= 0)
            if not own.any() or not other.any():
                continue
            low, high = state[other].min(axis=0), state[other].max(axis=0)
            outside += int(np.any((state[own] < low) | (state[own] > high), axis=1).sum())
            total += int(own.sum())
    return outside / total if total else 1.0
