"""What a fast ripple drowns is found once that is there; what a costlier law stands for is asked in its place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.effects.inertia import BODY_PARAMETERS
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop.cheaper import cheaper
from hybrid_dynamics.loop.find import beside_loud, find
from hybrid_dynamics.loop.further import EXCESS, further_candidates
from hybrid_dynamics.loop.narrow import narrowed
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.search import Step
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.trajectory import Trajectory

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
NOISE = 0.1


def judged(*hidden: Effect, seed: int = 1) -> tuple[Judge, list[Term]]:
    settings = LoopSettings()
    train = [noisy_log(hidden, seed + k, "train", NOISE) for k in (0, 1)]
    logs = read_motion(ROBOT, train, [noisy_log(hidden, seed + 50, "test", NOISE)], settings)
    judge, terms, _ = gather(Model(ROBOT), logs, settings)
    return judge, terms


def silent(step: Step) -> None:
    """Nobody looks on."""


def ripple(amplitude: float, harmonic: float) -> Effect:
    values = {"amplitude": amplitude, "harmonic": harmonic, "phase": 0.4}
    return Effect("torque_ripple", (ELBOW,), values)


@pytest.mark.parametrize("seed", range(3))
def test_friction_that_a_ripple_had_drowned_is_named_beside_it(seed: int) -> None:
    friction = Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 0.3})
    judge, terms = judged(friction, ripple(4.0, 30.0), seed=seed)
    # Of what the ripple makes the friction is nothing that matters.
    assert judge.floor[1] > 5 * 0.3
    found = find(judge, terms, silent)
    assert sorted(t.effect for t in found.terms if t.joint == 1) == ["coulomb_friction", "torque_ripple"]
    assert found.judge.floor[1] < 2 * NOISE
    # Control: without it there is the ripple alone.
    found = find(*judged(ripple(4.0, 30.0), seed=seed), silent)
    assert [t.effect for t in found.terms] == ["torque_ripple"]


@pytest.mark.parametrize("unnamed", [6.0, 0.0])
def test_a_law_without_a_name_does_not_outweigh_what_other_joints_lack(unnamed: float) -> None:
    """Joints count by what is left of them once the search has ended, and what is too small to matter stays so."""
    friction = Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 0.5})

    def log(seed: int, split: str) -> Trajectory:
        run = noisy_log([friction] if unnamed else [], seed, split, NOISE)
        tau = run["tau"].copy()
        tau[:, 1] += unnamed * np.sin(2.3 * run["q"][:, 0] + 1.7 * run["q"][:, 1])
        return run.with_signals(tau=tau)

    logs = read_motion(ROBOT, [log(1, "train"), log(2, "train")], [log(51, "test")], LoopSettings())
    judge, terms, _ = gather(Model(ROBOT), logs, LoopSettings())
    left = np.sqrt(judge.mean_square(judge.evidence.held([])))
    there, found, steps = beside_loud(judge, [], terms, silent)
    if unnamed:
        assert left[1] > 3 * judge.floor[1]
        assert [(t.effect, t.joint) for t in found] == [("coulomb_friction", 0)]
        np.testing.assert_allclose(there.evidence.weights * np.maximum(left, judge.floor) ** 2, 1.0, rtol=1e-9)
        np.testing.assert_array_equal(there.floor, judge.floor)
    else:
        # Control: where no joint is louder than another nothing is asked twice.
        assert (there, found, steps) == (judge, [], [])


def test_a_ripple_is_proposed_where_all_of_it_passes_for_noise() -> None:
    def slow(*hidden: Effect) -> tuple[Judge, list[Term]]:
        """A log so slow that a filter's window holds a period, and what is offered."""
        logs = [noisy_log(hidden, k, "train", NOISE) for k in (1, 2)]
        logs = [replace(r, time=r.time[::3], signals={k: v[::3] for k, v in r.signals.items()}) for r in logs]
        judge, _, _ = gather(Model(ROBOT), read_motion(ROBOT, logs, [], LoopSettings()), LoopSettings())
        return judge, further_candidates(judge, [])[1]

    judge, offered = slow(ripple(1.0, 30.0))
    assert judge.mean_square(judge.evidence.held([]))[1] < (1.0 + EXCESS) * judge.low[1] ** 2
    assert any(t.effect == "torque_ripple" and abs(t.options["harmonic"] - 30.0) < 0.1 for t in offered)
    # Control: where there is none noise proposes no such wave.
    _, offered = slow()
    assert not any(t.effect == "torque_ripple" and abs(t.options["harmonic"] - 30.0) < 0.5 for t in offered)


def test_a_gain_and_a_spring_of_one_joint_are_offered_though_the_gain_alone_is_nothing() -> None:
    spring = Effect("joint_spring", (ELBOW,), {"stiffness": 1.5, "rest_position": 0.5}, {"shape": "linear"})
    gain = Effect("torque_gain", (ELBOW,), {"gain": 1.37})
    judge, terms = judged(spring, gain)
    offset = next(t for t in terms if t.effect == "torque_offset" and t.joint == 1)
    held = judge.adding([Term("torque_gain", 1)]).at([offset]).evidence.held
    assert held([offset, Term("torque_gain", 1)]).score >= held([offset]).score
    _, offered = further_candidates(judge.at([offset]), [offset])
    assert {"torque_gain", "joint_spring"} <= {t.effect for t in offered if t.joint == 1}
    found = find(*judged(spring, gain), silent)
    assert sorted(t.effect for t in found.terms) == ["joint_spring", "torque_gain"]


ZERO, CENTRE = Term("position_offset", 1), Term("link_com", 1)


@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_zero_is_named_and_not_the_centre_of_its_link(seed: int) -> None:
    judge, _ = judged(Effect("position_offset", (ELBOW,), {"offset": 0.03}), seed=seed)
    judge = judge.adding([CENTRE, ZERO])
    assert cheaper(judge, [CENTRE])[1] == [ZERO]
    # A body of ten numbers that holds such a centre, too.
    body = Term("link_inertia", 1)
    assert cheaper(judge.adding([body]), [body])[1] == [ZERO]
    # Control: a link's centre that no turn of the joint makes stays.
    far = Effect("link_com", (ELBOW,), {"com_x": 0.0, "com_y": 0.0, "com_z": 0.35})
    judge, _ = judged(far, seed=seed)
    assert cheaper(judge.adding([CENTRE, ZERO]), [CENTRE])[1] == [CENTRE]


def test_a_change_of_the_starting_model_is_not_made_another_effect() -> None:
    start = Model(ROBOT, (Effect("link_com", (ELBOW,), {"com_x": 0.01, "com_y": 0.0, "com_z": 0.2}),))
    settings = LoopSettings()
    hidden = [Effect("position_offset", (ELBOW,), {"offset": 0.03})]
    logs = read_motion(ROBOT, [noisy_log(hidden, k, "train", NOISE) for k in (1, 2)], [], settings)
    judge, _, _ = gather(start, logs, settings)
    assert cheaper(judge.adding([CENTRE, ZERO]), [CENTRE])[1] == [CENTRE]


@pytest.mark.parametrize("seed", range(3))
def test_a_centre_of_the_last_link_that_no_payload_makes_stands_for_all_links(seed: int) -> None:
    # Nearer to the joint than the URDF says: a payload would have to weigh less than nothing.
    judge, terms = judged(Effect("link_com", (ELBOW,), {"com_x": 0.0, "com_y": 0.0, "com_z": 0.13}), seed=seed)
    links = [t for t in terms if t.family().all_links]
    assert narrowed(judge.at(links), links)[1] == [CENTRE]


@pytest.mark.parametrize("seed", range(3))
def test_a_links_mass_and_a_payload_stand_for_all_links(seed: int) -> None:
    tool = dict(
        zip((p.name for p in BODY_PARAMETERS), (0.8, 0.1, 0.0, 0.1, *[0.004, 0.0] * 2, 0.0, 0.004), strict=True)
    )
    judge, terms = judged(Effect("link_mass", (SHOULDER,), {"mass": 5.0}), Effect("payload", (), tool), seed=seed)
    links = [t for t in terms if t.family().all_links]
    assert set(narrowed(judge.at(links), links)[1]) == {Term("link_mass", 0), Term("payload")}
