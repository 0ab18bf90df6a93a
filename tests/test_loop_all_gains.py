"""Drives whose torque is read too large or too small, each by its own factor: a third end of the search."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from tests.panda_arm import FINGERS, JOINTS

from hybrid_dynamics.effects import Effect, Term, family
from hybrid_dynamics.loop import LoopSettings, Model, all_gains, known
from hybrid_dynamics.loop.all_gains import GainsEnd, from_gains
from hybrid_dynamics.loop.alternatives import indistinguishable
from hybrid_dynamics.loop.augment import model_of
from hybrid_dynamics.loop.beside import links_near
from hybrid_dynamics.loop.known import much_worse
from hybrid_dynamics.loop.narrow import narrowed
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.trace import Judge, all_links_of
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation.excitation import excitations
from hybrid_dynamics.trajectory import Trajectory

ROBOT = Robot.from_urdf(find_description("panda.urdf"), (*FINGERS, *JOINTS[4:]))
FRICTION = [
    *(Effect("coulomb_friction", (j,), {"coulomb_torque": 0.5}) for j in ROBOT.joint_names),
    *(Effect("viscous_friction", (j,), {"viscous_coefficient": 0.8}) for j in ROBOT.joint_names),
]
TRUE = (1.3, 0.57, 0.7, 1.4)
GAINS = [Effect("torque_gain", (j,), {"gain": g}) for j, g in zip(ROBOT.joint_names, TRUE, strict=True)]
NOISE = 0.1


def judged(
    hidden: Sequence[Effect], settings: LoopSettings | None = None, start: Model | None = None
) -> tuple[Judge, list[Term]]:
    """The judge of five seconds of the arm with what is ``hidden``, asked by ``start``, and the candidates."""
    settings = settings or LoopSettings()
    train, test = excitations(ROBOT, [*FRICTION, *hidden], train=1, test=1, duration=5.0, rate=200.0)
    rng = np.random.default_rng(3)

    def noisy(run: Trajectory) -> Trajectory:
        return run.with_signals(tau=run["tau"] + NOISE * rng.normal(size=run["tau"].shape))

    logs = read_motion(ROBOT, [noisy(run) for run in train], [noisy(run) for run in test], settings)
    judge, terms, _ = gather(start or Model(ROBOT), logs, settings)
    return judge, terms


def one_link(judge: Judge, terms: Sequence[Term]) -> Term:
    """The single body that predicts best."""
    bodies = [t for t in terms if t.effect == "link_inertia"]
    return min(bodies, key=lambda t: judge.evidence.held([t]).score)


@pytest.fixture(scope="module")
def wrong_gains() -> tuple[Judge, list[Term]]:
    return judged(GAINS)


def test_gains_of_all_joints_take_the_place_of_a_link_that_stood_for_them(wrong_gains):
    judge, terms = wrong_gains
    chosen = [one_link(judge, terms)]
    end = from_gains(judge.at(chosen), chosen, terms, lambda step: None)
    assert end.steps
    assert [t.joint for t in end.gains] == [0, 1, 2, 3]
    effects = model_of(end.judge.evidence, end.terms, False).effects
    named = {e.joints: e.parameters["gain"] for e in effects if e.effect == "torque_gain"}
    # One factor that is common to all is one name, and the others' are told beside it.
    common = named.pop((), 1.0)
    for joint, true in zip(ROBOT.joint_names, TRUE, strict=True):
        assert common * named.get((joint,), 1.0) == pytest.approx(true, rel=0.03)


def test_nothing_is_asked_where_no_more_than_the_floor_is_left(wrong_gains):
    judge, terms = wrong_gains
    true = [Term("torque_gain", j) for j in range(4)]
    true += [Term(name, j) for name in ("coulomb_friction", "viscous_friction") for j in range(4)]
    judge = judge.adding(true).at(true)
    assert from_gains(judge, true, terms, lambda step: None) == GainsEnd(judge, true)


def test_all_links_are_not_asked_here(wrong_gains):
    judge, terms = wrong_gains
    links = [all_links_of(terms)]
    there = judge.at(links)
    assert from_gains(there, links, terms, lambda step: None) == GainsEnd(there, links)


def test_motors_of_an_arm_whose_links_are_known_have_not_changed():
    (links,) = family("inertial_parameters").terms(ROBOT, np.ones(4, bool), {})
    same = Effect(links.effect, (), links.family().parameters_of(np.zeros(40), ROBOT, links), dict(links.settings))
    judge, terms = judged(GAINS, start=Model(ROBOT, (same,)))
    chosen = [one_link(judge, terms)]
    end = from_gains(judge.at(chosen), chosen, terms, lambda step: None)
    assert (end.terms, end.gains, end.steps) == (chosen, [], [])


def test_what_may_not_be_named_is_not_offered():
    judge, terms = judged(GAINS, LoopSettings(effects=("link_inertia", "coulomb_friction", "viscous_friction")))
    chosen = [one_link(judge, terms)]
    end = from_gains(judge.at(chosen), chosen, terms, lambda step: None)
    assert (end.terms, end.gains, end.steps) == (chosen, [], [])


def test_gains_come_in_only_where_they_predict_surely_better_than_all_links(monkeypatch):
    (links,) = family("inertial_parameters").terms(ROBOT, np.ones(4, bool), {})
    change = links.family().draw(ROBOT, links, np.random.default_rng(5))
    heavier = Effect(links.effect, (), links.family().parameters_of(change, ROBOT, links), dict(links.settings))
    # A law that nobody offers leaves every joint with more than its floor, whatever is named.
    wave = {"amplitude": 1.5, "harmonic": 11.0, "phase": 0.3}
    judge, terms = judged([heavier, *(Effect("torque_ripple", (j,), wave) for j in ROBOT.joint_names)])
    chosen = [one_link(judge, terms)]
    asked: list[object] = []
    end = from_gains(judge.at(chosen), chosen, terms, asked.append)
    assert (end.terms, end.gains, end.steps) == (chosen, [], [])
    assert asked
    # Control: they would come in, if all links had not to be surpassed.
    monkeypatch.setattr(all_gains, "_better", lambda *of: True)
    found = from_gains(judge.at(chosen), chosen, terms, asked.append).terms
    assert any(t.effect == "torque_gain" for t in found)


def test_gains_that_do_as_well_as_the_links_that_are_named_are_told(wrong_gains):
    (links,) = family("inertial_parameters").terms(ROBOT, np.ones(4, bool), {})
    instead = [Term("torque_gain", j) for j in range(4)]
    plain = [Term(name, j) for name in ("coulomb_friction", "viscous_friction") for j in range(4)]

    def told(judge: Judge, terms: list[Term]) -> list[dict[str, Any]]:
        judge = judge.adding([links, *plain]).at([links, *plain])
        return indistinguishable(judge, [links, *plain], terms, [*instead, *plain])[links]

    first, *others = told(*wrong_gains)
    assert [e["effect"] for e in first["effects"]] == ["torque_gain"] * 4
    assert [e["joints"] for e in first["effects"]] == [[name] for name in ROBOT.joint_names]
    assert "each by its own factor" in first["why"]
    assert "payload of known mass" in first["motion_that_would_tell"]
    # Control: where links are off as links are, no gains do as well.
    change = links.family().draw(ROBOT, links, np.random.default_rng(5))
    heavier = Effect(links.effect, (), links.family().parameters_of(change, ROBOT, links), dict(links.settings))
    assert not any("each by its own factor" in entry["why"] for entry in [*others, *told(*judged([heavier]))])


def judged_beside_links(judged, monkeypatch, unknown):
    """:func:`with_links` of the gains and friction of ``judge`` and of ``unknown``, which is unknown beside links."""
    judge, terms = judged
    names = [*(Term("torque_gain", j) for j in range(4)), unknown]
    names += [Term(name, j) for name in ("coulomb_friction", "viscous_friction") for j in range(4)]
    names = list(dict.fromkeys(names))
    judge = judge.adding(names).at(names)

    def near(judge, model, candidates):
        links = links_near(judge, model, candidates, 0.01)
        return judge.adding(links), links

    monkeypatch.setattr(known, "links_too", near)
    monkeypatch.setattr(known, "_least_known", lambda j, kept, *of: unknown if unknown in kept else None)
    _, kept, beside = known.with_links(judge, names, [], terms, ())
    return names, kept, beside


def test_a_name_that_links_cannot_stand_for_stays_though_it_is_unknown_beside_them(wrong_gains, monkeypatch):
    names, kept, beside = judged_beside_links(wrong_gains, monkeypatch, Term("torque_gain", 1))
    assert kept == names
    assert beside == []


def test_a_name_that_nobody_misses_goes_where_it_is_unknown_beside_links(wrong_gains, monkeypatch):
    nothing = Term("joint_spring", 3, (("shape", "linear"),))
    names, kept, beside = judged_beside_links(wrong_gains, monkeypatch, nothing)
    assert set(kept) == {*names} - {nothing}
    assert any(t.effect == "inertial_parameters" for t in beside)


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_links_that_are_off_each_in_its_own_way_are_no_gains(seed):
    (links,) = family("inertial_parameters").terms(ROBOT, np.ones(4, bool), {})
    change = links.family().draw(ROBOT, links, np.random.default_rng(seed))
    heavier = Effect(links.effect, (), links.family().parameters_of(change, ROBOT, links), dict(links.settings))
    judge, terms = judged([heavier])
    chosen = [one_link(judge, terms)]
    found = from_gains(judge.at(chosen), chosen, terms, lambda step: None).terms
    assert not any(t.effect == "torque_gain" for t in found)


def test_gains_take_the_place_of_all_links_where_they_do_as_well(wrong_gains):
    judge, terms = wrong_gains
    links = all_links_of(terms)
    plain = [Term(name, j) for name in ("coulomb_friction", "viscous_friction") for j in range(4)]
    chosen = [links, *plain]
    _, found = narrowed(judge.adding(chosen).at(chosen), chosen, terms)
    assert links not in found
    assert {t.joint for t in found if t.effect == "torque_gain"} == {0, 1, 2, 3}


def test_links_held_near_do_not_stand_for_gains_that_halve_what_they_leave(wrong_gains):
    judge, terms = wrong_gains
    plain = [Term(name, j) for name in ("coulomb_friction", "viscous_friction") for j in range(4)]
    gains = [Term("torque_gain", j) for j in range(4)]
    judge = judge.adding([*gains, *plain]).at([*gains, *plain])
    (near,) = links_near(judge, [*gains, *plain], terms, 0.1)
    judge = judge.adding([near])
    held = judge.evidence.held
    without, beside = held([*plain, near], physical=True), held([*gains, *plain], physical=True)
    assert much_worse(judge, without, beside)
    assert not much_worse(judge, beside, without)
    assert not much_worse(judge, held([*gains, *plain, near], physical=True), beside)
