"""Which of several ends counts, where what had gone has been asked for anew: one whose names hold beside inexact links.

A name that goes since nothing is known of it may have balanced the rest, which is searched again then (:mod:`.find`).
What is asked for in its place must hold where that did not. (Found on seven seconds of a Rokae AR5: a gain had gone,
and a curved friction, another gain and a centre of mass came, known beside exact links alone; the test run contradicted
them, and the end before had none of them.)
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.beside import links_too
from hybrid_dynamics.loop.known import least_beside_links
from hybrid_dynamics.loop.trace import Judge


@dataclass(frozen=True)
class End:
    """``names`` found among ``candidates``, what is estimated ``beside`` them, and the ``judge`` where these stand."""

    judge: Judge
    names: list[Term]
    beside: list[Term]
    candidates: list[Term]


def soundest(ends: Sequence[End], given: Collection[Term]) -> int:
    """Which of ``ends`` counts: the last; where its names are in doubt, of those before it that have names which are
    not the one by which held-out rows are predicted best (mean squares, in the mean of the joints' logarithms).

    What is ``given`` is named whatever is known of it.
    """
    last = len(ends) - 1
    if last == 0 or not in_doubt(ends[last], given):
        return last
    sound = [k for k, end in enumerate(ends[:last]) if set(end.names) - set(given) and not in_doubt(end, given)]
    return min(sound, key=lambda k: _left(ends[k]), default=last)


def in_doubt(end: End, given: Collection[Term]) -> bool:
    """True where links are off, do not stand beside the names, and of one of these nothing is known beside links that
    are off by a quarter (:func:`~.known.with_links`): it is named since held-out rows miss it."""
    if not end.names:
        return False
    there, links = links_too(end.judge, [*end.names, *end.beside], end.candidates)
    return bool(links) and least_beside_links(there, end.names, end.beside, end.candidates, given)[-1] is not None


def _left(end: End) -> float:
    held = end.judge.evidence.held([*end.names, *end.beside], physical=True)
    return float(np.log(np.maximum(end.judge.mean_square(held), 1e-300)).mean())
