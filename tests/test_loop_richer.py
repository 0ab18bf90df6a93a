"""Friction of five numbers (LuGre's), where the search has put together plainer laws for it; and where it has not."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect, Term, family
from hybrid_dynamics.loop import LoopSettings, Model, close_loop
from hybrid_dynamics.loop import richer as richer_module
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.richer import plainer_laws, richer_laws, within_bounds
from hybrid_dynamics.study.outside import Course, dahl, lugre, stribeck
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

ROBOT = arm()
ELBOW = ROBOT.joint_names[1]
FALLING = {"coulomb": 1.0, "static": 1.6, "stiffness": 50.0, "micro_damping": 0.5, "velocity": 0.1}
LAW = {"law": "lugre"}
PLAIN = Term("hysteresis_friction", 1, (("presliding_displacement", 0.02),))
RICH = Term(
    "hysteresis_friction",
    1,
    (("law", "lugre"), ("presliding_displacement", 0.02), ("static_ratio", 1.6), ("stribeck_velocity", 0.1)),
)
DAMPED = Term("hysteresis_friction", 1, (("law", "damped"), ("presliding_displacement", 0.02)))


def _log(law: Callable[..., Array], values: Mapping[str, float], seed: int, split: str, noise: float) -> Trajectory:
    """The arm with friction of the elbow by equations that are not those of the catalogue."""
    run = noisy_log([], seed, split, 0.0)
    dq = np.gradient(run["q"], run.time, axis=0)
    course = Course(run.time, run["q"], dq, np.gradient(dq, run.time, axis=0), run["tau"])
    tau = run["tau"].copy()
    tau[:, 1] += law(course, 1, values)
    return run.with_signals(tau=tau + noise * np.random.default_rng(100 + seed).normal(size=tau.shape))


@pytest.mark.parametrize("noise", [0.03, 0.1])
def test_lugre_friction_is_named_with_its_numbers(noise: float) -> None:
    runs = [_log(lugre, FALLING, k, split, noise) for k, split in ((1, "train"), (2, "train"), (3, "test"))]
    diagnosis = close_loop(ROBOT, runs[:2], runs[2:]).diagnosis
    (found,) = diagnosis.effects
    assert (found.effect.effect, found.effect.joints, found.effect.settings) == ("hysteresis_friction", (ELBOW,), LAW)
    assert found.confirmed
    assert diagnosis.verdict == "explained"
    values, errors = found.effect.parameters, found.effect.std_errors
    assert values["coulomb_torque"] == pytest.approx(1.0, rel=0.01)
    # What the catalogue's targets ask of Stribeck's numbers and of Dahl's stiffness.
    for name, true in (("static_torque", 1.6), ("stribeck_velocity", 0.1), ("presliding_stiffness", 50.0)):
        assert values[name] == pytest.approx(true, rel=0.2)
        assert 0 < errors[name] < 0.2 * true


def test_micro_damping_that_shows_beside_a_level_that_does_not_fall_is_named_and_no_fall() -> None:
    values = {**FALLING, "static": 1.0}
    runs = [_log(lugre, values, k, split, 0.03) for k, split in ((1, "train"), (2, "train"), (3, "test"))]
    diagnosis = close_loop(ROBOT, runs[:2], runs[2:]).diagnosis
    (found,) = diagnosis.effects
    assert (found.effect.effect, found.effect.settings) == ("hysteresis_friction", {"law": "damped"})
    assert diagnosis.verdict == "explained"
    for name, true in (("coulomb_torque", 1.0), ("presliding_stiffness", 50.0), ("micro_damping", 0.5)):
        assert found.effect.parameters[name] == pytest.approx(true, rel=0.1)


@pytest.mark.parametrize(
    ("law", "values", "name"),
    [
        (dahl, {"coulomb": 1.0, "stiffness": 50.0}, "hysteresis_friction"),
        (stribeck, {"coulomb": 1.0, "static": 1.6, "velocity": 0.1}, "stribeck_friction"),
    ],
)
def test_a_plainer_law_keeps_its_plainer_name(law: Callable[..., Array], values: dict[str, float], name: str) -> None:
    runs = [_log(law, values, k, split, 0.05) for k, split in ((1, "train"), (2, "train"), (3, "test"))]
    diagnosis = close_loop(ROBOT, runs[:2], runs[2:]).diagnosis
    assert [(e.effect.effect, e.effect.settings) for e in diagnosis.effects] == [(name, {})]
    assert diagnosis.verdict == "explained"


def _of(law: Callable[..., Array], values: Mapping[str, float], start: Model, terms: list[Term]) -> list[Term]:
    runs = [_log(law, values, k, "train", 0.05) for k in (1, 2)]
    logs = read_motion(ROBOT, runs, [_log(law, values, 3, "test", 0.05)], LoopSettings())
    judge, _, _ = gather(start, logs, LoopSettings())
    # As it is where these stand: the floor that the search begins with holds what they explain.
    judge = replace(judge, floor=judge.low)
    return richer_laws(judge.adding(terms), terms)[1]


def test_further_numbers_come_where_they_are_needed_and_go_where_they_are_not() -> None:
    assert [t.options.get("law") for t in _of(lugre, FALLING, Model(ROBOT), [PLAIN])] == ["lugre"]
    assert [t.options.get("law") for t in _of(lugre, FALLING, Model(ROBOT), [RICH])] == ["lugre"]
    one_level = {"coulomb": 1.0, "stiffness": 50.0}
    assert [t.options.get("law") for t in _of(dahl, one_level, Model(ROBOT), [RICH])] == [None]
    assert [t.options.get("law") for t in _of(dahl, one_level, Model(ROBOT), [DAMPED])] == [None]
    assert [t.options.get("law") for t in _of(lugre, FALLING, Model(ROBOT), [DAMPED])] == ["lugre"]
    damped = {**FALLING, "static": 1.0}
    assert [t.options.get("law") for t in _of(lugre, damped, Model(ROBOT), [PLAIN])] == ["damped"]
    assert [t.options.get("law") for t in _of(lugre, damped, Model(ROBOT), [RICH])] == ["damped"]
    assert [t.options.get("law") for t in _of(dahl, one_level, Model(ROBOT), [PLAIN])] == [None]


def test_friction_of_the_starting_model_stays_as_it_is() -> None:
    own = Effect("hysteresis_friction", (ELBOW,), {"presliding_stiffness": 50.0, "coulomb_torque": 1.0})
    assert _of(lugre, FALLING, Model(ROBOT, (own,)), [own.term(ROBOT)]) == [own.term(ROBOT)]


def test_the_law_holds_its_special_cases() -> None:
    kind = family("hysteresis_friction")
    stribeck_own = Term("stribeck_friction", 1, (("stribeck_velocity", 0.1),))
    assert kind.covers(RICH, stribeck_own)
    assert not kind.covers(PLAIN, stribeck_own)
    assert not kind.covers(DAMPED, stribeck_own)
    assert kind.plainer(RICH) == DAMPED
    assert kind.plainer(DAMPED) == PLAIN
    # The plainest is another effect's, and what makes the same torque is no law of this one.
    assert kind.plainer(PLAIN) == Term("coulomb_friction", 1, (("sign_displacement", 0.02),))
    assert richer_module._plainer_law(PLAIN) is None
    assert kind.richer([Term("coulomb_friction", 1)]) == []
    assert {t.options["presliding_displacement"] for t in kind.richer([PLAIN])} == {0.02}
    assert {t.options["stribeck_velocity"] for t in kind.richer([stribeck_own])} == {0.1}


def test_presliding_friction_of_which_the_distance_is_not_known_is_dry_friction(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settings = LoopSettings()
    train = [_log(dahl, FALLING, k, "train", 0.05) for k in (1, 2)]
    judge, _, _ = gather(Model(ROBOT), read_motion(ROBOT, train, [], settings), settings)
    judge = judge.adding([PLAIN]).at([PLAIN])
    assert plainer_laws(judge, [PLAIN])[1] == [PLAIN]
    monkeypatch.setattr(richer_module, "_is_known", lambda judge, terms, term: term.effect != PLAIN.effect)
    dry = Term("coulomb_friction", 1, (("sign_displacement", 0.02),))
    assert plainer_laws(judge, [PLAIN])[1] == [dry]
    # Dry friction of the joint that stands beside it is the same.
    own = Term("coulomb_friction", 1)
    assert plainer_laws(judge.adding([own]), [own, PLAIN])[1] == [dry]
    # Controls: of the starting model it stays what it is; at the end of its range it is no friction at all.
    known = Effect("hysteresis_friction", (ELBOW,), {"presliding_stiffness": 50.0, "coulomb_torque": 1.0})
    there, _, _ = gather(Model(ROBOT).adding([known]), read_motion(ROBOT, train, [], settings), settings)
    assert plainer_laws(there.adding([PLAIN]), [PLAIN])[1] == [PLAIN]
    far = Term("hysteresis_friction", 1, (("presliding_displacement", 0.5),))
    assert within_bounds(judge.adding([far]), [far])[1] == [far]
    stiff = family("hysteresis_friction")
    effect = Effect("hysteresis_friction", (ELBOW,), {"presliding_stiffness": 50.0, "coulomb_torque": 1.0})
    for error, is_known in ((10.0, True), (30.0, False)):
        errors = {"presliding_stiffness": error, "coulomb_torque": 0.01}
        assert stiff.is_known(replace(effect, std_errors=errors)) is is_known
