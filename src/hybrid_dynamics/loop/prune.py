"""Search from everything: start with all that the data can carry on every joint, add bodies, prune what is not needed.

Effects mask each other: friction looks poor until the payload is in, and the other way round. Starting from everything
and pruning finds groups that no single addition would; starting from nothing finds the simple cases. The better end
counts (:func:`choose`), the simpler one where both predict as well.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from hybrid_dynamics.check.convention import OUTSIDE
from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.acting import readings
from hybrid_dynamics.effects.inertia import cannot_be
from hybrid_dynamics.loop.augment import effects_of, refit
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.floor import FEWEST_ROWS
from hybrid_dynamics.loop.layout import Layout
from hybrid_dynamics.loop.search import Step, better_settings, step_of
from hybrid_dynamics.loop.tangents import covariance_with_settings
from hybrid_dynamics.loop.trace import DECISIVE, NIBBLE_KEPT, Gain, Judge, joined, rank, same_place
from hybrid_dynamics.types import Array

#: A family must surely sit on at least this many joints, and on half of those that move, to be common.
FEWEST_COMMON = 3
#: The gain of a coefficient is as sure as half its standard errors.
TWICE = 2.0
#: Further than this [rad] no zero is off: from a zero a quarter turn away, which is asked before the search
#: (:mod:`hybrid_dynamics.check.convention`), it would be less than half of that.
FARTHEST_ZERO = 1.2
#: Relative distance within which a coordinate stands on its bound.
BOUND = 1e-6


def on_every_joint(candidates: Sequence[Term]) -> list[Term]:
    """Of ``candidates`` what every joint of a real arm has: one term, the first, of every effect and joint."""
    places: dict[tuple[str, int | None], Term] = {}
    for term in candidates:
        if term.family().scope == "joint" and term.family().everywhere:
            places.setdefault((term.effect, term.joint), term)
    return list(places.values())


def from_everything(
    judge: Judge, candidates: Sequence[Term], report: Callable[[Step], None], more: Sequence[Term] = ()
) -> tuple[Judge, list[Step]]:
    """Steps from all joint-wise effects of one coefficient and what there is ``more``, over the bodies they leave room
    for, to what is needed; and the judge there.

    No steps where nothing acts on a single joint. Ends: bodies are only added, at most each once; then effects are only
    dropped.
    """
    current = [*on_every_joint(candidates), *more]
    if not current:
        return judge, []
    judge = judge.at(current)
    current = better_settings(judge, current, candidates)
    steps = [step_of(judge, "start", None, current)]
    report(steps[-1])
    wide = [c for c in candidates if c.family().is_wide(c)]
    while wide:
        table = rank(judge, current, wide, judge.evidence.held(current, physical=True))
        choice = next((c for c in table if c.accepted), None)
        if choice is None:
            break
        current = joined(current, choice.term)
        wide = [c for c in wide if not same_place(c, choice.term)]
        judge = judge.at(current)
        steps.append(step_of(judge, "add", choice.term, current, table))
        report(steps[-1])
    current = better_settings(judge, current, candidates)
    while True:
        idle = _idle(judge, current, judge.settings.keep_share)
        if not idle:
            break
        # Half of what is not needed at once, as long as that costs nothing; else one after the other.
        full = judge.evidence.held(current, physical=True)
        bunch = [s for _, s in idle[: max(len(idle) // 2, 1)]]
        rest = [s for s in current if s not in bunch]
        if len(bunch) > 1 and not judge.as_good(judge.evidence.held(rest, physical=True), full):
            bunch = bunch[:1]
            rest = [s for s in current if s not in bunch]
        current = rest
        judge = judge.at(current)
        for term in bunch:
            steps.append(step_of(judge, "drop", term, current))
            report(steps[-1])
    return judge, steps


def choose(ends: Sequence[tuple[Judge, Sequence[Term]]]) -> tuple[Judge, list[Term]]:
    """The best of several ends, each with its judge, by held-out error; of those as good, the one of the lowest price.

    Of ends that met in the same terms the first: their errors differ by rounding alone. Every end is scored where its
    own model stands; whether another is as good, where the best one does.
    """
    ends = [end for k, end in enumerate(ends) if set(end[1]) not in [set(terms) for _, terms in ends[:k]]]
    judges, models = [own.at(terms) for own, terms in ends], [terms for _, terms in ends]
    held = [own.evidence.held(terms, physical=True) for own, terms in zip(judges, models, strict=True)]
    best = min(range(len(ends)), key=lambda k: held[k].score)
    judge = judges[best].adding([term for terms in models for term in terms])
    again = [judge.evidence.held(terms, physical=True) for terms in models]
    rivals = [
        k
        for k in range(len(ends))
        if k == best or (judge.as_good(again[k], again[best]) and judge.spares(again[k], again[best]))
    ]
    chosen = min(rivals, key=lambda k: (judge.price(*models[k]), held[k].score))
    return judges[chosen], list(models[chosen])


def keep_sure(
    judge: Judge, current: Sequence[Term], looked: int, report: Callable[[Step], None]
) -> tuple[Judge, list[Term], set[str], list[Step]]:
    """Drop, least sure first, what does not exceed the level that ``looked`` candidates ask for; returns the judge at
    what stays, that, the common families and the steps.

    The noise is what the model leaves before anything is dropped: otherwise the misfit that one drop leaves behind
    would drown the next. What is kept by its gain must be of practical size in the end, too. A family that is common
    was looked at once; on each further joint it is one of n. The gain of a coefficient of z standard errors is about
    z / 2 of its own, so the rule asks for twice as sure a coefficient, of the gain or of itself; of friction, offset
    and armature, which every arm has, a coefficient at the level itself is enough.
    """
    evidence = judge.evidence
    kept = list(current)
    steps: list[Step] = []
    own = judge.level(evidence.n, len(evidence.blocks))
    common = _common(judge, current, losses(judge, current), looked)
    while True:
        # Anew: where a law is not linear a drop moves what the linear problem stands for.
        evidence = judge.evidence
        noise = evidence.held(current, physical=True)
        sizes, forced = in_errors(judge, kept, evidence.fit(kept)), _forced(judge, kept)
        asked = kept
        if evidence.constrained(kept):
            strict, share = judge.level(looked, len(evidence.blocks)), judge.settings.keep_share
            asked = [t for t in kept if t in forced or not judge.plainly_needed(kept, t, strict, share)]
        gains = {term: judge.worth(kept, term, noise) for term in asked}
        full = evidence.held(kept, physical=True)
        weak = []
        for term, gain in gains.items():
            expected = term.effect in common and term.joint is not None
            level = judge.level(evidence.n if expected else looked, gain.blocks)
            size = sizes.get(term, 0.0)
            shows = judge.matters(term, gain.per_joint, judge.settings.keep_share, gain.surer_than(DECISIVE))
            # Slow noise makes few blocks of many, and the gain less sure than what it is the gain of.
            known = size > TWICE * level and gain.surer_than(judge.settings.gain_in_errors)
            sure = (gain.surer_than(level) or known) and shows and not judge.nibbles(term, gain, full, NIBBLE_KEPT)
            # What every joint of a real arm has needs no more than a coefficient as sure as that, and a gain at all; no
            # more does what a joint goes wrong without: chance does not halve what parts held out are left with.
            least = np.maximum(judge.mean_square(full), judge.floor**2)
            halves = bool(np.any(evidence.acts(term) & (gain.per_joint > least)))
            needed = term.family().everywhere or (halves and shows)
            plain = needed and size > level and gain.surer_than(judge.settings.gain_in_errors)
            if term in forced:
                weak.append((-np.inf, term))
            elif not (sure or plain or (expected and size > own and gain.total > -gain.error)):
                weak.append((gain.total / max(gain.error * level, 1e-300), term))
        if not weak:
            return judge, kept, common, steps
        _, term = min(weak, key=lambda item: (item[0], repr(item[1])))
        kept.remove(term)
        judge = judge.at(kept)
        steps.append(step_of(judge, "drop", term, kept))
        report(steps[-1])


def losses(judge: Judge, current: Sequence[Term]) -> dict[Term, Gain]:
    """What each effect is worth in the model of all of them."""
    return {term: judge.worth(current, term) for term in current}


def _common(judge: Judge, current: Sequence[Term], gains: dict[Term, Gain], looked: int) -> set[str]:
    """Families that are one cause on many joints, so that on each joint they need only be sure for it.

    Either they are surely there on most moving joints; or they are sure together on those joints on which they are not
    sure alone: every joint of a real arm has friction, which a short log shows on all joints sooner than on each.
    """
    evidence = judge.evidence
    sure: Counter[str] = Counter()
    unsure: dict[str, list[Term]] = {}
    for term, gain in gains.items():
        # A ripple's harmonic is sought anew on every joint, and a joint may have two.
        if term.joint is None or term.family().several:
            continue
        if gain.surer_than(judge.level(looked, gain.blocks)):
            sure[term.effect] += 1
        elif term.family().everywhere:
            unsure.setdefault(term.effect, []).append(term)
    moving = int((evidence.samples >= FEWEST_ROWS).sum())
    out = on_most(sure, moving)
    full = evidence.held(current, physical=True)
    names = {t.effect for t in evidence.terms if t.family().everywhere}
    for name, terms in unsure.items():
        rest = evidence.held([t for t in current if t not in terms], physical=True)
        gain = judge.gain(full, rest)
        if len(terms) > 1 and gain.surer_than(judge.level(len(names), gain.blocks)):
            out.add(name)
    return out


def without_noise(judge: Judge, current: Sequence[Term], sure: bool = False) -> tuple[Judge, list[Term]]:
    """``current`` without terms all of whose coefficients are below their own standard errors, the least first; and the
    judge there.

    What held-out rows miss stays: beside something that can look the same a standard error says little (a few seconds
    of friction beside all links and a gain).
    ``sure``: what every joint of an arm has must be as sure as n questions ask for, in the model as it is in the end,
    or held-out rows must miss it as surely: something else may have taken it over since it was named.
    """
    joints = judge.evidence.n
    level = judge.level(joints, len(judge.evidence.blocks)) if sure else 1.0
    kept = list(current)
    while True:
        fitted = refit(judge.evidence, kept)
        judge = judge.over(fitted.evidence)
        small: dict[Term, float] = {}
        for term, size in in_errors(judge, kept, fitted.x).items():
            asked = level if term.family().everywhere else 1.0
            if size >= max(asked, 1.0):
                continue
            gain = judge.worth(kept, term)
            if size < 1.0 and not judge.needs(term, gain, judge.settings.keep_share):
                small[term] = size
            elif size >= 1.0 and not gain.surer_than(judge.level(joints, gain.blocks)):
                small[term] = size / level
        if not small:
            return judge, kept
        kept.remove(min(small, key=lambda t: (small[t], repr(t))))


def in_errors(judge: Judge, current: Sequence[Term], x: Array) -> dict[Term, float]:
    """The surest coefficient of every term but bodies at coordinates ``x``, in its own standard errors."""
    evidence = judge.evidence
    spread = np.sqrt(np.maximum(np.diag(covariance_with_settings(evidence, current, x)), 1e-300))
    layout = evidence.layout(current)
    places = zip(layout.terms, layout.starts, strict=True)
    sizes = np.abs(x) / spread[: len(x)]
    return {t: float(sizes[start : start + t.size].max()) for t, start in places if not t.family().is_body}


def impossible(judge: Judge, current: Sequence[Term]) -> list[Term]:
    """Those of ``current`` that cannot be: a single body changed by more than a body is, a zero that is
    farther off than zeros are or puts the joint far outside its limits, coordinates that are no such law."""
    evidence = judge.evidence
    x, layout, robot = evidence.fit(current), evidence.layout(current), evidence.robot
    dry = _dry_friction(evidence, layout, x)
    out = []
    for term, start in zip(layout.terms, layout.starts, strict=True):
        own = x[start : start + term.size]
        bodies = term.family().inertial_changes(own, robot, term)
        none = term.joint is not None and term.family().is_none(own, term, float(dry[term.joint]))
        if none or any(cannot_be(robot, change) for change in bodies) or _outside(evidence, term, own):
            out.append(term)
    return out


def _dry_friction(evidence: Evidence, layout: Layout, x: Array) -> Array:
    """(n,) [N m] dry friction of every joint in motion, by coordinates ``x`` of ``layout`` and by the starting model,
    of which those may be a change. Without end where it follows the load."""
    parts = [(t, x[start : start + t.size]) for t, start in zip(layout.terms, layout.starts, strict=True)]
    total = np.zeros(evidence.n)
    for term, own in [*parts, *evidence.problem.base_places.items()]:
        kind = term.family()
        if term.joint is not None and kind.is_friction and not kind.viscous_powers:
            named = kind.in_descriptions(kind.parameters_of(own, evidence.robot, term), term.options)
            total[term.joint] += named.get("dry_friction", np.inf if kind.uses_load else 0.0)
    return total


def _outside(evidence: Evidence, term: Term, x: Array) -> bool:
    """True where coordinates ``x`` (p,) of ``term`` put a joint's zero beyond :data:`FARTHEST_ZERO`, or the joint by
    :data:`OUTSIDE` further outside the limits of the URDF than it is read; limits of zero width count as not given."""
    if not term.family().changes_reading:
        return False
    robot = evidence.robot
    offset = readings(robot, effects_of(evidence, [term], x)).offset
    # A gain or a delay moves no joint.
    if not offset.any():
        return False
    turning = np.array([name not in robot.prismatic for name in robot.joint_names])
    if np.any(turning & (np.abs(offset) > FARTHEST_ZERO)):
        return True
    low, high = robot.position_limits
    least = np.min([run.q.min(axis=0) for run in evidence.runs], axis=0)
    most = np.max([run.q.max(axis=0) for run in evidence.runs], axis=0)
    given = low < high
    read, there = (np.maximum(np.maximum(low - least - o, most + o - high), 0.0) for o in (0.0, offset))
    return bool(np.any(given & (there > read + OUTSIDE)))


def _forced(judge: Judge, current: Sequence[Term]) -> set[Term]:
    """Terms that stand at the end of what is plausible: the data wants what cannot be, so they are something else."""
    evidence = judge.evidence
    x, layout = evidence.fit(current), evidence.layout(current)
    out = set(impossible(judge, current))
    for term, start in zip(layout.terms, layout.starts, strict=True):
        lower = term.family().lower_bounds(evidence.robot, term)
        # At zero an effect that only takes energy is just not there.
        end = np.isfinite(lower) & (lower != 0.0)
        if np.any(x[start : start + term.size][end] <= lower[end] + BOUND * np.abs(lower[end])):
            out.add(term)
    return out


def on_most(sits: Counter[str], moving: int) -> set[str]:
    """Families that sit on enough of the ``moving`` joints to be common."""
    return {name for name, count in sits.items() if count >= max(FEWEST_COMMON, (moving + 1) // 2)}


def _idle(judge: Judge, current: Sequence[Term], share: float) -> list[tuple[float, Term]]:
    """Effects without which the held-out error hardly grows, least needed first."""
    idle = []
    active = judge.evidence.constrained(current)
    for term in current:
        if active and judge.plainly_needed(current, term, DECISIVE, share):
            continue
        loss = judge.worth(current, term)
        if not judge.needs(term, loss, share):
            idle.append((loss.total, term))
    return sorted(idle, key=lambda item: (item[0], repr(item[1])))
