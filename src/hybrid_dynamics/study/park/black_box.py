"""A black box on top of a model: what the motion still says about the torque, without a name.

Boosted trees (scikit-learn's histogram gradient boosting) on the states of all joints, earlier speeds and the way since
the last reversal, learned from what the model leaves on the training runs. The number of iterations is what whole
folds, held out in turn, ask for; where no iteration helps them there is no correction.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingRegressor

from hybrid_dynamics.loop.blackbox import state_features
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.types import Array

ITERATIONS = 150
#: Single runs are cut into this many stretches, several runs are held out one by one.
STRETCHES = 5


def corrections(train: Sequence[Run], left: Sequence[Array], test: Sequence[Run], seed: int = 0) -> list[Array]:
    """For every test run (K, n) [N m] to add to the model that leaves ``left`` (K, n) of the training runs."""
    out = [np.zeros_like(run.q) for run in test]
    fold = _folds(train)
    for j in range(left[0].shape[1]):
        x = np.concatenate([state_features(run, j) for run in train])
        y = np.concatenate([part[:, j] for part in left])
        count = _iterations(x, y, fold, seed)
        if count:
            trees = _trees(count, seed).fit(x, y)
            for run, part in zip(test, out, strict=True):
                part[:, j] = trees.predict(state_features(run, j))
    return out


def _trees(iterations: int, seed: int) -> HistGradientBoostingRegressor:
    return HistGradientBoostingRegressor(
        max_iter=iterations,
        learning_rate=0.08,
        max_leaf_nodes=15,
        min_samples_leaf=20,
        l2_regularization=1.0,
        early_stopping=False,
        random_state=seed,
    )


def _folds(train: Sequence[Run]) -> NDArray[np.int_]:
    if len(train) > 1:
        return np.concatenate([np.full(len(run.time), k) for k, run in enumerate(train)])
    rows = len(train[0].time)
    return np.minimum(np.arange(rows) * STRETCHES // rows, STRETCHES - 1)


def _iterations(x: Array, y: Array, fold: NDArray[np.int_], seed: int) -> int:
    """Iterations after which the held-out folds together stand best; 0 where none lowers their error."""
    loss = np.zeros(ITERATIONS)
    for f in np.unique(fold):
        mine = fold == f
        trees = _trees(ITERATIONS, seed).fit(x[~mine], y[~mine])
        loss += [float(((y[mine] - hat) ** 2).sum()) for hat in trees.staged_predict(x[mine])]
    best = int(np.argmin(loss))
    return best + 1 if loss[best] < float((y**2).sum()) else 0
