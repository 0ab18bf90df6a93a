"""A black box on top of the model: how much of what is left depends on the motion, whatever the law.

Boosted trees (Friedman 2001; scikit-learn's histogram form) learn the residual of one joint from the states of all
joints, their speeds a little earlier and the distance since the last reversal; they are trained on other folds than the
one they predict, and stop where held-out samples no longer gain. What they still remove is learnable; what they leave
is an upper end of the noise.

Whether the held-out prediction has anything to do with the residual is decided by shifting the residual in time within
its run: under the null hypothesis that it does not depend on the motion, the true alignment is one among many (a shift
test keeps the autocorrelation of both). Colour alone therefore raises no alarm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from hybrid_dynamics.loop.binned import binned_prediction, over_all
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.warming import linear_prediction
from hybrid_dynamics.types import Array

if TYPE_CHECKING:
    from sklearn.ensemble import HistGradientBoostingRegressor


#: Fewer samples train nothing.
FEWEST_SAMPLES = 50
#: Rows that one fit sees at most, leaves of a tree; iterations, and how far each goes: twice as many at half the pace
#: take twice the time and learn no more.
MOST_ROWS, LEAVES = 6000, 15
ITERATIONS, PACE = 75, 0.16
#: Values of an input that the trees tell apart: about a hundred rows each. scikit-learn's 255 take twice the time and
#: predict no better.
BINS = 64
#: Iterations without a better loss on held-out samples after which no better one is expected.
PATIENCE = 15
#: Shifts of the residual that the true alignment is compared with.
SHIFTS = 1999
#: Shifts under which the prediction still resembles itself (periodic motions) are no null hypothesis.
RESEMBLANCE = 0.3
#: Earlier speeds that the black box sees, in windows of the filter.
LAGS = (1.5, 6.0)


@dataclass(frozen=True)
class Learnable:
    """``prediction`` per run (K,) [N m] of what is left; ``share`` of the mean square that it removes on held-out
    samples (0 where none); ``p_value`` of no dependence on the motion; ``most``: the largest share that any of the
    predictors asked removes, sure or not."""

    prediction: tuple[Array, ...]
    share: float
    p_value: float
    most: float = 0.0


def state_features(run: Run, joint: int) -> Array:
    """Inputs (K, p): states of all joints, earlier speeds and the distance since the last reversal of ``joint``."""
    step = float(np.median(np.diff(run.time)))
    parts = [run.q, run.dq, run.ddq]
    for windows in LAGS:
        lag = max(round(windows / run.cutoff / step), 1)
        parts.append(np.vstack([np.repeat(run.dq[:1, [joint]], min(lag, len(run.dq)), axis=0), run.dq[:-lag, [joint]]]))
    parts.append(since_reversal(run.q[:, joint])[:, None])
    return np.hstack(parts)


def since_reversal(q: Array) -> Array:
    """Distance (K,) [rad] travelled since the direction last changed, signed by the direction."""
    step = np.diff(q, prepend=q[:1])
    way = np.sign(step)
    moved = np.flatnonzero(way)
    if len(moved) == 0:
        return np.zeros(len(q))
    way = way[np.maximum.accumulate(np.where(way != 0, np.arange(len(way)), moved[0]))]
    turn = np.flatnonzero(np.diff(way, prepend=way[:1]))
    path = np.cumsum(np.abs(step))
    start = np.zeros(len(q))
    start[turn] = path[turn - 1] if len(turn) else 0.0
    return np.asarray(way * (path - np.maximum.accumulate(start)))


def learnable(
    features: Sequence[Array],
    curves: Sequence[list[tuple[Array, NDArray[np.int_]]]],
    residual: Sequence[Array],
    counted: Sequence[NDArray[np.bool_]],
    fold: Sequence[NDArray[np.int_]],
    warming: Sequence[Array] = (),
    seed: int = 0,
) -> Learnable:
    """What a black box still learns: trees on the states, a curve over one variable (:mod:`.binned`), or friction that
    changes while a run lasts (:mod:`.warming`).

    Per run: ``features`` (K, p), ``curves`` its variables, ``residual`` (K,) [N m], rows that count (K,), fold of every
    row (K,), columns ``warming`` (K, p); a fold of -1 is used by nobody. The smallest p-value counts, times the number
    of predictors asked (Bonferroni), with the share that this predictor removes.
    """
    y, keep, folds = np.concatenate(residual), np.concatenate(counted), np.concatenate(fold)
    predictions = [_trees(np.vstack(features), y, keep, folds, seed)]
    for which in range(len(curves[0])):
        predictions.append(binned_prediction(*over_all(curves, which), y, keep, folds))
    if warming:
        predictions.append(linear_prediction(np.vstack(warming), y, keep, folds))
    found = [_worth(p, y, residual, counted, seed) for p in predictions]
    best = min(found, key=lambda f: (f.p_value, -f.share))
    return replace(best, p_value=min(best.p_value * len(found), 1.0), most=max(f.share for f in found))


def _trees(x: Array, y: Array, keep: NDArray[np.bool_], folds: NDArray[np.int_], seed: int) -> Array:
    """Prediction (N,) of every fold by trees that have seen the others."""
    out = np.zeros(len(y))
    for f in np.unique(folds[folds >= 0]):
        mine = folds == f
        train = np.flatnonzero(keep & ~mine & (folds >= 0))
        if len(train) >= FEWEST_SAMPLES and (keep & mine).any():
            out[mine] = _fit(x[train], y[train], folds[train], seed).predict(x[mine])
    return out


def _worth(
    out: Array, y: Array, residual: Sequence[Array], counted: Sequence[NDArray[np.bool_]], seed: int
) -> Learnable:
    """What the held-out prediction ``out`` (N,) of ``y`` (N,) is worth."""
    keep = np.concatenate(counted)
    parts = np.split(out, np.cumsum([len(r) for r in residual])[:-1])
    before = float(np.sum(y[keep] ** 2))
    # How far the prediction is to be believed is itself learned: one factor, on the same held-out samples.
    product, size = float(np.sum(out[keep] * y[keep])), float(np.sum(out[keep] ** 2))
    factor = min(max(product / size, 0.0), 1.0) if size > 0 else 0.0
    share = 1.0 - float(np.sum((y - factor * out)[keep] ** 2)) / before if before > 0 else 0.0
    p = shift_test(parts, residual, counted, seed)
    return Learnable(tuple(factor * part for part in parts), max(share, 0.0), p)


def _fit(x: Array, y: Array, fold: NDArray[np.int_], seed: int) -> HistGradientBoostingRegressor:
    """Trees with the number of iterations that the last of the training folds wants, re-fitted on all of them."""
    from sklearn.ensemble import HistGradientBoostingRegressor  # a second to import

    thin = np.linspace(0, len(y) - 1, min(len(y), MOST_ROWS)).astype(int)
    x, y, fold = x[thin], y[thin], fold[thin]
    names = np.unique(fold)
    shape = {"max_leaf_nodes": LEAVES, "min_samples_leaf": 20, "max_bins": BINS, "random_state": seed}
    pace = {"learning_rate": PACE, "l2_regularization": 1.0}
    best = ITERATIONS
    if len(names) > 1:
        inside = fold != names[seed % len(names)]
        if inside.sum() >= FEWEST_SAMPLES and (~inside).sum() >= 20:
            # Where nothing can be learned the loss only grows: a trial of all iterations would be most of the time.
            trial = HistGradientBoostingRegressor(
                max_iter=ITERATIONS,
                early_stopping=True,
                scoring="loss",
                n_iter_no_change=PATIENCE,
                tol=0.0,
                **shape,
                **pace,
            ).fit(x[inside], y[inside], X_val=x[~inside], y_val=y[~inside])
            best = int(np.argmax(trial.validation_score_[1:])) + 1  # the first one is that of no tree
    return HistGradientBoostingRegressor(max_iter=best, early_stopping=False, **shape, **pace).fit(x, y)


def shift_test(
    prediction: Sequence[Array], residual: Sequence[Array], counted: Sequence[NDArray[np.bool_]], seed: int = 0
) -> float:
    """p-value of the covariance of ``prediction`` and ``residual`` (K,) per run, against shifts in time.

    All circular shifts come from one Fourier transform a run; one shift a run is drawn :data:`SHIFTS` times. With so
    many joints to correct for, the tail beyond the largest shift is read from the normal law of the shifts. Rows that
    do not count are closed up first: standing in place as zeros they would meet counted ones under every shift but
    the true one, which would look too good. The law is that of mean zero: all shifts of a run sum to nothing, so a
    large true one would lower the others' mean.
    """
    rng = np.random.default_rng(seed)
    true, drawn = 0.0, np.zeros(SHIFTS)
    for p, r, keep in zip(prediction, residual, counted, strict=True):
        if keep.sum() < 20:
            continue
        a, b = p[keep] - p[keep].mean(), r[keep] - r[keep].mean()
        length = len(a)
        spectrum = np.fft.rfft(a)
        covariance = np.fft.irfft(spectrum * np.conj(np.fft.rfft(b)), length)
        own = np.fft.irfft(np.abs(spectrum) ** 2, length)
        free = np.flatnonzero(np.abs(own) < RESEMBLANCE * max(own[0], 1e-300))
        true += float(covariance[0])
        if len(free) < 20:
            # The prediction resembles itself at every shift: a trend, which one run cannot tell from slow noise.
            return 1.0
        drawn += covariance[rng.choice(free, SHIFTS)]
    spread = float(np.sqrt(np.mean(drawn**2)))
    if spread <= 0:
        return 1.0
    counted_p = (1.0 + float(np.sum(drawn >= true))) / (SHIFTS + 1.0)
    tail = float(norm.sf(true / spread))
    return max(tail, 1e-12) if counted_p <= 2.0 / (SHIFTS + 1.0) else max(counted_p, tail)


def holm(p_values: Array, level: float) -> NDArray[np.bool_]:
    """Which hypotheses are refused at ``level`` over all (Holm 1979)."""
    order = np.argsort(p_values)
    refused = np.zeros(len(p_values), bool)
    for k, i in enumerate(order):
        if p_values[i] > level / (len(p_values) - k):
            break
        refused[i] = True
    return refused
