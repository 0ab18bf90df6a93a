"""Rules of the search of a line each: what is let go of, what is common, who is asked again, what is tried twice."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log
from tests.test_loop_trace import CURVED, LARGE, NOISE, OTHER, SMALL, VISCOUS, Told
from tests.test_loop_trace import judge as told_judge

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop import LoopSettings, Model, prune
from hybrid_dynamics.loop import find as find_module
from hybrid_dynamics.loop.alternatives import _Named, indistinguishable
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.find import LOUD, _refined, beside_loud
from hybrid_dynamics.loop.held import Held
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.search import _lighter, _useless
from hybrid_dynamics.loop.trace import Gain, Judge, rank
from hybrid_dynamics.simulation.excitation import excitations

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
SETTINGS = LoopSettings(sign_widths=(0.0,))


def judged(effects: list[Effect], noise: float) -> tuple[Judge, list[Term]]:
    logs = read_motion(
        ROBOT, [noisy_log(effects, 1, "train", noise)], [noisy_log(effects, 51, "test", noise)], SETTINGS
    )
    judge, terms, _ = gather(Model(ROBOT), logs, SETTINGS)
    return judge, terms


#: Stands beside terms for "with bodies held so".
HELD = Term("held", None)


@dataclass
class Bodies(Told):
    """What is told, with sets of terms that ask for what cannot be, and what those leave where bodies are held so."""

    held_so: dict[frozenset[Term], np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.residuals = self.residuals | {frozenset([*k, HELD]): v for k, v in self.held_so.items()}
        super().__post_init__()

    def held(self, terms: Any, physical: bool = False) -> Held:
        so = physical and frozenset(terms) in self.held_so
        return super().held([*terms, HELD] if so else terms)

    def constrained(self, terms: Any) -> bool:
        return frozenset(terms) in self.held_so


def bodies(residuals: dict[frozenset[Term], np.ndarray], held_so: dict[frozenset[Term], np.ndarray]) -> Judge:
    evidence = cast(Evidence, Bodies(residuals, held_so=held_so))
    return Judge(evidence, LoopSettings(), np.ones(1), np.ones(1), np.zeros(1), np.zeros(1))


BOTH = frozenset([VISCOUS, CURVED])


def test_what_only_a_body_that_cannot_be_does_without_is_not_let_go_of() -> None:
    told = {BOTH: NOISE, frozenset([CURVED]): NOISE, frozenset([VISCOUS]): NOISE + 3 * LARGE}
    assert _useless(bodies(told, {}), [VISCOUS, CURVED], ()) == VISCOUS
    held_so = {frozenset([CURVED]): NOISE + 3 * LARGE}
    assert _useless(bodies(told, held_so), [VISCOUS, CURVED], ()) is None


def test_what_only_helps_by_making_a_body_that_cannot_be_is_let_go_of() -> None:
    little = NOISE + np.sqrt(0.2) * LARGE
    told = {BOTH: NOISE, frozenset([CURVED]): little, frozenset([VISCOUS]): NOISE + 3 * LARGE}
    assert _useless(bodies(told, {}), [VISCOUS, CURVED], ()) is None
    assert _useless(bodies(told, {BOTH: little}), [VISCOUS, CURVED], ()) == VISCOUS


def test_a_table_of_candidates_holds_each_once_the_chosen_first() -> None:
    told: dict[frozenset[Term], np.ndarray] = {frozenset(): NOISE + 3 * LARGE + SMALL}
    told |= {frozenset([t]): NOISE + size * SMALL for t, size in ((CURVED, 0.0), (VISCOUS, 2.0), (OTHER, 1.0))}
    judge = told_judge(told)
    table = rank(judge, [], [VISCOUS, CURVED, OTHER], judge.evidence.held([]))
    # The others by what they leave.
    assert [c.term for c in table] == [CURVED, OTHER, VISCOUS]


def test_a_body_gives_way_to_a_pair_that_was_not_tried_before() -> None:
    rotors = [Effect("armature", (name,), {"armature": 0.3}) for name in ROBOT.joint_names]
    train, test = excitations(ROBOT, rotors, train=2, test=1, duration=6.0, rate=200.0)
    judge, terms, _ = gather(Model(ROBOT), read_motion(ROBOT, train, test, SETTINGS), SETTINGS)
    body = next(t for t in terms if t.effect == "link_inertia")
    before = judge.evidence.held([body], physical=True)
    pair = _lighter(judge, [body], terms, before, set())
    assert pair is not None
    assert {(t.effect, t.joint) for t in pair} == {("armature", 0), ("armature", 1)}
    other = _lighter(judge, [body], terms, before, {frozenset(pair)})
    assert other is None or set(other) != set(pair)


def gain(total: float, error: float = 1.0) -> Gain:
    return Gain(total, error, np.array([total, 0.0]), 40)


def common(planted: float, which: tuple[int, ...]) -> set[str]:
    """Which families are common where no joint is sure alone, of viscous friction ``planted`` on both joints."""
    grease = [Effect("viscous_friction", (name,), {"viscous_coefficient": planted}) for name in ROBOT.joint_names]
    judge, terms = judged(grease, 0.1)
    named = [t for t in terms if t.effect == "viscous_friction" and t.joint in which]
    return prune._common(judge, named, {t: gain(1.5) for t in named}, looked=20)


def test_a_family_is_common_where_its_joints_are_sure_together_and_not_alone() -> None:
    assert common(0.5, (0, 1)) == {"viscous_friction"}
    # Nothing is there; one joint is no family.
    assert common(0.0, (0, 1)) == set()
    assert common(0.5, (0,)) == set()


@pytest.mark.parametrize(
    ("size", "worth", "kept"),
    [(6.0, 0.5, True), (6.0, -0.5, True), (6.0, -1.5, False), (1.0, 0.5, False)],
)
def test_of_a_common_family_a_joint_keeps_what_is_sure_and_costs_nothing(
    size: float, worth: float, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``size`` of the coefficient and ``worth`` of its gain in their standard errors: it must be sure, and no loss."""
    judge, terms = judged([], 0.1)
    (term,) = (t for t in terms if t.effect == "load_dependent_friction" and t.joint == 0)
    monkeypatch.setattr(prune, "_common", lambda *_: {term.effect})
    monkeypatch.setattr(prune, "_forced", lambda *_: set())
    monkeypatch.setattr(prune, "in_errors", lambda *_: {term: size})
    monkeypatch.setattr(Judge, "worth", lambda *_, **__: gain(worth))
    chosen = prune.keep_sure(judge, [term], 20, lambda step: None)[1]
    assert chosen == ([term] if kept else [])


@pytest.mark.parametrize(
    ("floor", "left", "asked"),
    [
        # What is left in floors: alike on both joints, however unlike the floors are.
        ([0.01, 1.0], [0.03, 3.0], False),
        ([0.01, 1.0], [0.03, 3.0 * 0.9 * LOUD], False),
        ([0.01, 1.0], [0.03, 3.0 * 1.1 * LOUD], True),
        ([1.0, 1.0], [5.0, 1.0], True),
        # Less than a floor is a floor; a joint without one has no say.
        ([1.0, 1.0], [0.1, 1.0], False),
        ([1.0, 0.0], [1.0, 50.0], False),
        ([0.0, 0.0], [1.0, 50.0], False),
    ],
)
def test_joints_are_weighed_anew_where_one_leaves_many_more_floors_than_another(
    floor: list[float], left: list[float], asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    weighed: list[np.ndarray] = []

    @dataclass(frozen=True)
    class Asked:
        floor: np.ndarray
        evidence: Any

        def mean_square(self, held: object) -> np.ndarray:
            return np.array(left) ** 2

    evidence = SimpleNamespace(held=lambda *_, **__: None, weigh=lambda w: weighed.append(w))
    monkeypatch.setattr("hybrid_dynamics.loop.find._refined", lambda judge, chosen, *_: (judge, list(chosen), []))
    monkeypatch.setattr("hybrid_dynamics.loop.find.choose", lambda ends: ends[0])
    judge: Any = Asked(np.array(floor), evidence)
    assert beside_loud(judge, [VISCOUS], [], lambda step: None)[1:] == ([VISCOUS], [])
    assert bool(weighed) == asked
    if asked:
        np.testing.assert_allclose(weighed[0], np.maximum(floor, left))


def test_what_ends_where_no_such_law_is_makes_room_for_another_of_its_joint() -> None:
    """A wave of less than a period over the range seen is no ripple; what is nearest to it of other laws comes in."""
    wave = Effect("torque_ripple", (ELBOW,), {"amplitude": 3.0, "harmonic": 0.5, "phase": 0.8})
    judge, terms = judged([wave, Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 2.0})], 0.2)
    offered = [t for t in terms if t.effect in ("coulomb_friction", "viscous_friction", "torque_offset")]
    dry = next(t for t in offered if t.effect == "coulomb_friction" and t.joint == 0)
    near = Term("torque_ripple", 1, (("harmonic", 0.6),))
    found = _refined(judge.adding([near]), [near, dry], offered, lambda step: None)[1]
    assert {(t.effect, t.joint) for t in found} == {("coulomb_friction", 0), ("torque_offset", 1)}


def others(effects: list[Effect], name: str) -> set[str]:
    """Single effects of the elbow that are told to stand for one named there, with noise of 0.3 N m."""
    judge, terms = judged(effects, 0.3)
    term = next(t for t in terms if t.effect == name and t.joint == 1)
    listed = indistinguishable(judge.at([term]), [term], terms)[term]
    entries = [entry["effects"] for entry in listed]
    return {of["effect"] for (of, *more) in entries if not more and of["joints"] == [ELBOW]}


def test_in_the_place_of_what_explains_nothing_stands_what_is_like_it() -> None:
    """A constant is like no torque that turns over with the motion, though neither explains any of the noise."""
    of_nothing = others([], "torque_offset")
    assert not of_nothing & {"armature", "coulomb_friction", "viscous_friction"}
    assert {"coulomb_friction", "nonlinear_viscous_friction"} <= others([], "viscous_friction")


def test_a_better_cause_is_told_though_it_is_unlike_where_the_search_rarely_looks_at_it() -> None:
    dry = Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 0.5})
    assert "asymmetric_coulomb_friction" in others([dry], "torque_offset")
    assert "asymmetric_coulomb_friction" not in others([], "torque_offset")


@pytest.mark.parametrize(("errors", "named"), [(0.0, False), (1.5, False), (6.0, True)])
@pytest.mark.parametrize(("name", "parameter"), [("torque_offset", "offset"), ("coulomb_friction", "coulomb_torque")])
def test_what_a_plainer_body_brings_in_is_as_sure_as_all_else(
    name: str, parameter: str, errors: float, named: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An effect of the shoulder of so many of its standard errors, 0.2 N m over the square root of 4000 rows."""
    grease = Effect("viscous_friction", (ELBOW,), {"viscous_coefficient": 1.5})
    judge, terms = judged([grease, Effect(name, (SHOULDER,), {parameter: errors * 0.2 / np.sqrt(4000)})], 0.2)
    term = next(t for t in terms if t.effect == name and t.joint == 0)

    def with_it(judge: Judge, chosen: list[Term], candidates: list[Term]) -> tuple[Judge, list[Term]]:
        both = list(dict.fromkeys([*chosen, term]))
        return judge.at(both), both

    monkeypatch.setattr(find_module, "simplify_bodies", with_it)
    found = find_module.find(judge, terms, lambda step: None)
    assert {(t.effect, t.joint) for t in found.terms} == {("viscous_friction", 1)} | ({(name, 0)} if named else set())


@pytest.mark.parametrize(("size", "worth", "kept"), [(6.0, 2.5, True), (6.0, 1.5, False), (1.0, 2.5, False)])
def test_what_every_joint_has_needs_a_sure_coefficient_and_a_gain(
    size: float, worth: float, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of friction in a model of its own: two standard errors of gain, however many were looked at."""
    judge, terms = judged([], 0.1)
    (term,) = (t for t in terms if t.effect == "viscous_friction" and t.joint == 0)
    monkeypatch.setattr(prune, "_common", lambda *_: set())
    monkeypatch.setattr(prune, "_forced", lambda *_: set())
    monkeypatch.setattr(prune, "in_errors", lambda *_: {term: size})
    monkeypatch.setattr(Judge, "worth", lambda *_, **__: gain(worth))
    assert prune.keep_sure(judge, [term], 20, lambda step: None)[1] == ([term] if kept else [])


def test_what_stands_for_another_costs_a_share_of_what_is_left_with_it() -> None:
    """The noise is of two floors: an error that grows by 0.08 of a squared floor grows by a fiftieth."""
    told = {frozenset([VISCOUS]): 2.0 * NOISE, frozenset([CURVED]): 2.0 * NOISE + np.sqrt(0.08) * LARGE}
    judge = told_judge(told)
    named = _Named(judge, [VISCOUS], [], {}, judge.evidence.held([VISCOUS]))
    growth = named.as_good(judge.evidence.held([CURVED]))
    assert growth is not None
    assert growth == pytest.approx([0.02])


def test_what_would_stand_in_the_place_of_a_name_stands_beside_what_is_estimated_beside_it() -> None:
    """Judged without it a name leaves much, and what takes up a part of that looks better than the name."""
    dry, wet = ("coulomb_friction", "coulomb_torque"), ("viscous_friction", "viscous_coefficient")
    hidden = [Effect(effect, (ELBOW,), {key: value}) for (effect, key), value in ((dry, 0.4), (wet, 2.5))]
    judge, terms = judged(hidden, 0.1)
    name, beside = (effect.term(judge.evidence.robot) for effect in hidden)
    judge = judge.adding([name, beside]).at([name, beside])

    def listed(*held: Term) -> set[str]:
        entries = indistinguishable(judge, [name], terms, beside=held)[name]
        return {effect["effect"] for entry in entries for effect in entry["effects"]}

    assert "viscous_friction" not in listed(beside)
    # The control: with nothing beside, the larger part of the friction is a better name than the smaller.
    assert "viscous_friction" in listed()


def test_every_step_that_is_told_is_a_step_of_what_was_found(monkeypatch: pytest.MonkeyPatch) -> None:
    judge, terms = judged([Effect("viscous_friction", (ELBOW,), {"viscous_coefficient": 1.5})], 0.2)
    idle = next(t for t in terms if t.effect == "torque_offset" and t.joint == 0)
    # A law that is not sure beside the plainer one goes, by a step of its own.
    monkeypatch.setattr(find_module, "cheaper", lambda judge, chosen: (judge.at([*chosen, idle]), [*chosen, idle]))
    told: list[Any] = []
    found = find_module.find(judge, terms, told.append)
    assert (found.steps[-1].action, found.steps[-1].term) == ("drop", idle)
    assert found.steps[-1] is told[-1]
