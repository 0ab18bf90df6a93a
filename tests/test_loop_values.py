"""Evidence is a value: what is asked of it depends on it alone, not on what has been fitted in between."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop.augment import effects_of, refit
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.find import find
from hybrid_dynamics.loop.held import Held
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.sums import FoldSums
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.simulation.excitation import excitations
from hybrid_dynamics.types import Array

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
LATE, GAIN, GREASE, DRY = (
    Term("time_delay"),
    Term("torque_gain", 0),
    Term("load_dependent_friction", 0),
    Term("coulomb_friction", 1),
)
ZERO, MASS = Term("position_offset", 0), Term("link_mass", 1)
HIDDEN = (
    Effect("time_delay", (), {"delay": 0.01}),
    Effect("load_dependent_friction", (SHOULDER,), {"load_coefficient": 0.08}),
    Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 0.6}),
    Effect("link_mass", (ELBOW,), {"mass": 1.0}),
)
#: Linear and not, with and without columns that follow the model.
MODELS = ([DRY], [GREASE, DRY], [LATE, GREASE, DRY], [GAIN, DRY], [ZERO, GREASE], [MASS, GREASE, LATE])


def judged() -> tuple[Judge, list[Term]]:
    settings = LoopSettings()
    train, test = excitations(ROBOT, HIDDEN, train=2, test=1, duration=6.0, rate=200.0)
    judge, terms, _ = gather(Model(ROBOT), read_motion(ROBOT, train, test, settings), settings)
    return judge.adding([term for model in MODELS for term in model]), terms


@pytest.fixture(scope="module")
def evidence() -> Evidence:
    return judged()[0].evidence


def answers(evidence: Evidence) -> list[Array]:
    """What ``evidence`` says of all :data:`MODELS`."""
    out = []
    for terms in MODELS:
        held = evidence.held(terms, physical=True)
        out += [held.joint_errors, *held.coordinates, evidence.fit(terms), evidence.fit(terms, physical=False)]
        out += [evidence.covariance(terms, evidence.fit(terms)), *evidence.residuals(terms, evidence.fit(terms))]
    return out


def content(evidence: Evidence) -> list[Array]:
    """Copies of all that ``evidence`` holds."""
    sums = evidence.sums
    gram = [g.pick(np.arange(g.size), np.arange(g.size)) for g in evidence.gram]
    arrays = [*gram, *sums.full, *sums.own, *sums.others, *evidence.target, *evidence.mask, evidence.weights]
    return [np.array(a) for a in (*arrays, evidence.folds.of_block, evidence.count)]


def same(one: Sequence[Array], other: Sequence[Array]) -> bool:
    return len(one) == len(other) and all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("start", [[], [LATE, GREASE, DRY]], ids=["start", "delay"])
def test_answers_are_the_same_whatever_was_fitted_in_between(start: list[Term]) -> None:
    # Two that are built alike: one is asked at once, the other after everything else has been fitted.
    asked, later = (refit(judged()[0].evidence, start).evidence for _ in range(2))
    first = answers(asked)
    for terms in MODELS:
        fitted = refit(later, terms).evidence
        fitted.held(MODELS[2], physical=True)
        refit(fitted, MODELS[3])
    assert same(answers(later), first)
    assert same(answers(asked), first)
    # Control: elsewhere the same question has another answer, so there was something to spoil.
    assert not same(answers(refit(later, MODELS[5]).evidence), first)


def test_columns_made_when_asked_for_are_those_of_the_model_whoever_is_asked_first(evidence: Evidence) -> None:
    one, other = (refit(evidence, [MASS, LATE]).evidence for _ in range(2))
    first = one.held([GREASE]).joint_errors
    other.held([LATE, GAIN])
    other.held([MASS])
    np.testing.assert_array_equal(other.held([GREASE]).joint_errors, first)
    # Control: the load, and with it the column, is another one with the heavier link.
    assert not np.array_equal(evidence.held([GREASE]).joint_errors, first)


def moved(evidence: Evidence) -> Evidence:
    x = np.array([0.3])
    effects = effects_of(evidence, [GREASE], x)
    return evidence.tangent(effects, evidence.problem.left(effects), [GREASE], x)


@pytest.mark.parametrize(
    "change",
    [
        lambda e: e.weigh(np.array([0.5, 0.0])),
        lambda e: e.fold_by_time(),
        lambda e: e.leave_out(1, slice(10, 60)),
        lambda e: e.adding([Term("joint_spring", 0, (("shape", "linear"),)), Term("time_delay", None, ())]),
        lambda e: e.at([Effect("link_mass", (ELBOW,), {"mass": 0.5})], [GREASE]),
        moved,
        lambda e: refit(e, MODELS[2]).evidence,
        lambda e: refit(e, MODELS[1]).evidence,
    ],
    ids=["weigh", "fold", "leave out", "add", "at", "tangent", "refit", "refit, linear"],
)
def test_a_change_makes_another_value(evidence: Evidence, change: Callable[[Evidence], Evidence]) -> None:
    before, said = content(evidence), answers(evidence)
    other = change(evidence)
    assert other is not evidence
    answers(other)
    assert same(content(evidence), before)
    assert same(answers(evidence), said)


def test_what_has_stayed_is_shared_and_not_copied(evidence: Evidence) -> None:
    heavier = evidence.at([Effect("link_mass", (ELBOW,), {"mass": 0.5})], [GREASE])
    assert heavier.gram[0] is not evidence.gram[0]
    assert heavier.gram[1] is evidence.gram[1]
    assert heavier.sums.others[1] is evidence.sums.others[1]
    assert evidence.weigh(np.ones(2)).gram is evidence.gram
    assert evidence.adding([DRY]) is evidence
    # Numbers of columns stay, so what is known of held-out predictions is known of the larger value, too.
    held = evidence.held([DRY])
    assert evidence.adding([Term("joint_spring", 1, (("shape", "linear"),))]).held([DRY]) is held


@pytest.mark.slow
def test_the_same_search_from_the_same_judge_ends_alike() -> None:
    judge, terms = judged()
    found = [find(judge, terms, lambda step: None) for _ in range(2)]
    assert found[0].terms == found[1].terms
    np.testing.assert_array_equal(found[0].x, found[1].x)
    assert found[0].steps == found[1].steps
    models = [f.model(f.terms) for f in (found[0], found[0], found[1])]
    assert models[0].effects == models[1].effects == models[2].effects


def test_a_law_on_its_bound_at_zero_changes_no_score() -> None:
    """To the last digit: what another order of the same sum leaves would look like a sure gain."""
    train, test = excitations(
        arm(), [Effect("torque_offset", ("elbow",), {"offset": 1.0})], train=2, test=1, duration=6.0
    )
    pushed = [run.with_signals(tau=run["tau"] - 0.7 * np.gradient(run["q"], run.dt, axis=0)) for run in train]
    judge, _, _ = gather(Model(arm()), read_motion(arm(), pushed, test, LoopSettings()), LoopSettings())
    rest = [Term(name, j) for name in ("torque_offset", "coulomb_friction", "link_inertia") for j in (0, 1)]
    idle = [Term("viscous_friction", j) for j in (0, 1)]
    evidence = judge.adding([*rest, *idle]).evidence
    grams = np.stack([np.cov(np.random.default_rng(k).normal(size=(40, 400))) for k in range(4)])
    for count in range(1, len(rest) + 1):
        some = rest[:count]
        x = evidence.held([*some, *idle]).coordinates
        assert all(np.all(fold[-2:] == 0.0) for fold in x), "the control: drag that drives is on its bound"
        assert evidence.held([*some, *idle]).score == evidence.held(some).score
    # Of whichever column, and however many there are.
    sums, rng = FoldSums((grams[0],), (grams,), (grams,), np.empty(0)), np.random.default_rng(0)
    for size in range(3, 38):
        columns, folds = np.arange(size), rng.normal(size=(4, size))
        whole = Held.of(sums, [(np.arange(size), columns)], folds, np.ones(1)).score
        at = int(rng.integers(size + 1))
        wider = np.insert(folds, at, 0.0, axis=1)
        with_idle = Held.of(sums, [(np.arange(size + 1), np.insert(columns, at, 38))], wider, np.ones(1)).score
        assert with_idle == whole
