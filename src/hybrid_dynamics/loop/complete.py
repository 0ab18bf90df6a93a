"""Complete a model with what every joint of a real arm has: plain friction, offset, armature, where the data says so.

A search that weighs every addition against all others is strict. Of the plain families it is known beforehand that they
are there; the questions are fewer, and fewer questions need less certainty.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

import numpy as np
from scipy.stats import f as fisher

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop.floor import FEWEST_ROWS
from hybrid_dynamics.loop.likeness import SAME, Likeness
from hybrid_dynamics.loop.prune import on_most
from hybrid_dynamics.loop.tangents import covariance_with_settings
from hybrid_dynamics.loop.trace import Judge, has_family
from hybrid_dynamics.types import Array


def complete(
    judge: Judge, chosen: Sequence[Term], candidates: Sequence[Term], common: Collection[str] = ()
) -> tuple[Judge, list[Term]]:
    """``chosen`` with plain friction, offset and armature where they are expected and the data says so; and the judge
    there.

    What a joint lacks is asked together: two that take each other's part show only side by side, and a third that
    looks like both is not called first. Then each plain family on every joint at the level of all these places. Both
    for a torque of practical size: where a body acts it takes up what is left out, and then predicts other poses
    wrongly. A common family (``common``, and what sits on most joints) is one cause: on each other joint its parameter
    must exceed its own standard error at the level of n questions. Held-out runs must not speak against it; in short
    runs a held-out part may hold motions that the rest does not know, so a gain there is much to ask of a name that is
    expected.
    """
    evidence = judge.evidence
    moving = [int(j) for j in np.flatnonzero(evidence.samples >= FEWEST_ROWS)]
    plain = sorted({t.effect for t in evidence.terms if t.family().everywhere})
    places = [(n, j) for n in plain for j in moving]
    together = list(chosen)
    for joint in moving:
        together = _together(judge, together, candidates, plain, joint)
    placed = _where_they_fit(judge, chosen, together, candidates, places)
    out = _with_sure(judge, placed, candidates, places, sizeable=True)
    out = _where_they_fit(judge, placed, out, candidates, places)
    sits = Counter(s.effect for s in out if s.joint is not None and s.family().everywhere)
    for name in sorted(on_most(sits, len(moving)) | set(common)):
        out = _with_sure(judge, out, candidates, [(name, j) for j in moving])
    return judge.at(out), out


def _where_they_fit(
    judge: Judge,
    before: Sequence[Term],
    after: list[Term],
    candidates: Sequence[Term],
    places: Sequence[tuple[str, int]],
) -> list[Term]:
    """``after`` with each of what has come in since ``before`` on that joint of ``places`` that held-out rows are
    predicted best with, among those on which it is as sure and as large.

    A body loads several joints: a constant torque of one that it has taken up is missed on another, and looks sure
    there. The joints are asked in their order, and the first that asks is not the one that has it.
    """
    for term in [t for t in after if t not in before]:
        after = _where_it_fits(judge, after, term, candidates, places)
    return after


def _where_it_fits(
    judge: Judge, chosen: list[Term], term: Term, candidates: Sequence[Term], places: Sequence[tuple[str, int]]
) -> list[Term]:
    """``chosen`` with ``term`` on the joint of ``places`` that it fits."""
    evidence = judge.evidence
    if not any(t.family().changes_body and evidence.acts(t).sum() > 1 for t in chosen):
        return chosen
    rest = [t for t in chosen if t != term]
    elsewhere = [(name, joint) for name, joint in places if name == term.effect and joint != term.joint]
    trials = [_with_sure(judge, rest, candidates, [place], sizeable=True, of=len(places)) for place in elsewhere]

    def score(terms: list[Term]) -> float:
        return evidence.held(terms, physical=True).score

    best = min((t for t in trials if len(t) > len(rest)), key=score, default=chosen)
    # Worse than none, either may be: then no other joint is better for being nothing.
    return best if score(best) < min(score(chosen), score(rest)) else chosen


def _with_sure(
    judge: Judge,
    chosen: list[Term],
    candidates: Sequence[Term],
    places: Sequence[tuple[str, int]],
    sizeable: bool = False,
    of: int | None = None,
) -> list[Term]:
    """``chosen`` with those of ``places`` (family, joint) whose coefficient is sure at the level of so many, or ``of``
    more that they are a part of.

    ``sizeable``: only those whose torque is of practical size.
    """
    asked = of or len(places)
    evidence, out = judge.evidence, chosen
    for name, joint in places:
        offered = _lacking(judge, out, candidates, name, joint)
        if not offered:
            continue
        trials = [[*out, c] for c in offered]
        best = min(trials, key=lambda t: (evidence.held(t, physical=True).score, repr(t[-1])))
        x = evidence.fit(best)
        spread = float(np.sqrt(max(covariance_with_settings(evidence, best, x)[len(x) - 1, len(x) - 1], 0.0)))
        gain = judge.gain(evidence.held(best, physical=True), evidence.held(out, physical=True))
        sure = abs(x[-1]) > judge.level(asked, gain.blocks) * spread and gain.total > -gain.error
        if sure and (not sizeable or judge.shows(best[-1], float(x[-1]))):
            out = best
    return out


def _lacking(judge: Judge, chosen: Sequence[Term], candidates: Sequence[Term], name: str, joint: int) -> list[Term]:
    """Those of ``candidates`` of family ``name`` on ``joint`` that ``chosen`` does not make.

    A spring holds an offset, and so does friction that differs with the direction: beside them it says nothing, and
    neither is known any more.
    """
    if has_family(chosen, name, joint):
        return []
    own = [c for c in candidates if c.effect == name and c.joint == joint]
    near = [t for t in chosen if judge.evidence.acts(t)[joint]]
    return [c for c in own if Likeness(judge.evidence, c, np.ones(c.size)).share(*near) < 1.0 - SAME]


def _together(
    judge: Judge, chosen: list[Term], candidates: Sequence[Term], names: Sequence[str], joint: int
) -> list[Term]:
    """``chosen`` with those families ``names`` that ``joint`` lacks and that only show together.

    Friction and an offset take each other's part where a joint mostly moves one way: neither is sure alone. All that is
    lacking is one question a joint (Hotelling's T2 on the coefficients, each joint at its share of the level); only
    where the answer is yes is each asked at the level of so few (hierarchical testing: Meinshausen, Biometrika 95(2),
    2008). Held-out rows must not get worse.
    """
    evidence = judge.evidence
    lacking = []
    for name in names:
        offered = _lacking(judge, chosen, candidates, name, joint)
        if offered:
            lacking.append(min(offered, key=lambda c: (evidence.held([*chosen, c]).score, repr(c))))
    lacking, x, spread = _acting(judge, chosen, lacking)
    if len(lacking) < 2 or _chance(x, spread, len(evidence.blocks)) > judge.settings.significance / evidence.n:
        return chosen
    gain = judge.gain(evidence.held([*chosen, *lacking], physical=True), evidence.held(chosen, physical=True))
    if gain.total < 0:
        return chosen
    level = judge.level(len(lacking), len(evidence.blocks))
    while lacking:
        sizes = np.abs(x) / np.sqrt(np.diag(spread))
        if np.all(sizes >= level):
            return [*chosen, *(c for c, own in zip(lacking, x, strict=True) if judge.shows(c, float(own)))]
        lacking.pop(int(np.argmin(sizes)))
        lacking, x, spread = _acting(judge, chosen, lacking)
    return chosen


def _acting(judge: Judge, chosen: Sequence[Term], further: Sequence[Term]) -> tuple[list[Term], Array, Array]:
    """Those of ``further``, of one coefficient each, that are not on their bound at zero in a fit of all, their
    coefficients (k,) and covariance (k, k)."""
    evidence, kept = judge.evidence, list(further)
    while kept:
        layout = evidence.layout([*chosen, *kept])
        x = evidence.fit(layout.terms)
        places = [layout.starts[layout.terms.index(c)] for c in kept]
        if np.all(x[places] != 0.0):
            return kept, x[places], covariance_with_settings(evidence, layout.terms, x)[np.ix_(places, places)]
        kept = [c for c, place in zip(kept, places, strict=True) if x[place] != 0.0]
    return [], np.zeros(0), np.zeros((0, 0))


def _chance(x: Array, spread: Array, blocks: int) -> float:
    """Probability of coefficients ``x`` (k,) as large as these, of covariance ``spread`` (k, k) from ``blocks`` parts,
    where none is there (Hotelling's T2)."""
    k = len(x)
    if blocks <= k:
        return 1.0
    statistic = float(x @ np.linalg.solve(spread, x)) * (blocks - k) / (k * (blocks - 1))
    return float(fisher.sf(statistic, k, blocks - k))
