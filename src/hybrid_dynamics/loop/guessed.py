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


def without_wrong(
    found: Found,
    names: Sequence[Term],
    model: Model,
    ends_worse: Callable[[Model], NDArray[np.bool_]],
    squares: Callable[[Model], Array],
    least: float,
) -> tuple[Model, list[Term]]:
    """``model`` of ``names`` without those that ``found`` has beside them which make a joint end worse than it began,
    re-fitted; and these guesses, in the order in which they went.

    ``ends_worse`` of a model: (n,) joints that end surely worse; ``squares``: (n,) their squared errors on the test
    runs. The guess goes whose absence leaves least there, by the share ``least`` at least, as long as no other joint
    ends worse for it. None where runs disagree: nothing is estimated beside these.
    """
    gone: list[Term] = []
    while (worse := ends_worse(model)).any() and not found.inconsistent:
        own = squares(model)
        trials = []
        for guess in found.beside:
            if guess.joint is not None and not worse[guess.joint]:
                continue
            other = replace(found, beside=[t for t in found.beside if t != guess])
            bare = other.model(names, False)
            left = float(np.sum((squares(bare) / np.maximum(own, 1e-300))[worse]))
            trials.append((left, repr(guess), guess, other, bare))
        best = min(trials, key=lambda t: t[:2], default=None)
        if best is None or best[0] > (1.0 - least) * worse.sum() or np.any(ends_worse(best[-1]) & ~worse):
            break
        *_, guess, found, _ = best
        gone.append(guess)
        model = found.model(names)
    return model, gone
