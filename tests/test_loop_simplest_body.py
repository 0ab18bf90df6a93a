"""Of bodies on one link the simplest that does as well is named; a body that brings more keeps its own name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.effects.inertia import BODY_PARAMETERS
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop.alternatives import indistinguishable
from hybrid_dynamics.loop.find import find
from hybrid_dynamics.loop.found import Found
from hybrid_dynamics.loop.further import _special_cases, simplify_bodies
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.simulation.excitation import excitations

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
PAYLOAD = Term("payload")
#: A block beside the elbow's link: its own mass, its own centre of mass.
BLOCK = dict(
    zip((p.name for p in BODY_PARAMETERS), (1.0, 0.1, 0.0, 0.05, 0.004, 0.0, 0.004, 0.0, 0.0, 0.004), strict=True)
)
FAR = {"com_x": 0.1, "com_y": 0.0, "com_z": 0.3}


def judged(effects: Sequence[Effect]) -> tuple[Judge, list[Term]]:
    settings = LoopSettings()
    train, test = excitations(ROBOT, effects, train=2, test=1, duration=8.0, rate=250.0)
    judge, terms, _ = gather(Model(ROBOT), read_motion(ROBOT, train, test, settings), settings)
    return judge, terms


def found(effects: Sequence[Effect]) -> tuple[Found, list[tuple[str, list[str]]]]:
    """What is found of ``effects``, and with which others it may be confused."""
    judge, terms = judged(effects)
    out = find(judge, terms, lambda step: None)
    listed: dict[Term, list[dict[str, Any]]] = indistinguishable(out.judge, out.terms, terms)
    return out, [(e["effect"], e["joints"]) for own in listed.values() for entry in own for e in entry["effects"]]


@pytest.mark.parametrize(
    ("hidden", "richer"),
    [
        (Effect("link_mass", (ELBOW,), {"mass": 3.0}), ("payload", [])),
        (Effect("link_mass", (SHOULDER,), {"mass": 6.0}), ("link_inertia", [SHOULDER])),
        (Effect("link_com", (ELBOW,), FAR), ("payload", [])),
        (Effect("link_com", (SHOULDER,), FAR), ("link_inertia", [SHOULDER])),
    ],
    ids=["mass of the last", "mass", "centre of the last", "centre"],
)
def test_mass_or_centre_of_a_link_alone_is_named(hidden: Effect, richer: tuple[str, list[str]]) -> None:
    out, alike = found([hidden])
    (effect,) = out.effects()
    assert (effect.effect, effect.joints) == (hidden.effect, hidden.joints)
    assert effect.parameters == pytest.approx(hidden.parameters, abs=0.01)
    # The richer body does as well, and is told.
    assert richer in alike


@pytest.mark.parametrize("times", [1.0, 5.0])
def test_a_block_with_its_own_centre_stays_a_payload(times: float) -> None:
    body = {name: value if name.startswith("com") else times * value for name, value in BLOCK.items()}
    out, alike = found([Effect("payload", (), body)])
    (effect,) = out.effects()
    assert effect.effect == "payload"
    assert effect.parameters["mass"] == pytest.approx(times, rel=0.02)
    assert ("link_inertia", [ELBOW]) in alike
    assert not any(name in ("link_mass", "link_com") for name, _ in alike)


def test_the_mass_of_another_link_takes_the_place_of_a_body_that_stood_for_it() -> None:
    judge, terms = judged([Effect("link_mass", (SHOULDER,), {"mass": 6.0})])
    assert simplify_bodies(judge, [PAYLOAD], terms)[1] == [Term("link_mass", 0)]
    judge, terms = judged([Effect("link_mass", (ELBOW,), {"mass": 3.0})])
    assert simplify_bodies(judge, [PAYLOAD], terms)[1] == [Term("link_mass", 1)]
    # A body of its own is neither link's.
    judge, terms = judged([Effect("payload", (), BLOCK)])
    assert simplify_bodies(judge, [PAYLOAD], terms)[1] == [PAYLOAD]


def test_a_mass_takes_the_place_of_a_centre_that_stood_for_it() -> None:
    centre = Term("link_com", 0)
    judge, terms = judged([Effect("link_mass", (SHOULDER,), {"mass": 6.0})])
    assert simplify_bodies(judge.adding([centre]), [centre], terms)[1] == [Term("link_mass", 0)]
    # A centre that lies elsewhere is no mass.
    judge, terms = judged([Effect("link_com", (SHOULDER,), FAR)])
    assert simplify_bodies(judge.adding([centre]), [centre], terms)[1] == [centre]


def test_mass_and_centre_of_every_link_are_asked_once() -> None:
    judge, terms = judged([Effect("link_mass", (SHOULDER,), {"mass": 6.0})])
    for term in (Term("link_inertia", 0), PAYLOAD):
        asked = _special_cases(judge, [term], term, [Term("link_mass", 1), *terms])
        assert sorted((t.effect, t.joint) for t in asked) == [(e, j) for e in ("link_com", "link_mass") for j in (0, 1)]


def test_a_payload_may_show_on_one_joint_and_what_all_links_or_joints_share_on_two() -> None:
    judge, terms = judged([Effect("payload", (), BLOCK)])
    shared = [t for t in terms if t.joint is None and t != PAYLOAD and t.family().scope == "robot"]
    assert any(t.family().all_links for t in shared)
    assert judge.needed(PAYLOAD) == 1
    assert {judge.needed(t) for t in shared} == {2}
