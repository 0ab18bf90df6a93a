"""How much later (or earlier) than the motion the torque was recorded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hybrid_dynamics.check.columns import Columns
from hybrid_dynamics.check.forms import explain
from hybrid_dynamics.check.samples import Stretch
from hybrid_dynamics.effects.sign import presliding_sign
from hybrid_dynamics.types import Array

#: Largest delay [s] that is looked for; shorter where the runs are short.
LONGEST = 0.6
#: Least fall of a joint's score by which it says that it is late too.
SAYS_SO = 0.05
#: Least gain of a delay (sum of the joints' log mean squares).
LEAST_GAIN = 0.7
#: Presliding displacements [rad] of dry friction that each joint may have, from a sharp sign to beyond any gear's:
#: in slow motion friction that turns over with the distance is late against the speed, and so is no clock.
PRESLIDING = (1e-9, 0.0003, 0.001, 0.003, 0.01, 0.03)
#: What a joint that slides moves [m] where one that turns moves 1 rad.
LEVER = 0.05
#: Two halves of a log say the same where their delays differ by less than this share of it, or by this many rows.
SAME_SHARE, SAME_ROWS = 0.25, 2.0


@dataclass(frozen=True)
class Delay:
    """``seconds`` (positive: torque recorded late), how much the joints' scores fall together when it is taken back,
    the share of joints that fall (one clock is late for all of them), and whether both halves of the log show it: a
    clock is late all the time, while a slow motion resembles itself a little earlier or later somewhere by chance.
    Of a torque that is late ``gain`` is what it gains beside friction that turns over with the distance, if less."""

    seconds: float
    gain: float
    agreeing: float = 0.0
    lasting: bool = True


def find_delay(
    columns: Columns,
    parts: Sequence[Stretch],
    torque: Callable[[int], tuple[Array, Array]],
    sliding: Sequence[int] = (),
) -> Delay:
    """The shift under which the joints' torques are explained best.

    ``torque(j)`` gives the model's torque (K,) of joint ``j`` and the measured one that is taken for it; joints that
    are ``sliding`` (0-based) move in metres.
    """
    dt = max(p.dt for p in parts)
    reach = min(int(LONGEST / dt), min(len(p.q) for p in parts) // 4)
    if reach < 1:
        return Delay(0.0, 0.0)
    starts = np.concatenate([[0], np.cumsum([len(p.q) for p in parts])])
    rows = np.concatenate([np.arange(a + reach, b - reach) for a, b in pairwise(starts)])
    pairs = [torque(j) for j in range(columns.tau.shape[1])]
    taken = [tau for _, tau in pairs]
    own = [
        np.column_stack([model, columns.dq[:, j], columns.sign[:, j], columns.ddq[:, j]])
        for j, (model, _) in enumerate(pairs)
    ]
    each = _scores(own, taken, rows, reach)
    scores = each.sum(axis=0)
    best = int(np.argmin(scores))
    rest = _lowest(scores)
    gain = float(scores[reach] - scores[best])
    if best > reach and gain >= LEAST_GAIN:
        slipping = [
            np.column_stack([known, _slipping(parts, j, LEVER if j in sliding else 1.0)]) for j, known in enumerate(own)
        ]
        beside = _scores(slipping, taken, rows, reach).sum(axis=0)
        gain = min(gain, float(beside[reach] - beside.min()))
    halves = [_lowest(_scores(own, taken, half, reach).sum(axis=0)) for half in np.array_split(rows, 2)]
    near = max(SAME_SHARE * abs(rest - reach), SAME_ROWS)
    return Delay(
        (rest - reach) * dt,
        gain,
        float(np.mean(each[:, reach] - each[:, best] >= SAYS_SO)),
        all(abs(half - rest) <= near for half in halves),
    )


def _slipping(parts: Sequence[Stretch], j: int, lever: float) -> Array:
    """(K, m) dry friction of joint ``j`` that turns over within each of :data:`PRESLIDING`, of height 1."""
    return np.column_stack([np.concatenate([presliding_sign(p.q[:, j], lever * s) for p in parts]) for s in PRESLIDING])


def _scores(own: Sequence[Array], taken: Sequence[Array], rows: Array, reach: int) -> Array:
    """(n, 2 reach + 1) score of each joint over ``rows`` with its torque taken from that many rows off."""
    each = np.zeros((len(own), 2 * reach + 1))
    for j, tau in enumerate(taken):
        table = own[j][rows] - own[j][rows].mean(axis=0)
        inner = table.T @ table / len(rows)
        for k in range(2 * reach + 1):
            late = tau[rows + k - reach]
            late = late - late.mean()
            cross = table.T @ late / len(rows)
            gram = np.block([[inner, cross[:, None]], [cross[None, :], np.mean(late**2)]])
            each[j, k] = explain(gram).score
    return each


def _lowest(scores: Array) -> float:
    """Where ``scores`` are least, between its samples."""
    best = int(np.argmin(scores))
    if not 0 < best < len(scores) - 1:
        return float(best)
    left, mid, right = scores[best - 1 : best + 2]
    bend = left - 2 * mid + right
    return best + (0.5 * float(left - right) / float(bend) if bend > 1e-9 else 0.0)
