"""A search lets go of what others explain, and of nothing whose leaving a re-fit shows to be a loss."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop import search as searching
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.trace import Judge

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
HIDDEN = [Effect("viscous_friction", (ELBOW,), {"viscous_coefficient": 1.5})]


def _actions() -> tuple[list[str], list[Term]]:
    """What a search does that starts from an offset that is not there, and where it ends."""
    settings = LoopSettings()
    train = [noisy_log(HIDDEN, seed, "train", 0.05) for seed in (1, 2)]
    logs = read_motion(ROBOT, train, [noisy_log(HIDDEN, 51, "test", 0.05)], settings)
    judge, terms, _ = gather(Model(ROBOT), logs, settings)
    idle = next(t for t in terms if t.effect == "torque_offset" and t.joint == 0)
    _, steps = searching.search(judge, terms, lambda step: None, [idle])
    return [s.action for s in steps], list(steps[-1].terms)


def test_what_is_not_there_is_dropped() -> None:
    actions, end = _actions()
    assert "drop" in actions
    assert [(t.effect, t.joint) for t in end] == [("viscous_friction", 1)]


def test_a_drop_that_a_refit_makes_worse_is_not_made_and_not_asked_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    refused = 0

    def without(judge: Judge, current: Sequence[Term], rest: Sequence[Term], useless: Term) -> None:
        nonlocal refused
        refused += 1

    monkeypatch.setattr(searching, "without", without)
    actions, end = _actions()
    assert refused == 1
    assert "drop" not in actions
    assert {(t.effect, t.joint) for t in end} == {("viscous_friction", 1), ("torque_offset", 0)}
