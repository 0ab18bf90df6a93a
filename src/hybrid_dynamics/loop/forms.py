"""Laws whose tangents are the same, told apart by the laws themselves: a delay, or a drive's low-pass."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import butter, sosfiltfilt

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.trace import Judge, block_error
from hybrid_dynamics.types import Array

#: Gauss-Newton steps of a comparison: each law is to be judged where it fits best.
_ROUNDS = 6
#: Below this frequency [Hz] laws are compared: a low-pass takes away noise of the motion as well, above all beyond it.
BAND = 3.0


def choose_forms(judge: Judge, chosen: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``chosen`` with a law in another form where that leaves surely less of the training runs; and the judge there."""
    out = list(chosen)
    for i, term in enumerate(out):
        for form in term.family().forms(term):
            trial = [*out[:i], form, *out[i + 1 :]]
            if form != out[i] and _surely_less(judge, _left(judge, trial), _left(judge, out)):
                out = trial
    return judge.adding(out).at(out), out


def forms_as_good(judge: Judge, terms: Sequence[Term], term: Term) -> list[Term]:
    """Other forms of ``term`` that do not leave surely more of the training runs."""
    others = [form for form in term.family().forms(term) if form != term]
    if not others:
        return []
    own = _left(judge, terms)
    return [f for f in others if not _surely_less(judge, own, _left(judge, [f if t == term else t for t in terms]))]


def _surely_less(judge: Judge, less: Array, more: Array) -> bool:
    """Whether ``less`` (blocks,) sums up to less than ``more`` beyond the scatter over blocks."""
    difference = more - less
    error, blocks = block_error(difference - difference.mean(), judge.evidence.blocks.run)
    return bool(float(difference.sum()) > judge.level(1, blocks) * error)


def _left(judge: Judge, terms: Sequence[Term]) -> Array:
    """(blocks,) weighted squares of what ``terms``, every law as it is, leave below :data:`BAND`."""
    fitted = refit(judge.evidence.adding(terms), terms, rounds=_ROUNDS)
    evidence, squares = fitted.evidence, []
    for run, mask, left in zip(evidence.runs, evidence.mask, evidence.residuals(terms, fitted.x), strict=True):
        rate = 1.0 / float(np.median(np.diff(run.time)))
        slow = sosfiltfilt(butter(2, min(BAND, 0.4 * rate), fs=rate, output="sos"), np.where(mask, left, 0.0), axis=0)
        squares.append(np.where(mask, slow, 0.0) ** 2 @ evidence.weights)
    blocks = zip(evidence.blocks.run, evidence.blocks.rows, strict=True)
    return np.array([squares[r][low:high].sum() for r, (low, high) in blocks])
