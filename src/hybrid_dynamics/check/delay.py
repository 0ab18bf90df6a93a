"""How much later (or earlier) than the motion the torque was recorded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hybrid_dynamics.check.columns import Columns
from hybrid_dynamics.check.forms import explain
from hybrid_dynamics.check.samples import Stretch
from hybrid_dynamics.types import Array

#: Largest delay [s] that is looked for; shorter where the runs are short.
LONGEST = 0.6
#: Least fall of a joint's score by which it says that it is late too.
SAYS_SO = 0.05


@dataclass(frozen=True)
class Delay:
    """``seconds`` (positive: torque recorded late), how much the joints' scores fall together when it is taken back,
    and the share of joints that fall: one clock is late for all of them."""

    seconds: float
    gain: float
    agreeing: float = 0.0


def find_delay(columns: Columns, parts: Sequence[Stretch], torque: Callable[[int], tuple[Array, Array]]) -> Delay:
    """The shift under which the joints' torques are explained best.

    ``torque(j)`` gives the model's torque (K,) of joint ``j`` and the measured one that is taken for it.
    """
    dt = max(p.dt for p in parts)
    reach = min(int(LONGEST / dt), min(len(p.q) for p in parts) // 4)
    if reach < 1:
        return Delay(0.0, 0.0)
    starts = np.concatenate([[0], np.cumsum([len(p.q) for p in parts])])
    rows = np.concatenate([np.arange(a + reach, b - reach) for a, b in pairwise(starts)])
    each = np.zeros((columns.tau.shape[1], 2 * reach + 1))
    for j in range(len(each)):
        model, tau = torque(j)
        own = np.column_stack([model, columns.dq[:, j], columns.sign[:, j], columns.ddq[:, j]])[rows]
        own -= own.mean(axis=0)
        inner = own.T @ own / len(rows)
        for k in range(2 * reach + 1):
            late = tau[rows + k - reach]
            late = late - late.mean()
            cross = own.T @ late / len(rows)
            gram = np.block([[inner, cross[:, None]], [cross[None, :], np.mean(late**2)]])
            each[j, k] = explain(gram).score
    scores = each.sum(axis=0)
    best = int(np.argmin(scores))
    shift = float(best - reach)
    if 0 < best < 2 * reach:
        left, mid, right = scores[best - 1 : best + 2]
        bend = left - 2 * mid + right
        shift += 0.5 * float(left - right) / float(bend) if bend > 1e-9 else 0.0
    agreeing = float(np.mean(each[:, reach] - each[:, best] >= SAYS_SO))
    return Delay(shift * dt, float(scores[reach] - scores[best]), agreeing)
