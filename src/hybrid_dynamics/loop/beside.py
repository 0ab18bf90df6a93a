"""What is estimated beside all links and not named: the constant torque of joints, which can look like weight.

In few poses the weight of links makes a constant torque as well as an offset does. Left out, all of it goes into the
links, and other poses are predicted wrongly; least squares, which fits both, shares it between them. So do we: but what
the data cannot tell from weight is no finding, and is held near zero (ridge regression: Hoerl and Kennard 1970).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_dynamics.effects import Term, family
from hybrid_dynamics.effects.base import HELD
from hybrid_dynamics.loop.floor import FEWEST_ROWS
from hybrid_dynamics.loop.trace import Judge, has_family

#: Size that such a torque is expected within, as a share of the root mean square of the joint's torque.
EXPECTED = 0.1


def beside_links(judge: Judge, chosen: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """Terms that look like weight, on the joints that move and have no such name among ``chosen``; and the judge who
    has their columns.

    None where the links of the robot are not identified together.
    """
    evidence = judge.evidence
    if not wanted(chosen):
        return judge, []
    size = np.sqrt(np.mean(np.concatenate([run.tau for run in evidence.runs]) ** 2, axis=0))
    moving = np.flatnonzero((evidence.samples >= FEWEST_ROWS) & (size > 0))
    terms = [
        Term(name, int(j), ((HELD, float(f"{EXPECTED * size[j]:.3g}")),))
        for name in judge.settings.families
        if family(name).like_weight
        for j in moving
        if not has_family(chosen, name, int(j))
    ]
    return judge.adding(terms), terms


def wanted(chosen: Sequence[Term]) -> bool:
    """True where ``chosen`` holds the links that these terms are estimated beside."""
    return any(t.family().all_links for t in chosen)
