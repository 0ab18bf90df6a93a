"""A guess beside the names by which a joint of the test runs ends worse than it began is taken back, and told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.effects.base import HELD
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop import confirm as confirm_module
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.confirm import Confirmation, confirm
from hybrid_dynamics.loop.diagnosis import errors_of
from hybrid_dynamics.loop.found import Found
from hybrid_dynamics.loop.guessed import without_wrong
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.simulation.excitation import excitations

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
FRICTION = Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 0.8})
DRY = Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 0.5})


def offset(value: float, joint: str = ELBOW) -> Effect:
    return Effect("torque_offset", (joint,), {"offset": value})


def logged(in_training: list[Effect], in_test: list[Effect]) -> tuple[Judge, list[Term], list[Run]]:
    """Evidence of a training run, candidates, and a test run."""
    settings = LoopSettings()
    train, _ = excitations(ROBOT, in_training, train=1, test=0, duration=8.0, rate=250.0)
    _, test = excitations(ROBOT, in_test, train=0, test=1, duration=8.0, rate=250.0)
    logs = read_motion(ROBOT, train, test, settings)
    judge, candidates, _ = gather(Model(ROBOT), logs, settings)
    return judge, candidates, logs.test


def asked(in_training: list[Effect], in_test: list[Effect]) -> tuple[Found, Confirmation, list[Run]]:
    """Friction of the shoulder is named, offsets of both joints are guessed beside it; the test runs are asked."""
    judge, candidates, tests = logged(in_training, in_test)
    named = [next(t for t in candidates if t.effect == "coulomb_friction" and t.joint == 0)]
    guesses = [Term("torque_offset", j, ((HELD, 5.0),)) for j in range(2)]
    judge = judge.adding(guesses).at([*named, *guesses])
    fitted = refit(judge.evidence, [*named, *guesses])
    found = Found(named, fitted.x[:1], [], [], [], judge.over(fitted.evidence), Model(ROBOT), guesses)
    return found, confirm(judge, Model(ROBOT), found.model(named), found, tests, candidates), tests


@pytest.mark.parametrize(("later", "gone"), [(1.0, []), (0.6, []), (0.0, [ELBOW]), (-1.0, [ELBOW])])
def test_a_guess_that_the_test_runs_contradict_goes_and_the_other_stays(later: float, gone: list[str]) -> None:
    """Of .6 N m an offset of 1 N m is still the better guess, of nothing it is not."""
    found, said, tests = asked(
        [FRICTION, offset(1.0), offset(2.0, SHOULDER)], [FRICTION, offset(later), offset(2.0, SHOULDER)]
    )
    assert [(ROBOT.joint_names[g.index], worse) for g, worse in said.guesses] == [(name, (1,)) for name in gone]
    assert said.refused == ()
    kept = {e.joints[0]: e.parameters["offset"] for e in said.model.effects if e.effect == "torque_offset"}
    assert set(kept) == {SHOULDER, ELBOW} - set(gone)
    assert kept[SHOULDER] == pytest.approx(2.0, abs=0.1)
    before, after = (np.array(errors_of(m, tests)["rmse"]) for m in (Model(ROBOT), said.model))
    assert after[1] <= 1.02 * before[1]
    if gone:
        # Control: as it was found, the elbow ends worse than it began.
        assert errors_of(found.model(found.terms), tests)["rmse"][1] > 1.5 * before[1]


@pytest.mark.parametrize(
    ("shoulder", "ends_worse", "taken_back"), [(5.0, False, False), (2.0, False, True), (2.0, True, False)]
)
def test_links_that_help_one_joint_much_stay_though_they_harm_another(
    shoulder: float, ends_worse: bool, taken_back: bool
) -> None:
    """Squares of the test runs without the links: the elbow is left with .3, the shoulder with more, and perhaps with
    more than it began with."""
    links, offset_there = Term("inertial_parameters"), Term("torque_offset", 0)
    found, _, _ = asked([FRICTION], [FRICTION])
    found = replace(found, beside=[links, offset_there])
    squares = {2: np.array([1.0, 1.0]), 1: np.array([shoulder, 0.3])}

    class Stub(Found):
        def model(self, terms: Sequence[Term], covariance: bool = True) -> Any:
            return len(self.beside)

    stub = Stub(**{f.name: getattr(found, f.name) for f in fields(found)})
    worse = {2: np.array([False, True]), 1: np.array([ends_worse, False])}
    start: Any = 2
    left: Any
    left, gone = without_wrong(stub, [], start, worse.__getitem__, squares.__getitem__)
    assert gone == ([(links, (1,))] if taken_back else [])
    assert left == (1 if taken_back else 2)


def test_a_guess_goes_before_the_name_that_it_spoils(monkeypatch: pytest.MonkeyPatch) -> None:
    """The elbow ends worse by what is guessed of it, and the test runs would be better off without its friction, too:
    as long as the guess stands."""
    judge, candidates, tests = logged([FRICTION, DRY, offset(1.0)], [FRICTION, DRY, offset(-1.0)])
    named = [next(t for t in candidates if t.effect == "coulomb_friction" and t.joint == j) for j in range(2)]
    guess = Term("torque_offset", 1, ((HELD, 5.0),))
    judge = judge.adding([guess]).at([*named, guess])
    fitted = refit(judge.evidence, [*named, guess])
    found = Found(named, fitted.x[:2], [], [], [], judge.over(fitted.evidence), Model(ROBOT), [guess])
    asked: list[Model] = []
    tested = confirm_module.test_change

    def change(judge: Any, tests: Any, full: Model, without: Model, names: int) -> confirm_module.TestChange:
        asked.append(full)
        # As long as the guess stands the elbow's friction is contradicted.
        spoils = any(not e.is_finding for e in full.effects) and len(full.effects) > len(without.effects)
        said = tested(judge, tests, full, without, names)
        return replace(said, contradicts=True, per_joint=np.zeros(2)) if spoils else said

    monkeypatch.setattr(confirm_module, "test_change", change)
    said = confirm(judge, Model(ROBOT), found.model(named), found, tests, candidates)
    assert [g for g, _ in said.guesses] == [guess]
    assert said.refused == ()
    assert asked
    assert all(e.is_finding for m in asked for e in m.effects)
    # Control: where the guess stays, names go for it.
    monkeypatch.setattr(confirm_module, "without_wrong", lambda found, names, model, *_: (model, []))
    assert confirm(judge, Model(ROBOT), found.model(named), found, tests, candidates).refused


def test_a_guess_that_has_gone_is_not_guessed_again_and_what_a_name_stood_for_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The shoulder's dry friction is named viscous friction and refused; what is guessed of the elbow is wrong."""
    judge, candidates, tests = logged([FRICTION, offset(1.0)], [FRICTION, offset(-1.0)])
    viscous = next(t for t in candidates if t.effect == "viscous_friction" and t.joint == 0)
    other = Term("armature", 1)
    guess = Term("torque_offset", 1, ((HELD, 5.0),))
    names = [viscous, other]
    judge = judge.adding([*names, guess]).at([*names, guess])
    fitted = refit(judge.evidence, [*names, guess])
    found = Found(names, fitted.x[:2], [], [], [], judge.over(fitted.evidence), Model(ROBOT), [guess])
    tested = confirm_module.test_change

    def change(judge: Any, tests: Any, full: Model, without: Model, names: int) -> confirm_module.TestChange:
        said = tested(judge, tests, full, without, names)
        of_name = [e for m in (full, without) for e in m.effects if e.effect == "viscous_friction" and e.is_finding]
        named = len(of_name) == 1
        return replace(said, contradicts=True, per_joint=np.zeros(2)) if named else replace(said, contradicts=False)

    monkeypatch.setattr(confirm_module, "test_change", change)
    monkeypatch.setattr(confirm_module, "_harm_to_its_joint", lambda *_: None)
    monkeypatch.setattr(confirm_module, "_worse_joints", lambda *_: [])
    monkeypatch.setattr(confirm_module, "_unknown", lambda *_: None)
    said = confirm(judge, Model(ROBOT), found.model(names), found, tests, candidates)
    assert said.refused == (viscous,)
    assert [g for g, _ in said.guesses] == [guess]
    assert not any(e.effect == "torque_offset" and e.joints == (ELBOW,) for e in said.model.effects)
    (dry,) = [e for e in said.model.effects if e.effect == "coulomb_friction" and e.joints == (SHOULDER,)]
    assert dry.parameters["coulomb_torque"] == pytest.approx(0.8, abs=0.1)
