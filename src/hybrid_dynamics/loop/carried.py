"""Whether the test runs are left as small as the training runs: an all-clear that unseen runs deny is none.

What a black box can learn needs as many samples as any law. A law that is a little wrong fits the training runs and
parts from the others where they go elsewhere; there its error says so without a law of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from hybrid_dynamics.loop.blocks import block_starts
from hybrid_dynamics.loop.floor import FEWEST_ROWS, difference_floor
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.loop.trace import block_error
from hybrid_dynamics.types import Array

Mask = NDArray[np.bool_]
#: A run, what is left of its torque (K, n) [N m], and the rows that count (K, n).
Left = tuple[Run, Array, Mask]

#: What the test runs leave may be so many times (rms) what the training runs leave: noise of the motion grows with it.
CARRIED = 1.35


@dataclass(frozen=True)
class Carried:
    """Per joint (n,): how many ``times`` (rms) as much the test runs leave as the training runs; ``worse``: surely more
    than :data:`CARRIED` times."""

    times: Array
    worse: Mask


def carried_over(train: Sequence[Left], test: Sequence[Left], rounded_away: Array, settings: LoopSettings) -> Carried:
    """What the ``test`` runs leave beside what the ``train`` runs leave.

    Whether it is surely more is asked of the scatter between parts of the training runs. A test run whose noise, by
    second differences, is larger than that of the training runs may leave as much more; what is no larger than
    ``rounded_away`` (n,) [N m] may be the steps of the torque alone.
    """
    (noise, before), (noise_after, after) = _noise_and_left(train), _noise_and_left(test)
    grown = np.maximum(noise_after / np.where(noise > 0, noise, np.inf), 1.0)
    expected = before * grown
    rows = [np.sum([keep.sum(axis=0) for _, _, keep in part], axis=0) for part in (train, test)]
    out = np.zeros(len(before), bool)
    for j in np.flatnonzero((before > 0) & (after > np.maximum(CARRIED * expected, rounded_away))):
        error, blocks = _scatter(train, int(j), float(before[j]) ** 2, settings.block)
        # As if the test runs were more of the same: a slow misfit of them would drown in its own scatter.
        spread = grown[j] ** 2 * error * np.sqrt(1.0 / rows[1][j] + 1.0 / rows[0][j]) / np.sqrt(rows[0][j])
        level = float(student.ppf(1.0 - settings.confirmation / len(before), max(blocks - 1, 1)))
        out[j] = after[j] ** 2 - (CARRIED * expected[j]) ** 2 > level * spread
    return Carried(np.where(expected > 0, after / np.where(expected > 0, expected, 1.0), 0.0), out)


def _scatter(parts: Sequence[Left], joint: int, mean: float, block: float) -> tuple[float, int]:
    """Standard error of the summed squares [N m]^2 of what is left of ``joint``, of known ``mean`` square, and its
    clusters."""
    sums, owner = [], []
    for r, (run, left, keep) in enumerate(parts):
        excess = np.where(keep[:, joint], left[:, joint] ** 2 - mean, 0.0)
        sums.append(np.add.reduceat(excess, block_starts(run.time, block)))
        owner.append(np.full(len(sums[-1]), r))
    return block_error(np.concatenate(sums), np.concatenate(owner))


def _noise_and_left(parts: Sequence[Left]) -> tuple[Array, Array]:
    """Noise (n,) [N m] by second differences, and rms (n,) [N m] of what is left; 0 where too few rows count."""
    runs, left, mask = zip(*parts, strict=True)
    count, rms = rows_and_rms(parts)
    return difference_floor(runs, left, mask), np.where(count >= FEWEST_ROWS, rms, 0.0)


def rows_and_rms(parts: Sequence[Left]) -> tuple[Array, Array]:
    """How many rows count (n,), and rms (n,) [N m] of what is left on them; 0 where none does."""
    count = np.sum([keep.sum(axis=0) for _, _, keep in parts], axis=0)
    square = np.sum([np.sum(left**2 * keep, axis=0) for _, left, keep in parts], axis=0)
    return count, np.asarray(np.sqrt(square / np.maximum(count, 1)))
