"""What the test runs say of each name, openly: confirmed, or contradicted beyond uncertainty and why.

The model is found without them. Afterwards every effect is left out in turn, the others re-fitted on the training runs;
where the test runs are then predicted better beyond uncertainty, all joints together or the only one on which the
effect acts, the name is contradicted. Errors are given for the
model as found and for the one without contradicted names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from hybrid_dynamics.effects import Term
from hybrid_dynamics.loop import known
from hybrid_dynamics.loop.beside import SURELY, all_beside
from hybrid_dynamics.loop.diagnosis import predict_run
from hybrid_dynamics.loop.floor import FEWEST_ROWS
from hybrid_dynamics.loop.found import Found
from hybrid_dynamics.loop.guessed import without_wrong
from hybrid_dynamics.loop.held_still import asks_too_much
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.trace import PRACTICAL, Judge, covers, difference_error, same_place
from hybrid_dynamics.types import Array

#: A joint ends worse than it began where its mean square grows by more than this share, and than so many of its
#: standard errors: of its names the training runs were sure, and a second or two of a test is not.
WORSE, WORSE_IN_ERRORS = 0.05, 1.0
#: It is by so much of that, or of its floor, beyond less of its error: of a few slow seconds nothing is sure, and
#: nobody wants a model that leaves half as much again there.
MUCH_WORSE, MUCH_IN_ERRORS = 0.5, 0.5


@dataclass(frozen=True)
class TestChange:
    """Relative change of the held-out mean square error that an effect brings (negative: better), its standard error,
    and whether that contradicts the name beyond uncertainty. ``per_joint`` (n,) relative change on each joint; of one
    joint ``alone`` where that is what contradicts."""

    relative: float
    error: float
    contradicts: bool
    per_joint: Array
    alone: bool = False


def test_change(judge: Judge, tests: Sequence[Run], full: Model, without: Model, names: int) -> TestChange:
    """Compare two models on ``tests``, over rows in which the joint moves.

    A joint counts by what both leave of it, or by its floor where they leave less: by floors alone one whose floor is
    tiny, and whose misfit is many of these, would speak for all the others.
    ``names``: how many are asked; of so many, one is contradicted by chance no more often than a single one would be.
    """
    new, old = (moving_errors(m, tests) for m in (full, without))
    left = np.sum([0.5 * np.sum(e**2, axis=0) for part in (new, old) for e in part], axis=0)
    counted = np.maximum(left, judge.floor**2 * np.sum([run.mask.sum(axis=0) for run in tests], axis=0))
    weights = np.where(judge.evidence.weights > 0, 1.0 / np.maximum(counted, 1e-300), 0.0)
    return change_of(judge, new, old, tests, weights, names)


def moving_errors(model: Model, runs: Sequence[Run]) -> list[Array]:
    """What ``model`` leaves of the torque (K, n) [N m] of every run; 0 in rows in which the joint does not move."""
    return [(run.tau - predict_run(model, run)) * run.mask for run in runs]


def _squares(left: Sequence[Array]) -> Array:
    """(n,) squared sums [N m]^2 of what is ``left`` (K, n) [N m] of every run."""
    return np.asarray(np.sum([np.sum(e**2, axis=0) for e in left], axis=0))


def change_of(
    judge: Judge, new: Sequence[Array], old: Sequence[Array], tests: Sequence[Run], weights: Array, names: int
) -> TestChange:
    """:func:`test_change` between what two models leave of ``tests``, the joints weighed by ``weights`` (n,)."""
    after, before = _squares(new), _squares(old)
    change, size = float((after - before) @ weights), max(float(before @ weights), 1e-300)
    spread, blocks = difference_error(new, old, [run.time for run in tests], judge.settings.block, weights)
    level = float(student.ppf(1.0 - judge.settings.confirmation / max(names, 1), max(blocks - 1, 1)))
    return TestChange(
        change / size,
        spread / size,
        change > level * spread and change > PRACTICAL * float(after @ weights),
        (after - before) / np.maximum(before, 1e-300),
    )


@dataclass(frozen=True)
class Confirmation:
    """``changes`` per term; ``refused``: terms in the order in which the test runs spoke against them, then those that
    were known beside these alone (``unknown``); ``at_rest``: of the refused those that ask too much of joints that only
    stand in the test runs; ``guesses``: what stood beside the names and by which joints (their numbers) ended worse
    than they began; ``model`` without all of them, re-fitted; it lists the names as inactive; ``other``: in
    which way the test runs look like those of another set-up (:mod:`.other_setup`), if they do."""

    changes: dict[Term, TestChange]
    refused: tuple[Term, ...]
    model: Model
    unknown: tuple[Term, ...] = ()
    at_rest: tuple[Term, ...] = ()
    guesses: tuple[tuple[Term, tuple[int, ...]], ...] = ()
    other: str = ""


def confirm(
    judge: Judge, base: Model, full: Model, found: Found, tests: Sequence[Run], candidates: Sequence[Term] = ()
) -> Confirmation:
    """Ask the test runs about every name in ``full``, the model of what was ``found`` on top of ``base``.

    What was only guessed goes first where a joint ends worse by it. Then the most contradicted name goes and the rest
    are asked again without it. A joint that still ends worse than it began loses the names that make it so: its own,
    and those of others that help neither theirs nor the whole. So does one that only stands in the test runs, of which
    the model asks more then than friction holds. What is contradicted may have stood for friction of ``candidates``,
    which is estimated in its place then. A name of one joint is asked
    of that joint alone, too (:func:`_harm_to_its_joint`).
    """
    own, model, guesses = _without_guesses(judge, base, found, found.terms, full, tests)
    changes: dict[Term, TestChange] = {}
    kept, refused = list(found.terms), list[Term]()
    names = len(kept)
    while kept:
        asked: dict[Term, TestChange] = {}
        for s in kept:
            without = _without(own, kept, s)
            change = test_change(judge, tests, model, without, names)
            asked[s] = replace(change, contradicts=change.contradicts and not _helps_its_joint(s, change))
            if not asked[s].contradicts:
                asked[s] = _harm_to_its_joint(judge, tests, model, without, s, names) or asked[s]
            changes.setdefault(s, asked[s])
        against = [s for s in kept if asked[s].contradicts] or _worse_joints(judge, base, model, kept, asked, tests)
        if not against:
            break
        worst = max(against, key=lambda s: (asked[s].relative, repr(s)))
        changes[worst] = asked[worst]
        kept.remove(worst)
        refused.append(worst)
        model = own.model(kept)
    at_rest: list[Term] = []
    while (most := asks_too_much(base, model, kept, lambda s: _without(own, kept, s), tests, judge)) is not None:
        kept.remove(most)
        at_rest.append(most)
        model = own.model(kept)
    refused += at_rest
    unknown: list[Term] = []
    spared: list[Term] = []
    while refused and (lost := _unknown(own, kept, model, spared)) is not None:
        without = own.model([s for s in kept if s != lost])
        change = test_change(judge, tests, model, without, 1)
        if change.relative < -change.error:
            # The training runs know nothing of it by itself, and the test runs do.
            spared.append(lost)
            continue
        kept.remove(lost)
        unknown.append(lost)
        model = without
    refused += unknown
    if refused:
        # What has gone as a guess is not guessed again.
        offered = [c for c in candidates if not any(same_place(c, guess.as_finding) for guess, _ in guesses)]
        own, model = _filled(judge, base, own, kept, model, tests, offered)
        _, model, further = _without_guesses(judge, base, own, kept, model, tests)
        guesses += further
    inactive = [e for s, e in zip(found.terms, found.named(full), strict=True) if s in refused]
    model = model.with_inactive(inactive)
    return Confirmation(changes, tuple(refused), model, tuple(unknown), tuple(at_rest), tuple(guesses))


def _without_guesses(
    judge: Judge, base: Model, found: Found, kept: Sequence[Term], model: Model, tests: Sequence[Run]
) -> tuple[Found, Model, list[tuple[Term, tuple[int, ...]]]]:
    """What is ``found``, and the ``model`` of ``kept`` names, without guesses by which joints end worse than they began
    (:func:`~.guessed.without_wrong`), and these.

    Guesses are asked before names: of them nobody was sure, and with a name gone links that are held loosely bend until
    they make its torque, on every joint. (Found on six seconds of a Kinova Gen3: the friction of a wrist was refused,
    and four other joints were left with two to six times as much.)
    """
    model, gone = without_wrong(
        found,
        kept,
        model,
        lambda m: ends_worse(judge, base, m, tests),
        lambda m: _squares(moving_errors(m, tests)),
    )
    if not gone:
        return found, model, []
    left = [t for t in found.beside if not any(t == guess for guess, _ in gone)]
    return replace(found, beside=left), model, gone


def _without(found: Found, kept: Sequence[Term], term: Term) -> Model:
    """The model of ``kept`` names but ``term``, re-fitted."""
    return found.model([o for o in kept if o != term], False)


def _unknown(found: Found, kept: Sequence[Term], model: Model, spared: Sequence[Term]) -> Term | None:
    """The least sure name of ``kept`` of which nothing is known in ``model``, which has these alone, and which is not
    ``spared``. Where runs disagree nothing was re-fitted."""
    if found.inconsistent:
        return None
    first = len(found.start.effects)
    own = zip(kept, model.effects[first : first + len(kept)], strict=True)
    return known.unknown({s: e for s, e in own if s not in spared}, found.judge.evidence.robot)


def _filled(
    judge: Judge,
    base: Model,
    found: Found,
    kept: Sequence[Term],
    model: Model,
    tests: Sequence[Run],
    candidates: Sequence[Term],
) -> tuple[Found, Model]:
    """``model`` of the ``kept`` names with what stands beside these, which is not what stood beside all, and nothing
    that is refused, and what was found as that; ``model`` itself where the test runs are not predicted better so, or a
    joint ends worse than in ``base`` that did not."""
    if found.inconsistent or not kept:
        return found, model
    refused = [t for t in found.terms if t not in kept]
    # Links that a refused body is one of are not guessed in its place.
    offered = [
        c for c in candidates if not any(same_place(c, r) or (covers(c, r) and c.family().all_links) for r in refused)
    ]
    unsure = [t.as_finding for t in found.beside if t.joint is not None and not t.family().like_weight]
    judge, beside = all_beside(judge.at(kept), kept, offered, unsure)
    beside = [t for t in beside if not any(same_place(t.as_finding, r) for r in refused)]
    judge, _, beside = known.with_links(judge, kept, beside, offered, kept)
    filled = replace(found, terms=list(kept), judge=judge, beside=beside)
    other = filled.model(kept)
    # Of these nobody was sure: what shows of a loss is enough.
    ends = [test_change(judge, tests, m, base, 1).per_joint > WORSE for m in (other, model)]
    better = test_change(judge, tests, other, model, 1).relative < 0
    return (filled, other) if better and not np.any(ends[0] & ~ends[1]) else (found, model)


def _helps_its_joint(term: Term, change: TestChange) -> bool:
    """True where an effect of one joint makes that joint better on the test runs.

    What gets worse elsewhere is then a body's doing, which the re-fit without the effect moved.
    """
    if term.joint is None or term.family().changes_body:
        return False
    return bool(change.per_joint[term.joint] < -PRACTICAL)


def _harm_to_its_joint(
    judge: Judge, tests: Sequence[Run], full: Model, without: Model, term: Term, names: int
) -> TestChange | None:
    """What ``term``, one of ``names`` that are asked, does to the only joint on which it acts, where it makes that
    joint worse on the test runs: by :data:`WORSE` beyond uncertainty, at half the level of all joints together (it is
    the second question), or :data:`~.known.WRONG` times as bad (mean square) beyond that of a single question. None
    where it does not, or where the joint hardly moves in them.

    Among all joints it may drown: what a re-fit without it moves elsewhere says nothing of it. (Found on eight seconds
    of a Baxter, runs exchanged: a spring of a wrist that left eight times as much as none.)
    """
    acts = judge.adding([term]).evidence.acts(term)
    rows = np.sum([run.mask.sum(axis=0) for run in tests], axis=0)
    if acts.sum() != 1 or rows @ acts < FEWEST_ROWS:
        return None
    new, old = (moving_errors(m, tests) for m in (full, without))
    # Where no more than the floor is left a change of it is no harm.
    harm = float((_squares(new) - _squares(old)) @ acts)
    least = float(np.maximum(_squares(old), judge.floor**2 * rows) @ acts)
    often, once = (change_of(judge, new, old, tests, acts.astype(float), many) for many in (2 * names, 1))
    wrong = once.contradicts and harm > (known.WRONG - 1.0) * least and once.relative > SURELY * once.error
    spoils = (often.contradicts and harm > WORSE * least) or wrong
    return replace(once, contradicts=True, alone=True) if spoils else None


def ends_worse(judge: Judge, base: Model, model: Model, tests: Sequence[Run]) -> NDArray[np.bool_]:
    """(n,) joints of which ``model`` leaves more of ``tests`` (mean square) than ``base``: by :data:`WORSE` and beyond
    its error, or by :data:`MUCH_WORSE` and beyond half of that, of joints that move in :data:`~.floor.FEWEST_ROWS`."""
    new, old = (moving_errors(m, tests) for m in (model, base))
    alone = [change_of(judge, new, old, tests, own, 1) for own in np.eye(judge.evidence.n)]
    change, error = (np.array([getattr(c, key) for c in alone]) for key in ("relative", "error"))
    rows = np.sum([run.mask.sum(axis=0) for run in tests], axis=0)
    least = np.maximum(_squares(old), judge.floor**2 * rows)
    much = (_squares(new) - _squares(old) > MUCH_WORSE * least) & (change > MUCH_IN_ERRORS * error)
    return np.asarray((change > np.maximum(WORSE, WORSE_IN_ERRORS * error)) | (much & (rows >= FEWEST_ROWS)))


def _worse_joints(
    judge: Judge,
    base: Model,
    model: Model,
    kept: Sequence[Term],
    asked: dict[Term, TestChange],
    tests: Sequence[Run],
) -> list[Term]:
    """Names that make a joint end surely worse than it began: its own, and those of other joints that help neither
    theirs nor the whole."""
    worse = np.flatnonzero(ends_worse(judge, base, model, tests))

    def harms(s: Term) -> bool:
        if s.joint in worse and asked[s].per_joint[s.joint] > PRACTICAL:
            return True
        helps = asked[s].relative <= 0 or _helps_its_joint(s, asked[s])
        return bool(np.any(asked[s].per_joint[worse] > PRACTICAL)) and not helps

    return [s for s in kept if harms(s)]
