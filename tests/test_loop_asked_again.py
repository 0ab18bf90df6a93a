"""What goes at the end had stood for plain friction, too: the joint is asked for that once more."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop import find as find_module
from hybrid_dynamics.loop.complete import complete
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.prune import without_noise
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.simulation.excitation import excitations

ROBOT = arm()
DRY = Effect("coulomb_friction", (ROBOT.joint_names[1],), {"coulomb_torque": 1.5})
#: Stands for dry friction and takes its place: with it, plain friction of the joint is not asked for.
RICH = Term("stribeck_friction", 1, (("stribeck_velocity", 0.3),))
FALLS = Effect(
    "stribeck_friction",
    (ROBOT.joint_names[1],),
    {"coulomb_torque": 0.5, "static_torque": 2.0, "stribeck_velocity": 0.3},
)
OFFSET = Term("torque_offset", 0)


def named(
    monkeypatch: pytest.MonkeyPatch, sure: Sequence[Term], goes: Sequence[Term], hidden: Effect = DRY
) -> list[tuple[str, int | None]]:
    """What is named in the end where the search was sure of ``sure`` and what ``goes`` turns out to be noise."""
    settings = LoopSettings()
    train, test = excitations(ROBOT, [hidden], train=2, test=1, duration=8.0, rate=250.0)
    judge, terms, _ = gather(Model(ROBOT), read_motion(ROBOT, train, test, settings), settings)
    judge = judge.adding(sure)

    def dropping(judge: Judge, current: Sequence[Term], sure: bool = False) -> tuple[Judge, list[Term]]:
        return without_noise(judge, [t for t in current if t not in goes], sure)

    monkeypatch.setattr(find_module, "_surely", lambda judge, *given: (judge, list(sure), set(), []))
    monkeypatch.setattr(find_module, "without_noise", dropping)
    found = find_module.find(judge, terms, lambda step: None)
    return [(t.effect, t.joint) for t in found.terms]


def test_plain_friction_is_asked_for_where_what_stood_for_it_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    assert named(monkeypatch, [RICH], [RICH]) == [("coulomb_friction", 1)]


def test_what_stays_is_not_asked_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    # Control: the richer law stays, and with it nothing plain is missing; a plain one that goes asks for nothing.
    assert named(monkeypatch, [RICH], [], FALLS) == [("stribeck_friction", 1)]
    asked: list[int] = []

    def counted(judge: Judge, *given: Any) -> tuple[Judge, list[Term]]:
        asked.append(1)
        return complete(judge, *given)

    monkeypatch.setattr(find_module, "complete", counted)
    named(monkeypatch, [OFFSET], [OFFSET])
    assert len(asked) == 1
