"""Which reading of the log explains its torque best: gravity, signs, order of the columns, pace of the clock.

Each departure from "as it says" has a price, so that a sign is called wrong only where no direction of gravity and no
order of the joints explains the torque nearly as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment

from hybrid_dynamics.check.columns import columns_of
from hybrid_dynamics.check.completed import Completed
from hybrid_dynamics.check.forms import FLOOR, Fit, Forms
from hybrid_dynamics.check.samples import Stretch
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: Prices, in units of the natural logarithm of a joint's mean square: one sign, another order (for each column that is
#: not in its place), another mounting, another clock.
SIGN, PLACE, MOUNTING, PACE = 0.7, 0.7, 0.7, 1.0
#: A mounting within this angle [rad] of the model's is the model's (small tilts are for the loop to name).
SAME_MOUNTING = np.deg2rad(15.0)
#: What a clock may be wrong by: true speed over recorded speed.
PACES = (1e-3, 1e-2, 0.1, 10.0, 100.0, 1e3)
#: A joint speaks against another clock where it is explained by so much worse (natural logarithm of the mean square),
#: or where its links, without which it is explained by so much worse, would weigh this many times what they should, or
#: less than one over it.
AGAINST, PLAUSIBLE = 0.3, 5.0
#: Rows on which exchanged positions are tried, the share a joint must leave unexplained before they are, and from which
#: on it is not explained.
SWAP_ROWS, ASKED, UNEXPLAINED = 2000, 0.1, 0.3
#: A joint counts as explained where a guess leaves less than this share of its torque's mean square.
EXPLAINED = 0.6
#: The sign of one joint's torque is surely wrong only where the other one leaves less than this share.
SETTLED = 0.2
#: A guess changes a joint where its score (natural logarithm of the mean square left) differs by this much.
CHANGED = 0.05
#: A guess that gains this much beyond its price (natural logarithm of mean squares) is certain, less is a warning.
CERTAIN = 0.5


@dataclass(frozen=True)
class Guess:
    """``gravity`` (3,) in the base frame; per joint ``sign`` and ``source`` (which torque column is its own);
    ``swap``: two joints whose positions are exchanged; ``mirror``: the joint whose position has the wrong sign;
    ``pace``: true speed over recorded speed. ``scores`` per joint, ``total``: their sum and all prices."""

    gravity: Array
    sign: tuple[int, ...]
    source: tuple[int, ...]
    swap: tuple[int, int] | None
    mirror: int | None
    pace: float
    scores: tuple[float, ...]
    price: float

    @property
    def reads_as_told(self) -> bool:
        """Whether columns, signs and clock of the log are taken as it says; the base may stand otherwise."""
        in_place = self.source == tuple(range(len(self.source))) and min(self.sign) > 0
        return in_place and self.swap is None and self.mirror is None and self.pace == 1.0

    @property
    def all_turned(self) -> bool:
        """Whether the torques of all joints, of two at least, have the wrong sign: one convention."""
        return len(self.sign) > 1 and max(self.sign) < 0

    @property
    def total(self) -> float:
        """Score of all joints together, with the price of the guess."""
        return sum(self.scores) + self.price


def best_guess(model: Robot | Completed, parts: Sequence[Stretch], forms: Forms, gravity: Array) -> tuple[Guess, Guess]:
    """The log as it says, and the guess with the least total (the same object where nothing is better)."""
    n = forms.n
    identity = tuple(range(n))
    scores = tuple(forms.fit(j, gravity).score for j in range(n))
    told = Guess(gravity, (1,) * n, identity, None, None, 1.0, scores, 0.0)
    size = float(np.linalg.norm(gravity))
    gravities = [gravity]
    if size > 1.0:
        gravities += [g for g in forms.search_gravity(size) if angle(g, gravity) > SAME_MOUNTING]
    guesses = [told]
    for g in gravities:
        guesses += [_assigned(forms, told, g, identity), _assigned(forms, told, g, None)]
    guesses += [_paced(forms, told, pace) for pace in PACES]
    if n > 1:
        guesses.append(_turned(forms, told))
    best = min(guesses, key=lambda guess: guess.total)
    if np.exp(max(best.scores)) > ASKED and n > 1:
        best = min([best, *_rearranged(model, parts, told, best)], key=lambda guess: guess.total)
    return told, best


def left_of(score: float) -> float:
    """Share of a joint's mean square that a guess of this ``score`` leaves."""
    return max(float(np.exp(score)) - FLOOR, 0.0)


def is_certain(told: Guess, best: Guess) -> bool:
    """Whether ``best`` gains more than its price and :data:`CERTAIN`."""
    return told.total - best.total >= CERTAIN


def shares_of(told: Guess, best: Guess, joints: Sequence[int]) -> str:
    """What both leave of the worst of ``joints``, as a clause."""
    before = max(left_of(told.scores[j]) for j in joints)
    after = max(left_of(best.scores[j]) for j in joints)
    return f"unexplained {before:.0%} of the mean square as it stands, {after:.0%} so"


def angle(a: Array, b: Array) -> float:
    """Angle [rad] between two vectors."""
    cosine = float(a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-300)
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _assigned(forms: Forms, told: Guess, gravity: Array, source: tuple[int, ...] | None) -> Guess:
    """Best signs under ``gravity``; where ``source`` is None, best order of the torque columns too."""
    n = forms.n
    cost, sign = np.zeros((n, n)), np.ones((n, n), int)
    for j in range(n):
        for k in range(n) if source is None else (source[j],):
            plus, minus = forms.fit(j, gravity, k).score, forms.fit(j, gravity, k, -1).score + SIGN
            cost[j, k], sign[j, k] = min(plus, minus), 1 if plus <= minus else -1
    if source is None:
        _, chosen = linear_sum_assignment(cost + PLACE * (1 - np.eye(n)))
        source = tuple(int(k) for k in chosen)
    signs = tuple(int(sign[j, source[j]]) for j in range(n))
    flipped, moved = signs.count(-1), sum(j != k for j, k in enumerate(source))
    price = SIGN * flipped + PLACE * moved + (0.0 if gravity is told.gravity else MOUNTING)
    scores = tuple(cost[j, source[j]] - SIGN * (signs[j] < 0) for j in range(n))
    return replace(told, gravity=gravity, sign=signs, source=source, scores=scores, price=price)


def _turned(forms: Forms, told: Guess) -> Guess:
    """All torques turned round: what the joint does to the drive, as some controllers publish it. That is one
    convention and not a wrong sign for every joint; it costs what two do. Beyond any price where a joint has its sign
    right."""
    scores = tuple(forms.fit(j, told.gravity, j, -1).score for j in range(forms.n))
    pairs = zip(scores, told.scores, strict=True)
    right = any(left_of(old) < EXPLAINED and new > old + CHANGED for new, old in pairs)
    return replace(told, sign=(-1,) * forms.n, scores=scores, price=np.inf if right else 2 * SIGN)


def _paced(forms: Forms, told: Guess, pace: float) -> Guess:
    """The guess of another clock; beyond any price where a joint that needs none contradicts it, or where links of a
    plausible other inertia explain as much."""
    scores = tuple(forms.fit(j, told.gravity, pace=pace).score for j in range(forms.n))
    out = replace(told, pace=pace, scores=scores, price=PACE)
    # Inertia goes with the square of the pace.
    other = PLAUSIBLE ** (0.5 if pace > 1 else -0.5)
    alike = forms.total(told.gravity, other) < out.total + CERTAIN
    return replace(out, price=np.inf) if alike or contradicted(forms, told, pace) else out


def contradicted(forms: Forms, guess: Guess, pace: float) -> bool:
    """Whether a joint that needs no other clock, as ``guess`` reads its torque, speaks against this one.

    One clock drives all joints: a link that weighs what it should is a hundred times as heavy by a clock that is ten
    times wrong, and what else one joint lacks is no clock where another is explained worse so.
    """

    def fit(j: int, pace: float = 1.0, links: bool = True) -> Fit:
        return forms.fit(j, guess.gravity, guess.source[j], guess.sign[j], pace, links, links)

    for j in range(forms.n):
        own, other = fit(j), fit(j, pace)
        if own.left >= UNEXPLAINED:
            continue
        sane, still = (1 / PLAUSIBLE <= f.coefficients[0] <= PLAUSIBLE for f in (own, other))
        # Without what links weigh by this clock, or with what they do by the other.
        against = fit(j, links=False) if sane and not still else other
        if max(against.score, other.score) - own.score > AGAINST:
            return True
    return False


def _rearranged(model: Robot | Completed, parts: Sequence[Stretch], told: Guess, best: Guess) -> list[Guess]:
    """Guesses about positions: two joints' exchanged, or one with the wrong sign; alone or together with the torque.

    They are tried on part of the rows, and their scores put on the footing of all rows by what ``told`` has there.
    """
    few = few_rows(parts)
    plain = Forms(columns_of(model, few))
    n = plain.n
    here = [plain.fit(j, told.gravity).score for j in range(n)]

    def guess(forms: Forms, source: Sequence[int], sign: Sequence[int], price: float, **what: object) -> Guess:
        scores = [forms.fit(j, told.gravity, source[j], sign[j]).score for j in range(n)]
        level = tuple(s - h + t for s, h, t in zip(scores, here, told.scores, strict=True))
        return replace(told, source=tuple(source), sign=tuple(sign), scores=level, price=price, **what)  # type: ignore[arg-type]

    ones, identity = [1] * n, list(range(n))
    out = []
    for pair in combinations(range(n), 2):
        forms = Forms(columns_of(model, few, pair))
        both = list(identity)
        both[pair[0]], both[pair[1]] = pair[1], pair[0]
        out += [guess(forms, source, ones, 2 * PLACE, swap=pair) for source in (identity, both)]
    for j in range(n):
        forms = Forms(columns_of(model, few, mirror=j))
        turned = [-1 if k == j else 1 for k in range(n)]
        out += [guess(forms, identity, sign, 2 * SIGN, mirror=j) for sign in (ones, turned)]
    return out


def few_rows(parts: Sequence[Stretch], rows: int = SWAP_ROWS) -> list[Stretch]:
    """``parts`` thinned out to so many ``rows``, about."""
    step = max(int(np.ceil(sum(len(p.q) for p in parts) / rows)), 1)
    return [
        Stretch(p.name, p.dt * step, p.cutoff, p.q[::step], p.dq[::step], p.ddq[::step], p.tau[::step]) for p in parts
    ]
