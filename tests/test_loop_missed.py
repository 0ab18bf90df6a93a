"""What goes since nothing is known of it may have balanced what stays: then the rest is asked anew."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop import find as find_module
from hybrid_dynamics.loop.find import _missed, find
from hybrid_dynamics.loop.found import Found
from hybrid_dynamics.loop.known import known_and_beside
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.trace import Judge

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
NOISE = 0.05
SPRING = Effect("joint_spring", (ELBOW,), {"stiffness": 2.0, "rest_position": 1.0}, {"shape": "linear"})
FRICTION = Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 0.8})


def judged(*hidden: Effect) -> tuple[Judge, list[Term]]:
    settings = LoopSettings()
    train = [noisy_log(hidden, seed, "train", NOISE) for seed in (1, 2)]
    judge, terms, _ = gather(Model(ROBOT), read_motion(ROBOT, train, [], settings), settings)
    return judge, terms


def found_where_nothing_is_known_of(effect: str, monkeypatch: pytest.MonkeyPatch, *hidden: Effect) -> Found:
    def without(judge: Judge, chosen: Sequence[Term], *rest: Any) -> tuple[Judge, list[Term], list[Term]]:
        judge, names, beside = known_and_beside(judge, chosen, *rest)
        return judge.at(names), [t for t in names if t.effect != effect], beside

    monkeypatch.setattr(find_module, "known_and_beside", without)
    return find(*judged(*hidden), lambda step: None)


def test_what_held_out_rows_miss_is_asked_anew_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    judge, terms = judged(SPRING, FRICTION)
    plain = find(judge, terms, lambda step: None)
    assert {(t.effect, t.joint) for t in plain.terms} == {("joint_spring", 1), ("coulomb_friction", 0)}
    found = found_where_nothing_is_known_of("joint_spring", monkeypatch, SPRING, FRICTION)
    names = {(t.effect, t.joint) for t in found.terms}
    # What the spring had explained is not left over: something else that is known stands for what it can of it.
    assert ("joint_spring", 1) not in names
    assert ("coulomb_friction", 0) in names
    assert any(joint != 0 for _, joint in names)
    left = found.judge.mean_square(found.judge.evidence.held([*found.terms, *found.beside], physical=True))
    alone = judge.mean_square(judge.at([t for t in plain.terms if t.joint == 0]).evidence.held([], physical=True))
    assert left[1] < 0.2 * alone[1]


def test_what_nothing_misses_goes_and_the_rest_stays() -> None:
    judge, terms = judged(FRICTION)
    spring = SPRING.term(ROBOT)
    dry = next(t for t in terms if t.effect == "coulomb_friction" and t.joint == 0)
    judge = judge.adding([spring]).at([dry, spring])
    assert _missed(judge, [dry, spring], [dry], []) == []
    # Friction is estimated beside the names by another rule, however much it is missed.
    assert _missed(judge, [dry, spring], [spring], []) == []
    # The control: a spring that is there, and nothing beside the rest that stands for it.
    judge, _ = judged(FRICTION, SPRING)
    judge = judge.adding([spring]).at([dry, spring])
    assert _missed(judge, [dry, spring], [dry], []) == [spring]
    assert _missed(judge, [dry, spring], [dry], [spring]) == []


@pytest.mark.parametrize(("off", "missed"), [(0.2, True), (0.005, False)])
def test_a_cause_that_moves_the_linearisation_is_missed_by_what_it_makes(off: float, missed: bool) -> None:
    """The place of a link's mass: predictions of two linearisations had been compared, with errors a hundred times."""
    hidden = Effect("position_offset", (ELBOW,), {"offset": off})
    judge, terms = judged(FRICTION, hidden)
    turned = next(t for t in [*terms, hidden.term(ROBOT)] if t.effect == "position_offset" and t.joint == 1)
    dry = next(t for t in terms if t.effect == "coulomb_friction" and t.joint == 0)
    judge = judge.adding([turned]).at([dry, turned])
    assert (_missed(judge, [dry, turned], [dry], []) == [turned]) is missed
