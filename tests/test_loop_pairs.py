"""Two effects of a joint that only show side by side are asked together."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop import search as search_module
from hybrid_dynamics.loop.pairs import pair_on_a_joint
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.search import search
from hybrid_dynamics.loop.trace import Judge, rank

ROBOT = arm()
SHOULDER, _ = ROBOT.joint_names
SETTINGS = LoopSettings(effects=("coulomb_friction", "viscous_friction", "stribeck_friction"), sign_widths=(0.0,))
#: Of the torque [N m].
NOISE = 0.3
#: Stribeck friction (Coulomb 1 N m) that falls with speed as viscous friction rises: neither is much without the other.
HIDING = [(2.0, 0.3, 1.5), (3.0, 0.3, 3.0), (3.0, 0.1, 1.5)]


def _judged(effects: Sequence[Effect], seed: int = 1) -> tuple[Judge, list[Term], list[Term]]:
    """Judge, candidates, and the shoulder's Coulomb friction, where a search that adds one at a time has come to."""
    logs = read_motion(
        ROBOT, [noisy_log(effects, seed, "train", NOISE)], [noisy_log(effects, seed + 50, "test", NOISE)], SETTINGS
    )
    judge, terms, _ = gather(Model(ROBOT), logs, SETTINGS)
    return judge, terms, [t for t in terms if t.effect == "coulomb_friction" and t.joint == 0]


def _hidden(static: float, speed: float, viscous: float) -> list[Effect]:
    curve = {"coulomb_torque": 1.0, "static_torque": static, "stribeck_velocity": speed}
    return [
        Effect("stribeck_friction", (SHOULDER,), curve),
        Effect("viscous_friction", (SHOULDER,), {"viscous_coefficient": viscous}),
    ]


@pytest.mark.parametrize(("static", "speed", "viscous"), HIDING)
def test_a_pair_is_found_where_no_single_effect_comes_in(
    static: float, speed: float, viscous: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = {"stribeck_friction", "viscous_friction"}
    judge, terms, start = _judged(_hidden(static, speed, viscous))
    before = judge.evidence.held(start, physical=True)
    assert not [c for c in rank(judge, start, terms, before) if c.accepted and c.term.joint == 0]
    pair = pair_on_a_joint(judge, start, terms, before, set())
    assert pair is not None
    assert {t.effect for t in pair} == truth
    found = search(judge, terms, lambda step: None, start)[1][-1].terms
    assert {t.effect for t in found if t.joint == 0} == truth
    # Control: one at a time the search stops before both.
    monkeypatch.setattr(search_module, "pair_on_a_joint", lambda *_: None)
    alone = search(judge, terms, lambda step: None, start, replacing=False)[1][-1].terms
    assert {t.effect for t in alone if t.joint == 0} == {"coulomb_friction"}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_no_pair_where_one_effect_is_all_that_is_missing_or_nothing(seed: int) -> None:
    coulomb = Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 1.0})
    viscous = Effect("viscous_friction", (SHOULDER,), {"viscous_coefficient": 1.5})
    for hidden in ([coulomb, viscous], [coulomb]):
        judge, terms, start = _judged(hidden, seed)
        assert pair_on_a_joint(judge, start, terms, judge.evidence.held(start, physical=True), set()) is None


def test_a_pair_that_had_its_turn_is_not_found_again() -> None:
    judge, terms, start = _judged(_hidden(*HIDING[0]))
    before = judge.evidence.held(start, physical=True)
    seen: set[frozenset[Term]] = set()
    met = []
    while (pair := pair_on_a_joint(judge, start, terms, before, seen)) is not None:
        met.append(pair)
        # Stribeck friction holds the Coulomb friction of the start.
        seen.add(frozenset(pair))
    assert met
    assert len(set(met)) == len(met)
