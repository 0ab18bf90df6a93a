"""What the test runs say of what is estimated beside the names: a guess by which a joint ends worse than it began goes.

Of a guess nobody was sure. It carries the training runs over to motions that are like them; where the test runs show
that it does not, the bare description is the better guess. (Found on a collaborative arm that the project had not
seen: beside 8 s in which a wrist turned one way an offset of 12 N m was estimated, and the wrist of another run asked
for two.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.found import Found
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.types import Array

#: By so much the joints that end worse must be left with less without a guess (mean squares, in the logarithm).
LESS = 0.01
#: Squares [N m]^2 below which nothing is left.
TINY = 1e-300


def without_wrong(
    found: Found,
    names: Sequence[Term],
    model: Model,
    ends_worse: Callable[[Model], NDArray[np.bool_]],
    squares: Callable[[Model], Array],
) -> tuple[Model, list[tuple[Term, tuple[int, ...]]]]:
    """``model`` of ``names`` without those that ``found`` has beside them which make a joint end worse than it began,
    re-fitted; and these guesses with the joints that ended worse, in the order in which they went.

    ``ends_worse`` of a model: (n,) joints that end surely worse; ``squares``: (n,) their squared errors on the test
    runs. The guess goes without which these joints are left with less and all joints together with least, in the mean
    of the logarithms: links that help one joint much stay though they harm another. It stays where another joint would
    end worse. None where runs disagree: nothing is estimated beside these.
    """
    gone: list[tuple[Term, tuple[int, ...]]] = []
    while (worse := ends_worse(model)).any() and not found.inconsistent:
        own = squares(model)
        trials = []
        for guess in found.beside:
            if guess.joint is None or worse[guess.joint]:
                other = replace(found, beside=[t for t in found.beside if t != guess])
                bare = other.model(names, False)
                # A joint of which nothing moves, or nothing is left, says nothing.
                change = np.log(np.maximum(squares(bare), TINY) / np.maximum(own, TINY))
                helps = change[worse].mean() < -LESS and change.mean() < 0
                if helps and not np.any(ends_worse(bare) & ~worse):
                    trials.append((float(change.mean()), repr(guess), guess, other))
        if not trials:
            break
        *_, guess, found = min(trials, key=lambda t: t[:2])
        gone.append((guess, tuple(int(j) for j in np.flatnonzero(worse))))
        model = found.model(names)
    return model, gone
