"""Two predictions of the same held-out runs: which is better, and is that more than chance?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from hybrid_dynamics.loop.trace import PRACTICAL, difference_error
from hybrid_dynamics.types import Array

BETTER, AS_GOOD, WORSE = "better", "as_good", "worse"


@dataclass(frozen=True)
class Comparison:
    """``relative``: mean square error of the one less that of the other, as a share of the other's (negative: the one
    is better); ``error``: its standard error; ``verdict`` on the one: :data:`BETTER`, :data:`AS_GOOD`, :data:`WORSE`.
    """

    relative: float
    error: float
    verdict: str


def compare(
    one: Sequence[Array], other: Sequence[Array], times: Sequence[Array], block: float, chance: float
) -> tuple[list[Comparison], Comparison]:
    """Compare residuals (K, n) [N m] of ``one`` and ``other`` per run, ``times`` (K,) [s]: per joint, and all together.

    The difference of the sums of squares is d (d + 2 e): d what one predicts more than the other, e the residual of
    whichever is better. Given the motion and the fits only d e is random (Bester, Conley and Hansen 2011); its sums
    over blocks of ``block`` [s] are clusters, merged while they remember each other. A verdict other than
    :data:`AS_GOOD` comes about by chance with probability ``chance`` to either side.
    """
    n = one[0].shape[1]
    joints = [_compare([e[:, [j]] for e in one], [e[:, [j]] for e in other], times, block, chance) for j in range(n)]
    return joints, _compare(one, other, times, block, chance)


def _compare(
    one: Sequence[Array], other: Sequence[Array], times: Sequence[Array], block: float, chance: float
) -> Comparison:
    squares = [sum(float(np.sum(e**2)) for e in part) for part in (one, other)]
    spread, blocks = difference_error(one, other, times, block, np.ones(one[0].shape[1]))
    size = max(squares[1], 1e-300)
    relative, error = (squares[0] - squares[1]) / size, spread / size
    sure = abs(relative) > max(float(student.ppf(1.0 - chance, max(blocks - 1, 1))) * error, PRACTICAL)
    return Comparison(relative, error, (WORSE if relative > 0 else BETTER) if sure else AS_GOOD)
