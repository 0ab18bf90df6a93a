"""Links that are off by too little to be named are estimated near what they are said to be, told, and no finding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.small_arm import arm, heavier_links

from hybrid_dynamics.effects import Effect, Term, family
from hybrid_dynamics.effects.base import HELD
from hybrid_dynamics.effects.inertial_parameters import LINKS
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop import known as known_module
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.beside import LINKS_WITHIN, all_beside, links_too, speaks_against
from hybrid_dynamics.loop.confirm import confirm
from hybrid_dynamics.loop.describe import _beside, _estimated
from hybrid_dynamics.loop.diagnosis import errors_of
from hybrid_dynamics.loop.found import Found
from hybrid_dynamics.loop.known import with_links
from hybrid_dynamics.loop.model import load_model
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.simulation.excitation import excitations

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
FRICTION = [Effect("coulomb_friction", (name,), {"coulomb_torque": 0.8}) for name in ROBOT.joint_names]


def judged(
    effects: list[Effect], base: Model | None = None, runs: int = 1
) -> tuple[Judge, list[Term], list[Run], list[Term]]:
    """Evidence of a short run (or more), candidates, a test run, and the friction that is named."""
    settings = LoopSettings()
    train, test = excitations(ROBOT, effects, train=runs, test=1, duration=8.0, rate=250.0)
    logs = read_motion(ROBOT, train, test, settings)
    judge, candidates, _ = gather(base or Model(ROBOT), logs, settings)
    named = [next(t for t in candidates if t.effect == "coulomb_friction" and t.joint == j) for j in range(2)]
    return judge.at(named), candidates, logs.test, named


def beside(judge: Judge, names: list[Term], candidates: list[Term]) -> tuple[Judge, list[Term]]:
    """What stands beside ``names``, and the judge there; the names stay."""
    judge, plain = all_beside(judge, names, candidates)
    there, kept, out = with_links(judge, names, plain, candidates, ())
    assert kept == names
    return there, out


def held_links(terms: list[Term]) -> list[Term]:
    return [t for t in terms if t.family().all_links]


def test_links_that_are_off_stand_beside_the_names() -> None:
    judge, candidates, test, named = judged([heavier_links(0.15), *FRICTION])
    there, estimated = beside(judge, named, candidates)
    (near,) = held_links(estimated)
    assert near.options[HELD] in LINKS_WITHIN
    assert near.options[LINKS] == (SHOULDER, ELBOW)
    # A share of what is plausible of each number, and not one number for all.
    plausible = family("inertial_parameters").prior_scale(ROBOT, near.as_finding)
    np.testing.assert_allclose(near.prior_scale(ROBOT), near.options[HELD] * plausible)

    fitted = refit(there.evidence, [*named, *estimated])
    found = Found(named, fitted.x, [], [], [], there.over(fitted.evidence), there.evidence.base, estimated)
    model = found.model(named)
    assert [e.effect for e in model.effects if e.is_finding] == ["coulomb_friction", "coulomb_friction"]
    bare = refit(judge.evidence, named).model()
    assert np.all(errors_of(model, test)["rmse"] < 0.2 * np.array(errors_of(bare, test)["rmse"]))
    own = [e for e in model.effects if not e.is_finding]
    assert "inertial_parameters" in [e.effect for e in own]
    (line,) = _estimated("beside", own, [])
    assert f"inertial_parameters of {SHOULDER}, {ELBOW}" in line


def test_the_closer_the_links_the_stronger_they_are_held() -> None:
    """As far as held-out rows can tell: from a description made from drawings to one that was identified."""
    shares = []
    for off in (0.6, 0.15, 0.02):
        judge, candidates, _, named = judged([heavier_links(off), *FRICTION])
        shares.append(held_links(beside(judge, named, candidates)[1])[0].options[HELD])
    assert shares == sorted(shares, reverse=True)
    assert (shares[0], shares[-1]) == (max(LINKS_WITHIN), min(LINKS_WITHIN))


@pytest.mark.parametrize(
    "hidden",
    [
        pytest.param(FRICTION, id="nothing is left"),
        pytest.param(
            [*FRICTION, *(Effect("torque_offset", (name,), {"offset": 1.0}) for name in ROBOT.joint_names)],
            id="what is left is no weight",
        ),
    ],
)
def test_links_that_are_right_are_left_alone(hidden: list[Effect]) -> None:
    judge, candidates, _, named = judged(hidden)
    assert held_links(beside(judge, named, candidates)[1]) == []


def test_a_link_that_is_named_is_not_estimated_again(monkeypatch: pytest.MonkeyPatch) -> None:
    # Beside an elbow known to within a quarter the shoulder's mass is not known, and would go.
    monkeypatch.setattr(known_module, "LINKS_WITHIN", (0.05,))
    judge, candidates, _, named = judged([heavier_links(0.15), *FRICTION])
    mass = Term("link_mass", 0)
    judge = judge.adding([mass]).at([*named, mass])
    (near,) = held_links(beside(judge, [*named, mass], candidates)[1])
    assert near.options[LINKS] == (ELBOW,)
    every = held_links(candidates)
    assert held_links(beside(judge.at([*named, *every]), [*named, *every], candidates)[1]) == []


@pytest.mark.parametrize(
    ("hidden", "runs", "goes"),
    [
        pytest.param([], 1, True, id="links make it"),
        pytest.param([], 2, True, id="links make it in both runs"),
        pytest.param([("torque_gain", {"gain": 2.0})], 1, True, id="parts of one run are not asked"),
        pytest.param([("torque_gain", {"gain": 2.0})], 2, False, id="the other run surely misses it"),
    ],
)
def test_a_name_that_is_sure_only_of_links_exactly_as_described_goes(
    monkeypatch: pytest.MonkeyPatch, hidden: list[tuple[str, dict[str, float]]], runs: int, goes: bool
) -> None:
    """All links are heavier, and a gain of the shoulder is named: its torque grows as well. Nothing may be known of it
    beside the links, by decree; where it is there, and of twice the torque, links cannot make it."""
    own = [Effect(name, (SHOULDER,), values) for name, values in hidden]
    judge, candidates, _, named = judged([heavier_links(0.15), *FRICTION, *own], runs=runs)
    gain = Term("torque_gain", 0)
    judge = judge.adding([gain]).at([*named, gain])
    # The shoulder's gain leaves little of that joint; at another floor something is left to find.
    judge, plain = all_beside(replace(judge, floor=1e-3 * judge.floor), [*named, gain], candidates)

    def nothing_is_known_of_it(_: Judge, names: list[Term], __: object, fixed: Sequence[Term]) -> Term | None:
        return gain if gain in names and gain not in fixed else None

    monkeypatch.setattr(known_module, "_least_known", nothing_is_known_of_it)
    _, kept, out = with_links(judge, [*named, gain], plain, candidates, ())
    assert kept == (named if goes else [*named, gain])
    assert bool(held_links(out)) is goes
    # Control: what is fixed is never asked, and the links stand beside it.
    _, kept, out = with_links(judge, [*named, gain], plain, candidates, [gain])
    assert kept == [*named, gain]
    assert held_links(out)


def test_a_name_is_asked_beside_links_that_are_off_by_a_quarter(monkeypatch: pytest.MonkeyPatch) -> None:
    """However near they are held for the prediction."""
    judge, candidates, _, named = judged([heavier_links(0.02), *FRICTION])
    judge, plain = all_beside(judge, named, candidates)
    seen: list[float] = []

    published = known_module._published

    def watched(there: Judge, names: list[Term], beside: list[Term]) -> tuple[Judge, list[Effect]]:
        seen.extend(float(t.options[HELD]) for t in held_links(beside))
        return published(there, names, beside)

    monkeypatch.setattr(known_module, "_published", watched)
    _, _, out = with_links(judge, named, plain, candidates, ())
    (near,) = held_links(out)
    assert (seen[0], seen[-1]) == (max(LINKS_WITHIN), near.options[HELD])
    assert near.options[HELD] == min(LINKS_WITHIN)


def test_a_link_whose_name_goes_is_estimated_with_the_others() -> None:
    """Beside an elbow that is known to within a quarter nothing is known of the shoulder's mass."""
    judge, candidates, _, named = judged([heavier_links(0.15), *FRICTION])
    mass = Term("link_mass", 0)
    judge = judge.adding([mass]).at([*named, mass])
    judge, plain = all_beside(judge, [*named, mass], candidates)
    _, kept, out = with_links(judge, [*named, mass], plain, candidates, ())
    assert kept == named
    assert held_links(out)[0].options[LINKS] == (SHOULDER, ELBOW)


def test_a_law_that_goes_leaves_what_is_plain_of_its_joint(monkeypatch: pytest.MonkeyPatch) -> None:
    judge, candidates, _, named = judged(
        [heavier_links(0.15), *FRICTION, Effect("torque_offset", (SHOULDER,), {"offset": 1.0})]
    )
    law = Term("asymmetric_coulomb_friction", 0)
    names = [law, named[1]]
    judge = judge.adding([law]).at(names)
    judge, plain = all_beside(judge, names, candidates)
    monkeypatch.setattr(known_module, "_least_known", lambda _, kept, *__: law if law in kept else None)
    _, kept, out = with_links(judge, names, plain, candidates, ())
    assert kept == [named[1]]
    assert {(t.effect, t.joint) for t in out} >= {("coulomb_friction", 0), ("torque_offset", 0)}


def known_by_decree(monkeypatch: pytest.MonkeyPatch, *said: Term | None) -> None:
    """Of what nothing is known, time after time; in the end of nothing."""
    answers = iter(said)
    monkeypatch.setattr(known_module, "_least_known", lambda *_: next(answers, None))


def test_a_name_is_asked_beside_the_links_as_they_are_held_in_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    judge, candidates, _, named = judged([heavier_links(0.15), *FRICTION])
    judge, plain = all_beside(judge, named, candidates)
    # Beside links off by a quarter both are known, and beside those that predict best the elbow's is not.
    known_by_decree(monkeypatch, None, named[1])
    _, kept, out = with_links(judge, named, plain, candidates, ())
    assert kept == named[:1]
    assert held_links(out)
    assert [t.joint for t in out if t.effect == "coulomb_friction"] == [1]
    # Control: where held-out rows miss what goes so much, it stays, with the links that it was known beside.
    known_by_decree(monkeypatch, None, named[1])
    monkeypatch.setattr(known_module, "speaks_against", lambda _, after, before: len(asked) > 1)
    asked: list[int] = []

    def links(*given: Any) -> tuple[Judge, list[Term]]:
        asked.append(1)
        return links_too(*given)

    monkeypatch.setattr(known_module, "links_too", links)
    _, kept, out = with_links(judge, named, plain, candidates, ())
    assert kept == named
    assert held_links(out)


@pytest.mark.parametrize("runs", [1, 2])
def test_other_runs_are_heard_against_links_and_parts_of_one_are_not(runs: int) -> None:
    judge, _, _, named = judged(FRICTION, runs=runs)
    held = judge.evidence.held
    better, worse = held(named, physical=True), held([], physical=True)
    assert speaks_against(judge, worse, better) is (runs > 1)
    assert not speaks_against(judge, better, worse)
    assert not speaks_against(judge, better, better)


def test_links_of_a_starting_model_stay_and_without_names_nothing_is_estimated() -> None:
    judge, candidates, _, named = judged([heavier_links(0.15), *FRICTION], Model(ROBOT, (heavier_links(0.05),)))
    assert held_links(beside(judge, named, candidates)[1]) == []
    judge, candidates, _, _ = judged([heavier_links(0.15), *FRICTION])
    assert beside(judge, [], candidates)[1] == []


@pytest.mark.parametrize(("torque", "refused"), [(0.8, []), (0.1, ["elbow"])])
def test_a_name_that_the_test_runs_contradict_goes_and_the_links_stay(torque: float, refused: list[str]) -> None:
    """The elbow rubs less in the test run: its friction goes, the shoulder's and what stands beside it do not."""
    judge, candidates, _, named = judged([heavier_links(0.15), *FRICTION])
    there, estimated = beside(judge, named, candidates)
    fitted = refit(there.evidence, [*named, *estimated])
    found = Found(named, fitted.x, [], [], [], there.over(fitted.evidence), there.evidence.base, estimated)
    changed = [heavier_links(0.15), FRICTION[0], Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": torque})]
    _, test = excitations(ROBOT, changed, train=0, test=1, duration=8.0, rate=250.0)
    train, _ = excitations(ROBOT, changed, train=1, test=0, duration=8.0, rate=250.0)
    tests = read_motion(ROBOT, train, test, LoopSettings()).test
    told = confirm(found.judge, Model(ROBOT), found.model(named), found, tests, candidates)
    assert [ROBOT.joint_names[t.index] for t in told.refused] == refused
    assert any(e.effect == "inertial_parameters" and not e.is_finding for e in told.model.effects)


def test_links_that_are_held_are_no_links_that_are_named() -> None:
    held = Effect("inertial_parameters", (), heavier_links(0.1).parameters, {**heavier_links(0.1).settings, HELD: 0.5})
    offset = Effect("torque_offset", (ELBOW,), {"offset": 0.1}, {HELD: 0.2})
    assert _beside([held, offset]) == ([held, offset], [])
    assert _beside([heavier_links(0.1), offset]) == ([], [offset])
    judge, _, _, _ = judged(FRICTION, Model(ROBOT, (held,)))
    assert not judge.evidence.problem.links_identified


def test_what_is_held_and_what_is_named_stand_at_one_place(tmp_path: Path) -> None:
    """Friction of 1.5 N m was guessed, and .7 of it is gone: .8 N m in all are friction; 2 of it gone are not."""
    held = Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 1.5}, {HELD: 2.0})
    for gone, readable in ((0.7, True), (2.0, False)):
        less = Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": -gone})
        Model(ROBOT, (held, less)).save(tmp_path / f"{gone}.json")
        if readable:
            assert len(load_model(tmp_path / f"{gone}.json", ROBOT).effects) == 2
        else:
            with pytest.raises(InputError, match="expected >= 0"):
                load_model(tmp_path / f"{gone}.json", ROBOT)


def test_the_model_is_read_again_as_it_was_written(tmp_path: Path) -> None:
    effect = Effect(
        "inertial_parameters", (), heavier_links(0.1).parameters, {**heavier_links(0.1).settings, HELD: 0.5}
    )
    Model(ROBOT, (effect,)).save(tmp_path / "model.json")
    (again,) = load_model(tmp_path / "model.json", ROBOT).effects
    assert not again.is_finding
    assert again.parameters == pytest.approx(effect.parameters)
