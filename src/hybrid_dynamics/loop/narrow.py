"""A few causes in the place of all links: a search that met all links first never asks for them.

All links' parameters take up what one or two of them lack, and a spring, a wrong zero or a gain besides. The fewest
causes that do as well take their place, by the rule by which all links take that of bodies (:mod:`.widen`). Larger
groups fit by chance what smaller ones do not, so a size is asked only where no smaller one does; last the gains of all
joints, since drives are off each by its own factor.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

from hybrid_dynamics.effects import Term, family
from hybrid_dynamics.loop.beside import beside_links
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.floor import FEWEST_ROWS
from hybrid_dynamics.loop.further import like_a_body
from hybrid_dynamics.loop.held import Held
from hybrid_dynamics.loop.search import take
from hybrid_dynamics.loop.trace import Judge, all_links_of, elsewhere
from hybrid_dynamics.loop.widen import BELIEVED, BETTER, beyond_belief, too_few

#: So many causes may stand in the place of all links, where they cost less; larger groups are made of so many that
#: predict best.
FEW, KEPT = 3, 6
#: Of those within this multiple of the least score, so many of a size are re-fitted.
NEAR, TRIED = 1.2, 6

Groups = dict[tuple[Term, ...], Held]


def narrowed(judge: Judge, chosen: Sequence[Term], candidates: Sequence[Term] = ()) -> tuple[Judge, list[Term]]:
    """``chosen`` with :data:`FEW` causes or fewer (bodies, each believed, or what can look like one: a spring, a wrong
    zero, a gain), or with the gains of all joints, in the place of all links' parameters, where these do not predict
    held-out samples better by :data:`BETTER` standard errors; and the judge there.

    Where a few causes leave most joints with more than their floor, whatever friction of ``candidates`` stands beside
    them, they must predict better by as much as an effect must to come in."""
    links = all_links_of(chosen)
    if links is None:
        return judge, list(chosen)
    rest = [t for t in chosen if t != links]
    causes, parts = (elsewhere(some, rest) for some in _offered(judge))
    judge = judge.adding([*causes, *parts]).at(chosen)
    judge, beside = beside_links(judge, chosen)
    for held in _by_size(judge.evidence, rest, causes, parts):
        there = _in_their_place(judge, links, beside, rest, held, candidates)
        if there is not None:
            return there
    return judge.at(chosen), list(chosen)


def _offered(judge: Judge) -> tuple[list[Term], list[Term]]:
    """Causes that a regressor has or that look like a body, and the mass or the centre of every link alone.

    The latter since what the last link lacks may be no payload, which has a mass of its own, and beside a payload the
    ten numbers of the link before it are beyond belief.
    """
    robot, options = judge.evidence.robot, judge.settings.options
    moving = judge.evidence.samples >= FEWEST_ROWS
    names = [name for name in judge.settings.families if family(name).by_regressor and not family(name).all_links]
    alike = [family(name) for name in judge.settings.further]
    names += [k.name for k in alike if k.scope == "joint" and not k.several and like_a_body(k)]
    causes = [t for name in names for t in family(name).terms(robot, moving, options)]
    parts = [t for k in alike if k.scope == "link" and k.changes_body for t in k.terms(robot, moving, options)]
    return causes, parts


def _by_size(
    evidence: Evidence, rest: Sequence[Term], causes: Sequence[Term], parts: Sequence[Term]
) -> Iterator[Groups]:
    """Held-out predictions of ``rest`` with one or two of the causes and parts, then with one more at a time beside
    those groups of the size before that predict best; last with the gains of all joints."""

    def held(groups: Sequence[tuple[Term, ...]]) -> Groups:
        apart = [g for g in dict.fromkeys(groups) if len({t.place for t in g}) == len(g)]
        return {g: evidence.held([*rest, *g]) for g in apart}

    # One factor of all joints is all links heavier, not one of a few causes (loop/scale.py); it had its say in pairs.
    single = [c for c in causes if c.joint is not None or c.family().scope != "joint"]
    free = [*single, *parts]
    pairs = [*combinations(causes, 2), *(g for g in combinations(free, 2) if g[1] in parts)]
    groups = held([*((c,) for c in (*causes, *parts)), *pairs])
    yield groups
    for size in range(3, FEW + 1):
        alike = (g for g in groups if len(g) == size - 1 and all(t in free for t in g))
        best = sorted(alike, key=lambda g: groups[g].score)[:KEPT]
        more = (tuple(t for t in free if t in g or t == c) for g in best for c in free)
        groups = held([g for g in more if len(g) == size])
        yield groups
    # What a drive makes of a current is off on every joint in its own way.
    gains = tuple(c for c in single if c.family().changes_reading and c.family().uses_torque)
    if len(gains) >= FEW:
        yield held([gains])


def _in_their_place(
    judge: Judge,
    links: Term,
    beside: Sequence[Term],
    rest: Sequence[Term],
    held: Groups,
    candidates: Sequence[Term],
) -> tuple[Judge, list[Term]] | None:
    """``rest`` with the cheapest group of ``held`` that does as well as ``links`` with what stands ``beside`` them, and
    the judge there; None where there is none."""
    together = [*rest, links, *beside]
    best = min(held.values(), key=lambda h: h.score, default=None)
    if best is None or judge.news(judge.evidence.held(together), best).surer_than(BETTER):
        return None
    near = [
        some
        for some, own in held.items()
        if own.score <= NEAR * best.score and judge.price(*some) < judge.price(links) and judge.as_good(own, best)
    ]
    # A spring of two numbers before a link of ten that stands for it.
    for some in sorted(near, key=lambda some: (judge.price(*some), held[some].score, repr(some)))[:TRIED]:
        trial = [*rest, *some]
        there = take(judge, together, trial)
        if there is None or beyond_belief(there, trial, there.evidence.fit(trial)) > BELIEVED:
            continue
        there = there.adding(together)
        if _as_well(there, trial, together) and not too_few(there, trial, together, candidates):
            return _without_idle(there, trial, some)
    return None


def _as_well(judge: Judge, few: Sequence[Term], many: Sequence[Term]) -> bool:
    """Whether ``few`` cost no joint much, and ``many`` do not predict held-out samples surely better."""
    own, full = (judge.evidence.held(terms, physical=True) for terms in (few, many))
    return judge.spares(own, full) and not judge.news(full, own).surer_than(BETTER)


def _without_idle(judge: Judge, trial: Sequence[Term], some: Sequence[Term]) -> tuple[Judge, list[Term]]:
    """``trial`` without those of ``some`` that it predicts as well without, once the rest is re-fitted; and the judge
    there. Where all links stood, a law that is not linear cannot tell that it needs no other."""
    out = list(trial)
    for idle in sorted(some, key=lambda t: (judge.price(t), repr(t))):
        rest = [t for t in out if t != idle]
        there = take(judge, out, rest) if rest else None
        if there is None:
            continue
        there = there.adding(out)
        if _as_well(there, rest, out):
            judge, out = there, rest
    return judge, out
