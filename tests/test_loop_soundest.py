"""Of several ends of a search the last counts, unless its names are known beside links exactly as described alone."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import pytest
from tests.small_arm import heavier_links
from tests.test_loop_links_beside import ELBOW, FRICTION, SHOULDER, judged
from tests.test_loop_missed import judged as judged_of

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.effects.base import HELD
from hybrid_dynamics.effects.inertial_parameters import LINKS
from hybrid_dynamics.loop import find as find_module
from hybrid_dynamics.loop import known as known_module
from hybrid_dynamics.loop import soundest as module
from hybrid_dynamics.loop.beside import all_beside
from hybrid_dynamics.loop.known import known_and_beside
from hybrid_dynamics.loop.soundest import End, in_doubt, soundest
from hybrid_dynamics.loop.trace import Judge


def test_names_are_in_doubt_that_are_known_beside_exact_links_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    judge, candidates, _, named = judged([heavier_links(0.15), *FRICTION])
    judge, plain = all_beside(judge, named, candidates)
    end = End(judge, named, plain, candidates)
    assert not in_doubt(end, ())

    def nothing_is_known(_: Judge, names: Sequence[Term], __: object, fixed: Collection[Term]) -> Term | None:
        return None if fixed else names[0]

    monkeypatch.setattr(known_module, "_least_known", nothing_is_known)
    assert in_doubt(end, ())
    # Controls: what is given is not asked; links that stand beside the names have been asked for; no name, no doubt;
    # and without the links among what the logs are asked for there is nothing to doubt by.
    assert not in_doubt(end, named)
    near = Term("inertial_parameters", None, ((HELD, 0.25), (LINKS, (SHOULDER, ELBOW))))
    assert not in_doubt(replace(end, judge=judge.adding([near]), beside=[*plain, near]), ())
    assert not in_doubt(replace(end, names=[]), ())
    assert not in_doubt(replace(end, candidates=[c for c in candidates if not c.family().all_links]), ())
    # And where the links are as described there is none either.
    judge, candidates, _, named = judged(FRICTION)
    judge, plain = all_beside(judge, named, candidates)
    assert not in_doubt(End(judge, named, plain, candidates), ())


@pytest.mark.parametrize(
    ("doubted", "left", "taken"),
    [
        ([True], [1.0], 0),
        ([False, False], [1.0, 2.0], 1),
        ([True, False], [1.0, 2.0], 1),
        ([False, True], [2.0, 1.0], 0),
        ([True, False, True], [1.0, 2.0, 1.0], 1),
        ([False, False, True], [1.0, 2.0, 1.0], 0),
        ([False, False, True], [2.0, 1.0, 1.0], 1),
        ([True, True, True], [1.0, 1.0, 1.0], 2),
    ],
)
def test_the_last_end_counts_unless_its_names_are_in_doubt(
    monkeypatch: pytest.MonkeyPatch, doubted: list[bool], left: list[float], taken: int
) -> None:
    nothing: Any = None
    ends = [End(nothing, [Term("torque_offset", k)], [], []) for k in range(len(doubted))]
    monkeypatch.setattr(module, "in_doubt", lambda end, given: doubted[end.names[0].index])
    monkeypatch.setattr(module, "_left", lambda end: left[end.names[0].index])
    assert soundest(ends, []) == taken
    # What has no names, or only those that were given, is no answer to the last.
    for empty in ([], [ends[0].names[0]]):
        if len(doubted) == 2 and taken == 0:
            assert soundest([replace(ends[0], names=empty), ends[1]], ends[0].names) == 1


def test_what_is_found_is_the_sound_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """A spring goes and is missed; what is asked for in its place is in doubt, both by decree, and does not count."""
    spring = Effect("joint_spring", (ELBOW,), {"stiffness": 2.0, "rest_position": 1.0}, {"shape": "linear"})
    dry = Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 0.8})
    judge, terms = judged_of(spring, dry)

    def without(judge: Judge, chosen: Sequence[Term], *rest: Any) -> tuple[Judge, list[Term], list[Term]]:
        judge, names, beside = known_and_beside(judge, chosen, *rest)
        return judge.at(names), [t for t in names if t.effect != "joint_spring"], beside

    monkeypatch.setattr(find_module, "known_and_beside", without)
    anew = find_module.find(judge, terms, lambda step: None)
    assert len(anew.terms) > 1
    asked: list[int] = []

    def doubted(end: End, given: Collection[Term]) -> bool:
        asked.append(len(end.names))
        return len(end.names) > 1

    monkeypatch.setattr(module, "in_doubt", doubted)
    sound = find_module.find(judge, terms, lambda step: None)
    assert [(t.effect, t.joint) for t in sound.terms] == [("coulomb_friction", 0)]
    assert asked[0] > 1
