"""What changes of an arm whose links are known is what it carries, unless the logs surely say another thing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from tests.panda_arm import FINGERS, JOINTS

from hybrid_dynamics.effects import Effect, Term, family
from hybrid_dynamics.effects.inertia import link_parameters, to_body
from hybrid_dynamics.loop import LoopSettings, Model, in_the_hand
from hybrid_dynamics.loop.in_the_hand import payload_for_links
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation.excitation import excitations
from hybrid_dynamics.trajectory import Trajectory

ROBOT = Robot.from_urdf(find_description("panda.urdf"), (*FINGERS, *JOINTS[4:]))
HAND = Term("payload")
PAYLOAD = Effect("payload", (), to_body(np.array([2.0, 0.1, 0.04, 0.12, 0.03, 0.0, 0.03, 0.0, 0.0, 0.02])))
FRICTION = [Effect("viscous_friction", (j,), {"viscous_coefficient": 0.8}) for j in ROBOT.joint_names]


def calibrated() -> Model:
    """The arm with its links identified: a twentieth heavier than described."""
    (links,) = family("inertial_parameters").terms(ROBOT, np.ones(4, bool), {})
    change = np.concatenate([0.05 * link_parameters(ROBOT, k) for k in range(4)])
    heavier = Effect(links.effect, (), links.family().parameters_of(change, ROBOT, links), dict(links.settings))
    return Model(ROBOT, (heavier, *FRICTION))


def heavier_link(link: int, share: float) -> Effect:
    """The body of ``link`` (0-based) of the calibrated arm, heavier by ``share``."""
    own = link_parameters(calibrated().completed_robot, link)
    return Effect("link_inertia", (ROBOT.joint_names[link],), to_body((1 + share) * own))


def judged(start: Model, hidden: Sequence[Effect]) -> tuple[Judge, list[Term]]:
    """The judge of four seconds of the calibrated arm with what is ``hidden``, asked by ``start``."""
    arm = calibrated().adding(hidden)
    train, test = excitations(ROBOT, arm.effects, train=1, test=1, duration=4.0, rate=200.0)
    rng = np.random.default_rng(2)

    def noisy(run: Trajectory) -> Trajectory:
        return run.with_signals(tau=run["tau"] + 0.2 * rng.normal(size=run["tau"].shape))

    settings = LoopSettings()
    logs = read_motion(ROBOT, [noisy(run) for run in train], [noisy(run) for run in test], settings)
    judge, terms, _ = gather(start, logs, settings)
    return judge, terms


@pytest.mark.parametrize("link", [1, 2])
def test_a_payload_takes_the_place_of_a_link_that_stood_for_it(link):
    judge, terms = judged(calibrated(), [PAYLOAD])
    chosen = [Term("link_inertia", link), Term("coulomb_friction", 0)]
    there, found = payload_for_links(judge.adding(chosen).at(chosen), chosen, terms)
    assert set(found) == {HAND, Term("coulomb_friction", 0)}
    assert there.evidence.has(HAND)


def test_a_link_that_predicts_surely_better_stays():
    judge, terms = judged(calibrated(), [heavier_link(1, 0.5)])
    chosen = [Term("link_inertia", 1)]
    assert payload_for_links(judge.adding(chosen).at(chosen), chosen, terms)[1] == chosen


def test_the_burden_of_proof_is_the_links(monkeypatch):
    judge, terms = judged(calibrated(), [heavier_link(2, 1.0)])
    chosen = [Term("link_inertia", 2)]
    judge = judge.adding(chosen).at(chosen)
    # A payload gains surely, but the link that is heavier predicts surely better still.
    assert payload_for_links(judge, chosen, terms)[1] == chosen
    monkeypatch.setattr(in_the_hand, "as_likely", lambda *of: True)
    assert payload_for_links(judge, chosen, terms)[1] == [HAND]


def test_of_two_links_the_one_that_stood_for_a_payload_goes(monkeypatch):
    judge, terms = judged(calibrated(), [PAYLOAD])
    chosen = [Term("link_inertia", 1), Term("link_inertia", 2)]
    judge = judge.adding(chosen).at(chosen)
    # Both would predict surely better; without the second they would not.
    answers = iter([False, False, True])
    monkeypatch.setattr(in_the_hand, "as_likely", lambda *of: next(answers))
    assert payload_for_links(judge, chosen, terms)[1] == [Term("link_inertia", 1), HAND]


def test_a_payload_that_cannot_be_takes_no_place():
    body = to_body(np.array([25.0, 0.5, 0.2, 0.6, 0.3, 0.0, 0.3, 0.0, 0.0, 0.2]))
    judge, terms = judged(calibrated(), [Effect("payload", (), body)])
    chosen = [Term("link_inertia", 2)]
    assert payload_for_links(judge.adding(chosen).at(chosen), chosen, terms)[1] == chosen


def test_a_payload_that_is_nothing_comes_in_the_place_of_no_link():
    judge, terms = judged(calibrated(), [])
    chosen = [Term("link_mass", 1)]
    assert payload_for_links(judge.adding(chosen).at(chosen), chosen, terms)[1] == chosen


def test_of_an_arm_that_was_never_calibrated_links_may_be_off():
    judge, terms = judged(Model(ROBOT), [PAYLOAD])
    chosen = [Term("link_inertia", 2)]
    assert payload_for_links(judge.adding(chosen).at(chosen), chosen, terms)[1] == chosen


def test_what_is_carried_already_is_not_asked_again():
    judge, terms = judged(calibrated(), [PAYLOAD])
    chosen = [Term("link_inertia", 2), HAND]
    assert payload_for_links(judge.adding(chosen).at(chosen), chosen, terms)[1] == chosen
