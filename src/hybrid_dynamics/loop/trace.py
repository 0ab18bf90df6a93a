"""From what the model leaves to the next named cause: candidates compete on held-out runs.

One step ranks all candidate terms by the held-out error of a joint re-fit of the model with that term. Among those
within one standard error of the best, or worse by nothing that matters, the simplest wins (Breiman et al. 1984); it is
accepted when its gain is certain and large enough to matter.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.base import ONLY_RUN
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.blocks import block_starts
from hybrid_dynamics.loop.contact import Contact
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.floor import FEWEST_ROWS
from hybrid_dynamics.loop.held import Held
from hybrid_dynamics.loop.layout import term_order
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.types import Array


@dataclass(frozen=True)
class Candidate:
    """One row of the evidence table. ``score``: held-out squared error in squared noise floors, per sample.

    ``gain`` and its standard error ``gain_error`` in the same unit; ``joint_gain`` (n,) [N m]^2 per joint.
    """

    term: Term
    score: float
    gain: float
    gain_error: float
    joint_gain: tuple[float, ...]
    accepted: bool
    reason: str


#: A smaller share of the mean square error is no difference in practice, however sure it is.
PRACTICAL = 0.01
#: Fewer clusters than this say nothing about an uncertainty.
FEWEST_CLUSTERS = 10
#: Rows of the evidence table that are judged and kept.
TABLE_ROWS = 12
#: Share of what is left that an effect of the further families must take to come in, and to stay beside all others.
NIBBLE, NIBBLE_KEPT = 0.25, 0.15
#: A simpler model may be worse on no joint by more than this share of its mean square, however uncertain that is.
MOST_LOSS = 0.1
#: A joint whose held-out mean square exceeds that of the floor by this share has something left to find.
LEFT = 0.25
#: A gain of this many standard errors is no accident, wherever it shows.
DECISIVE = 3.0
#: Below this share of the squares that two models leave their difference is the rounding of sums and of fits.
ROUNDING = 1e-9
#: A gain this many times as sure and as large as is asked for is so with bodies held physical, too.
BY_FAR = 3.0
#: The reason that stands beside a candidate that comes in.
ACCEPTED = "accepted"
#: Of the rows that are judged, so many of the best under bounds alone first, where every fit takes a while.
FIRST_ROWS = 5


def same_place(a: Term, b: Term) -> bool:
    """True where two terms are the same effect on the same joint, whatever their settings."""
    return a.place == b.place


def elsewhere(terms: Iterable[Term], others: Sequence[Term]) -> list[Term]:
    """Those of ``terms`` that have the place of none of ``others``."""
    return [t for t in terms if not any(same_place(t, o) for o in others)]


@dataclass(frozen=True)
class Gain:
    """What a change of the model is worth on held-out samples: ``total`` and its standard error ``error``, weighted
    (squared floors); ``per_joint`` (n,) [N m]^2 per sample; ``blocks`` behind the error."""

    total: float
    error: float
    per_joint: Array
    blocks: int

    def surer_than(self, errors: float) -> bool:
        """True where the gain exceeds that many of its standard errors."""
        return self.total > errors * self.error and self.total > 0


@dataclass(frozen=True)
class Judge:
    """Decides what a change of held-out error is worth, as of the linearisation that ``evidence`` stands at.

    A value: to stand at another model makes another judge. What moves a search on to another model returns the judge
    who stands there, first of what it returns.

    ``misfit`` (n,) [N m] is what the starting model was known to be off by on other runs, or what the steps of the
    recorded torque round away: a smaller change is no news.
    ``low`` (n,) [N m]: no more than that is noise, by second differences.
    ``contacts``: moments that the evidence leaves out, since something may push then.
    """

    evidence: Evidence
    settings: LoopSettings
    floor: Array
    torque_variance: Array
    misfit: Array
    low: Array
    contacts: tuple[Contact, ...] = ()

    def at(self, terms: Sequence[Term]) -> Judge:
        """Where the model with ``terms``, re-fitted from here, stands."""
        return self.over(refit(self.evidence, terms).evidence)

    def adding(self, terms: Sequence[Term]) -> Judge:
        """Where it stands, with the columns of ``terms``."""
        return self.over(self.evidence.adding(terms))

    def over(self, evidence: Evidence) -> Judge:
        """The same over another ``evidence``."""
        return replace(self, evidence=evidence)

    def gain(self, new: Held, old: Held, noise: Held | None = None, joints: NDArray[np.bool_] | None = None) -> Gain:
        """Gain of ``new`` over ``old`` and its uncertainty, given the motion.

        With d the change of the prediction and e the new residual, the gain is sum(d^2 + 2 d e): given the motion and
        the fits only d e is random. Its block sums are clusters (Bester, Conley and Hansen 2011); blocks that
        remember each other are merged as long as enough are left.
        ``noise``: the held-out prediction whose residual stands for e, where a fuller model knows it better.
        ``joints`` (n,): those that count, else all.
        """
        weights = self.evidence.weights if joints is None else self.evidence.weights * joints
        left = new if noise is None else noise
        cross = self.evidence.change(left, old, new)
        gain = old.joint_errors - new.joint_errors
        error, blocks = block_error(cross @ weights, self.evidence.blocks.run)
        per_joint = gain / np.maximum(self.evidence.samples, 1)
        # Laws that make the same torque differ by rounding, on each processor by another: that is never sure.
        rounding = ROUNDING * float((old.joint_errors + new.joint_errors) @ weights)
        return Gain(float(gain @ weights), max(2.0 * error, rounding), np.asarray(per_joint), blocks)

    def news(self, new: Held, old: Held) -> Gain:
        """:meth:`gain` on the joints where that is more than the starting model, or the recorded torque by its steps,
        was off by: a torque that is rounded to nothing is fitted best by links that weigh nothing."""
        whole = self.gain(new, old)
        return self.gain(new, old, joints=np.abs(whole.per_joint) > self.misfit**2)

    def needs(self, term: Term, loss: Gain, share: float) -> bool:
        """True where a ``loss`` of held-out error is a reason to keep ``term``: sure, and of practical size (``share``
        of the floor)."""
        return loss.surer_than(1.0) and self.matters(term, loss.per_joint, share, loss.surer_than(DECISIVE))

    def worth(self, terms: Sequence[Term], term: Term, noise: Held | None = None, physical: bool = True) -> Gain:
        """What ``term`` of ``terms`` gains over none, or over the plain effects of its joints that it could stand for,
        whichever is less; ``physical``: of fits with bodies and friction held so."""
        held = self.evidence.held
        full, rest = held(terms, physical), [t for t in terms if t != term]
        plain = self.beside(rest, term)
        rivals = [rest, [*rest, *plain]] if plain else [rest]
        return min((self.gain(full, held(rival, physical), noise) for rival in rivals), key=lambda g: g.total)

    def plainly_needed(self, terms: Sequence[Term], term: Term, errors: float, share: float) -> bool:
        """True where fits under bounds alone miss ``term`` of ``terms`` by far: by much more than ``errors`` standard
        errors and ``share`` squared floors. Fits with bodies held physical would say the same, in a hundred times as
        long."""
        gain = self.worth(terms, term, physical=False)
        after = self.evidence.held(terms)
        return (
            gain.surer_than(BY_FAR * max(errors, 1.0))
            and self.matters(term, gain.per_joint, BY_FAR * share)
            and not self.nibbles(term, gain, after, BY_FAR * NIBBLE_KEPT)
        )

    def nibbles(self, term: Term, gain: Gain, after: Held, share: float) -> bool:
        """True where an effect of the further families takes less than ``share`` of what was left where it acts.

        Causes explain most of what they cause. What takes a little of much is what a flexible law makes of something
        else that the model lacks.
        """
        if term.family().searched:
            return False
        left = np.maximum(self.mean_square(after) + gain.per_joint - self.low**2, 0.0)
        acts = self.evidence.acts(term) & (self.floor > 0)
        if term.joint is None:
            weights = self.evidence.weights * acts
            return bool(gain.per_joint @ weights < share * (left @ weights))
        return not np.any(acts & (gain.per_joint >= share * left))

    def reason(self, term: Term, gain: Gain, after: Held) -> str:
        """:data:`ACCEPTED` where ``gain`` makes ``term`` worth its place, else why it is not; ``after``: with it."""
        settings = self.settings
        if not gain.surer_than(settings.gain_in_errors):
            return "within uncertainty"
        if self.nibbles(term, gain, after, NIBBLE):
            return "too little of what is left"
        matters = self.matters(term, gain.per_joint, settings.floor_share, gain.surer_than(DECISIVE))
        return ACCEPTED if matters else "too small to matter"

    def beside(self, terms: Sequence[Term], term: Term) -> list[Term]:
        """Plain effects on the joints of ``term`` that ``terms`` lacks, with the best of their settings."""
        evidence = self.evidence
        out: list[Term] = []
        for name in term.family().beside:
            for joint in np.flatnonzero(evidence.acts(term)):
                own = [t for t in evidence.terms if t.effect == name and t.joint == joint]
                offered = [t for t in own if ONLY_RUN not in t.options]
                if offered and not has_family(terms, name, int(joint)):
                    out.append(min(offered, key=lambda t: (evidence.held([*terms, t]).score, term_order(t))))
        return out

    def mean_square(self, held: Held) -> Array:
        """(n,) [N m]^2."""
        return np.asarray(held.joint_errors / np.maximum(self.evidence.samples, 1))

    def above_floor(self, held: Held) -> NDArray[np.bool_]:
        """(n,) joints on which ``held`` leaves so much more than the floor that something is left to find."""
        return (self.floor > 0) & (self.mean_square(held) > (1 + LEFT) * self.floor**2)

    def mostly_left(self, held: Held) -> bool:
        """True where ``held`` leaves more than the floor on most of the joints that move, two at least: what is named
        is not all that is off."""
        left = int(self.above_floor(held).sum())
        return left > 1 and 2 * left > int((self.floor > 0).sum())

    def as_good(self, new: Held, best: Held, errors: float = 1.0) -> bool:
        """True where ``new`` is worse than ``best`` within ``errors`` standard errors, or by nothing that matters.

        The noise is what ``best`` leaves: what a worse model lacks would excuse it.
        """
        gain = self.gain(new, best, best)
        return bool(
            -gain.total <= errors * gain.error or np.all(-gain.per_joint <= self._bar(self.settings.keep_share))
        )

    def spares(self, new: Held, best: Held) -> bool:
        """True where ``new`` is worse than ``best`` on no joint by much: by :data:`MOST_LOSS`, or of the floor, or by
        what the starting model was known to be off by: a flexible cause makes that smaller, too."""
        least = np.maximum(self.mean_square(best), self.floor**2)
        much = np.maximum(MOST_LOSS * least, self.misfit**2)
        return bool(np.all(self.mean_square(new) <= self.mean_square(best) + much + 1e-300))

    def level(self, candidates: int, blocks: int) -> float:
        """Standard errors that a kept effect must gain: Student's t at ``significance`` divided by the candidates."""
        share = self.settings.significance / max(candidates, 1)
        return float(student.ppf(1.0 - share, max(blocks - 1, 1)))

    def price(self, *terms: Term) -> float:
        """Price of effects where two explanations are as good: their published numbers, fewer causes first."""
        return sum(s.family().price(s.options) for s in terms) + 0.1 * len(terms)

    def _bar(self, share: float) -> Array:
        """Mean square (n,) [N m]^2 below which a change is of no practical size."""
        size = np.maximum(share * self.floor**2, self.settings.torque_share * self.torque_variance)
        return np.maximum(size, self.misfit**2)

    def needed(self, term: Term) -> int:
        """On how many joints an effect must show: a whole-robot effect seen on one joint is a proxy for a local one.

        A payload is the last link's body, which a wrist may show on its own joint alone.
        """
        kind = term.family()
        if kind.scope != "robot" or (kind.is_body and not kind.all_links):
            return 1
        return max(min(2, int((self.evidence.samples >= FEWEST_ROWS).sum())), 1)

    def shows(self, term: Term, x: float) -> bool:
        """True where the torque of ``term``, of one coefficient ``x``, on its joint is itself of practical size.

        Other effects may take most of it up, so that leaving it out hardly costs where the data is.
        """
        square = x**2 * self.evidence.unit_square(term)
        return bool(square > self._bar(self.settings.floor_share)[term.index])

    def matters(self, term: Term, joint_gain: Array, share: float, decisive: bool = False) -> bool:
        """True where the gain (n,) [N m]^2 is of practical size on enough of the joints on which the effect acts.

        A gain elsewhere comes from what the effect allows the others to do: a proxy, unless it is ``decisive``.
        """
        counted = np.ones(self.evidence.n, bool) if decisive else self.evidence.acts(term)
        return int(np.sum((joint_gain > self._bar(share)) & counted)) >= self.needed(term)


def block_error(sums: Array, owner: NDArray[np.int_]) -> tuple[float, int]:
    """Standard error of the total of ``sums`` (blocks,), and the number of clusters behind it.

    ``owner`` (blocks,) is the run of each block; neighbours of one run are merged by two as long as they remember each
    other and enough are left.
    """
    error, clusters, parts = 0.0, len(sums), [sums[owner == run] for run in np.unique(owner)]
    while True:
        total = np.concatenate(parts)
        clusters = len(total)
        error = max(error, float(np.sqrt(clusters / max(clusters - 1, 1) * np.sum(total**2))))
        following = float(sum(np.sum(p[1:] * p[:-1]) for p in parts)) / max(float(np.sum(total**2)), 1e-300)
        merged = [np.add.reduceat(p, np.arange(0, len(p), 2)) for p in parts]
        # Blocks that do not remember each other need no merging; two standard errors of an autocorrelation.
        if following < 2.0 / np.sqrt(clusters) or sum(map(len, merged)) < FEWEST_CLUSTERS:
            return error, clusters
        parts = merged


def difference_error(
    one: Sequence[Array], other: Sequence[Array], times: Sequence[Array], block: float, weights: Array
) -> tuple[float, int]:
    """Standard error of the weighted squares of residuals ``one`` less those of ``other``, and the clusters behind it.

    Residuals (K, n) [N m] and ``times`` (K,) [s] per run, ``weights`` (n,). The difference is d (d + 2 e): d what one
    predicts more than the other, e the noise. Given the motion and the fits only d e is random; its sums over blocks
    of ``block`` [s] are the clusters (:func:`block_error`).
    """
    squares = [sum(float(np.sum(e**2 @ weights)) for e in part) for part in (one, other)]
    # What is left by the worse one holds what it lacks, which is no noise.
    least = one if squares[0] <= squares[1] else other
    sums, owner = [], []
    for r, (new, old, left, time) in enumerate(zip(one, other, least, times, strict=True)):
        sums.append(np.add.reduceat(((old - new) * left) @ weights, block_starts(time, block)))
        owner.append(np.full(len(sums[-1]), r))
    error, clusters = block_error(np.concatenate(sums), np.concatenate(owner))
    return 2.0 * error, clusters


def rank(judge: Judge, current: Sequence[Term], candidates: Sequence[Term], before: Held) -> list[Candidate]:
    """Evidence table of one step, best first. ``before``: held-out prediction of the current terms.

    All fits are held physical, so that what cannot exist never wins.
    """
    evidence = judge.evidence
    active = evidence.constrained(current)
    free = [c for c in candidates if not any(same_place(c, o) or covers(o, c) for o in current)]
    if active:
        # Every physical fit takes a while then: the best under bounds alone are looked at.
        screened = {c: evidence.held(joined(current, c)).score for c in free}
        free = sorted(free, key=lambda c: (screened[c], term_order(c)))[:TABLE_ROWS]
    held: dict[Term, Held] = {}
    rows: dict[Term, Candidate] = {}
    for some in (free[:FIRST_ROWS], free[FIRST_ROWS:]) if active else (free,):
        held |= {c: evidence.held(joined(current, c), physical=True) for c in some}
        order = sorted(held, key=lambda s: (held[s].score, s.size, term_order(s)))[:TABLE_ROWS]
        rows |= {s: _judged(judge, s, joined(current, s), before, held[s]) for s in order if s not in rows}
        if any(row.accepted for row in rows.values()):
            break
    # Of those that may be named the best, and of its rivals the simplest; without any, the same of all.
    pool = [s for s in order if rows[s].accepted] or order
    if not pool:
        return []
    rivals = [s for s in pool if judge.as_good(held[s], held[pool[0]])]
    chosen = min(rivals, key=lambda s: (judge.price(s), held[s].score, term_order(s)))
    return [rows[chosen], *(rows[s] for s in order if s != chosen)]


def _judged(judge: Judge, term: Term, terms: Sequence[Term], before: Held, after: Held) -> Candidate:
    """The row of ``term`` in the evidence table, from held-out predictions without it and of ``terms``, with it."""
    total = float(judge.evidence.samples[judge.evidence.samples >= FEWEST_ROWS].sum()) or 1.0
    gain = judge.worth(terms, term) if term.family().beside else judge.gain(after, before)
    reason = judge.reason(term, gain, after)
    return Candidate(
        term,
        after.score / total,
        gain.total / total,
        gain.error / total,
        tuple(float(g) for g in gain.per_joint),
        reason == ACCEPTED,
        reason,
    )


def has_family(terms: Sequence[Term], name: str, joint: int) -> bool:
    """True where one of ``terms`` is the family ``name`` on ``joint``, or holds it as a special case."""
    return any(t.joint == joint and (t.effect == name or name in t.family().contains) for t in terms)


def all_links_of(terms: Iterable[Term]) -> Term | None:
    """The first of ``terms`` that is the parameters of all links, if one is."""
    return next((t for t in terms if t.family().all_links), None)


def has_all_links(terms: Iterable[Term]) -> bool:
    """True where one of ``terms`` is the parameters of all links."""
    return all_links_of(terms) is not None


def covers(general: Term, special: Term) -> bool:
    """True where ``general`` holds ``special`` as a special case."""
    return general.family().covers(general, special)


def joined(current: Sequence[Term], term: Term) -> list[Term]:
    """``current`` with ``term`` in the place of what it contains."""
    return [*(s for s in current if not covers(term, s)), term]
