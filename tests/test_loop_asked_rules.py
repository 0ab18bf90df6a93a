"""Rules of a line each of what is asked: pairs that do together, groups of few causes, rivals, where something is left.

Found by turning operators into their opposites: each of these tests fails where its line says the contrary.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log
from tests.test_loop_boxes import DT, stretch

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.identification.estimate import jackknife
from hybrid_dynamics.loop import LoopSettings, Model, close_loop
from hybrid_dynamics.loop import confirm as confirm_module
from hybrid_dynamics.loop import further as further_module
from hybrid_dynamics.loop.boxes import ALIKE, Interval, _beside, _jumps, _return
from hybrid_dynamics.loop.confirm import confirm
from hybrid_dynamics.loop.described import with_described
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.further import EXCESS, _promising, further_candidates
from hybrid_dynamics.loop.likeness import Likeness
from hybrid_dynamics.loop.narrow import _by_size
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.scale import gain_families
from hybrid_dynamics.loop.search import LIKENESS_OF_RIVAL, _rivals
from hybrid_dynamics.loop.solve import Constraints
from hybrid_dynamics.loop.trace import Judge

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
SPRING = Term("joint_spring", 1, (("shape", "linear"),))
GAIN = Term("torque_gain", 1)


def wave(harmonic: float) -> Term:
    return Term("torque_ripple", 1, (("harmonic", harmonic),))


class Scores:
    """Stands for the evidence: the held-out score of every set of terms, ``plain`` where nothing is told of it."""

    def __init__(self, told: dict[frozenset[Term], float], plain: float = 10.0) -> None:
        self.told, self.plain = told, plain

    def held(self, terms: Any, physical: bool = False) -> Any:
        return SimpleNamespace(score=self.told.get(frozenset(terms), self.plain))


def judge_of(evidence: Any) -> Judge:
    return Judge(cast(Evidence, evidence), LoopSettings(), np.ones(2), np.ones(2), np.zeros(2), np.zeros(2))


@pytest.mark.parametrize(
    ("one", "other", "together"),
    [(SPRING, GAIN, True), (SPRING, wave(9.0), False), (wave(9.0), wave(18.0), True)],
)
def test_two_laws_count_together_and_so_do_two_waves_but_no_wave_and_a_law(
    one: Term, other: Term, together: bool
) -> None:
    judge = judge_of(Scores({frozenset([one, other]): 1.0}))
    assert set(_promising(judge, [], [one, other], 9)) == ({one, other} if together else set())


def test_groups_of_three_hold_the_best_two_and_one_more() -> None:
    causes = [Term("torque_offset", 0), Term("torque_offset", 1), Term("armature", 0), Term("armature", 1)]
    best = tuple(causes[:2])
    evidence = cast(Evidence, Scores({frozenset(best): 1.0}))
    sizes = [set(map(len, groups)) for groups in _by_size(evidence, [], causes, [])]
    assert sizes[:2] == [{1, 2}, {3}]
    threes = list(_by_size(evidence, [], causes, []))[1]
    assert all(group in threes for group in ((*best, causes[2]), (*best, causes[3])))


@pytest.mark.parametrize("order", [1, -1])
def test_of_two_rivals_at_one_place_the_liker_one_is_asked(order: int) -> None:
    there = Term("viscous_friction", 1)
    shares = {wave(9.0): 0.5 + 0.5 * LIKENESS_OF_RIVAL, wave(10.0): 1.0, Term("armature", 1): 0.9 * LIKENESS_OF_RIVAL}

    class Told:
        def share(self, term: Term) -> float:
            return shares[term]

    # A place holds one: the waves are of one place where their family allows no second.
    rivals = [replace(t, effect="stribeck_friction") for t in (wave(9.0), wave(10.0))]
    shares |= {rivals[0]: shares[wave(9.0)], rivals[1]: shares[wave(10.0)]}
    asked = _rivals({there: cast(Likeness, Told())}, [there], [], [*rivals[::order], Term("armature", 1)])
    assert asked == [rivals[1]]


def test_by_which_a_torque_is_read_too_large_no_wrong_zero_is_one() -> None:
    names = {kind.name for kind in gain_families(LoopSettings())}
    assert "torque_gain" in names
    # It reads wrongly, but not the torque; this one's torque follows the load, which is no reading.
    assert not names & {"position_offset", "load_dependent_friction"}


@pytest.mark.parametrize(("excess", "asked"), [(0.5 * EXCESS, False), (2.0 * EXCESS, True)])
def test_further_families_are_asked_where_more_than_noise_is_left(
    excess: float, asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = LoopSettings(effects=())
    logs = read_motion(ROBOT, [noisy_log([], k, "train", 0.1) for k in (1, 2)], [], settings)
    judge, _, _ = gather(Model(ROBOT), logs, settings)
    held = judge.mean_square(judge.evidence.held([], physical=True))
    low = np.sqrt(held / (1.0 + excess))
    monkeypatch.setattr(further_module, "difference_floor", lambda *a: low)
    offered: list[Any] = []

    def promising(there: Judge, chosen: Any, terms: list[Term], most: int) -> list[Term]:
        offered.extend(terms)
        return terms

    monkeypatch.setattr(further_module, "_promising", promising)
    further_candidates(replace(judge, low=low), [])
    # What passes for noise, a fast ripple, is asked whatever is left.
    assert any(not t.family().like_noise for t in offered) is asked


def test_a_box_is_looked_for_where_other_effects_are_taken_off() -> None:
    """What the columns of other effects explain elsewhere is no return of the box."""
    push, again, height = slice(300, 400), slice(700, 800), 5.0
    states = 10.0 + np.arange(1000.0)[:, None]
    states[again] = states[push] + 0.5 * ALIKE
    law = np.zeros((1000, 1))
    # Elsewhere, too, so that its coefficient is known; where the states come back it makes what the box does.
    law[again], law[100:200] = 1.0, 1.0
    box = [Interval(None, push.start, push.stop)]
    run = stretch(1000, (push.start, push.stop, height), (again.start, again.stop, height), (100, 200, height))
    explained = replace(run, columns=law, states=states)
    assert not _return(_beside([explained], box), box, DT)
    # Control: without that law it is back.
    plain = replace(run, columns=np.zeros((1000, 0)), states=states)
    assert _return(_beside([plain], box), box, DT)


def test_a_change_of_the_urdfs_friction_is_told_once_in_its_total() -> None:
    described = [Effect("viscous_friction", (ELBOW,), {"viscous_coefficient": 2.0})]
    hidden = [Effect("viscous_friction", (ELBOW,), {"viscous_coefficient": 0.8})]
    settings = LoopSettings(effects=("viscous_friction", "coulomb_friction"), sign_widths=(0.0,))
    train = [noisy_log(hidden, k, "train", 0.05) for k in (1, 2)]
    told = close_loop(ROBOT, train, [noisy_log(hidden, 5, "test", 0.05)], settings, described=described)
    own = "viscous_friction of elbow: 0.8 since the starting model, of its 2"
    other = "something else"
    result = replace(told, diagnosis=replace(told.diagnosis, notes=(own, other)))
    notes = with_described(result, described).diagnosis.notes
    assert other in notes
    assert own not in notes


def test_what_was_known_beside_a_contradicted_name_alone_goes_and_the_rest_stays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    contradicted, leaning, sure = (Term(name, 1) for name in ("torque_offset", "coulomb_friction", "armature"))

    def model(kept: list[Term], covariance: bool = True) -> Any:
        own = SimpleNamespace(kept=list(kept))
        own.with_inactive = lambda inactive: own
        return own

    found: Any = SimpleNamespace(terms=[contradicted, leaning, sure], model=model, named=lambda full: [None] * 3)

    def asked(judge: Any, tests: Any, full: Any, without: Any, names: int) -> Any:
        gone = set(full.kept) - set(without.kept)
        return confirm_module.TestChange(
            0.5 if contradicted in gone else -0.001, 0.01, contradicted in gone, np.zeros(2)
        )

    monkeypatch.setattr(confirm_module, "test_change", asked)
    monkeypatch.setattr(confirm_module, "_harm_to_its_joint", lambda *a: None)
    monkeypatch.setattr(confirm_module, "_worse_joints", lambda *a: [])
    monkeypatch.setattr(confirm_module, "asks_too_much", lambda *a: None)
    monkeypatch.setattr(
        confirm_module, "_unknown", lambda found, kept, model, spared: leaning if leaning in kept else None
    )
    monkeypatch.setattr(confirm_module, "_filled", lambda judge, base, found, kept, model, *rest: (found, model))
    monkeypatch.setattr(confirm_module, "without_wrong", lambda own, kept, model, *rest: (model, ()))
    nothing: Any = None
    said = confirm(nothing, nothing, model(found.terms), found, [])
    assert said.refused == (contradicted, leaning)
    assert said.unknown == (leaning,)
    assert cast(Any, said.model).kept == [sure]


@pytest.mark.parametrize(("left", "moving", "mostly"), [(1, 1, False), (2, 2, True), (2, 6, False), (4, 6, True)])
def test_most_joints_are_left_with_something_where_more_than_half_are_and_two_at_least(
    left: int, moving: int, mostly: bool
) -> None:
    judge = SimpleNamespace(floor=np.array([1.0] * moving + [0.0]), above_floor=lambda held: np.arange(7) < left)
    assert Judge.mostly_left(cast(Any, judge), cast(Any, None)) is mostly


def test_coordinates_that_one_line_holds_together_are_coupled() -> None:
    apart = Constraints(np.zeros(2))
    assert not apart.coupled
    assert replace(apart, rows=np.ones((1, 2)), least=np.zeros(1)).coupled


def test_rows_near_a_jump_have_no_say_in_it() -> None:
    """From -2 to 3 between rows 49 and 50; what the filter makes of it next to it, here a spike, is left out."""
    seen = np.where(np.arange(100) < 50, -2.0, 3.0)
    seen[47:53] = 90.0
    jump = _jumps(seen, np.ones(100, bool), near=3, reach=10)
    assert jump[50] == pytest.approx(5.0)
    # Elsewhere nothing changes, and at the ends nobody knows.
    assert jump[20] == jump[80] == 0.0
    assert np.isnan(jump[[0, 1, 99, 100]]).all()
    # Each side is an average of ten rows whose middle is eight away.
    ramp = _jumps(np.arange(100.0), np.ones(100, bool), near=3, reach=10)
    assert ramp[50] == pytest.approx(2 * 3 + 10)


def test_leaving_out_one_block_after_the_other_gives_the_error_of_a_mean() -> None:
    """Of equal blocks: the scatter of their means over the square root of their number."""
    y = np.random.default_rng(3).normal(4.0, 1.0, size=(12, 30))
    grams = np.array([[[30.0, own.sum()], [own.sum(), own @ own]] for own in y])
    expected = np.std(y.mean(axis=1), ddof=1) / np.sqrt(12)
    assert jackknife(grams) == pytest.approx([expected], rel=1e-9)


def test_a_joint_that_leaves_less_than_its_floor_counts_by_its_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    """By what it leaves, a change of nearly nothing to twice that would outweigh the gain of another joint."""
    rows = 2000
    signs = np.where(np.arange(rows) % 2, 1.0, -1.0)[:, None]
    # With the name the second joint, noisy, is a sixth better; what the first leaves of its floor of one grows.
    left = {"with": signs * [0.02, 1.0], "without": signs * [0.01, 1.2]}
    run = SimpleNamespace(time=0.01 * np.arange(rows), mask=np.ones((rows, 2), bool))
    monkeypatch.setattr(confirm_module, "moving_errors", lambda model, runs: [left[model]])
    judge: Any = SimpleNamespace(
        floor=np.ones(2), evidence=SimpleNamespace(weights=np.ones(2)), settings=LoopSettings()
    )
    change = confirm_module.test_change(judge, [cast(Any, run)], cast(Any, "with"), cast(Any, "without"), 1)
    assert change.relative < 0
    assert not change.contradicts
    # Control: where the floor is as little as what is left, the first joint has as much to say.
    judge.floor = np.full(2, 1e-3)
    assert confirm_module.test_change(judge, [cast(Any, run)], cast(Any, "with"), cast(Any, "without"), 1).relative > 0
