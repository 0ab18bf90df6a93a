"""A huge offset and a link that no robot has, which nearly undo each other, are no result; plausible ones stay."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from tests.small_arm import heavier_links, noisy_log
from tests.test_loop_beside import SHOULDER, judged
from tests.test_loop_known import ELBOW, ROBOT, one_way
from tests.test_loop_known import judged as judged_of

from hybrid_dynamics.effects import Effect, Term, predict
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.balanced import BEYOND, MOST_TORQUE, balanced, torque_moving, undone
from hybrid_dynamics.loop.find import find
from hybrid_dynamics.trajectory import Trajectory

OFFSET = Term("torque_offset", 0)
FRICTION = Term("coulomb_friction", 0)
#: About one period over the range of the runs, which an offset and a weight can bow after.
BOW = Effect("torque_ripple", (SHOULDER,), {"amplitude": 6.0, "harmonic": 5.0, "phase": 2.0})


def test_an_offset_that_only_an_impossible_link_balances_is_told() -> None:
    judge, chosen, _ = judged([BOW])
    fitted = refit(judge.evidence, [*chosen, OFFSET, FRICTION])
    # The trap is there: an offset many times the law that it follows.
    assert abs(fitted.x[20]) > 3 * BOW.parameters["amplitude"]
    judge = judge.over(fitted.evidence)
    assert balanced(judge, [*chosen, OFFSET, FRICTION]) == [OFFSET]
    # Only where it is asked for.
    assert balanced(judge, [*chosen, OFFSET, FRICTION], [FRICTION]) == []
    assert balanced(judge, [OFFSET, FRICTION]) == []


@pytest.mark.parametrize("share", [0.15, 8.0])
def test_a_true_offset_stays_beside_links_that_are_off_by_themselves(share: float) -> None:
    """Also where the description holds placeholders: nothing named makes the links so."""
    judge, chosen, _ = judged([heavier_links(share), Effect("torque_offset", (SHOULDER,), {"offset": 1.5})])
    assert balanced(judge, [*chosen, OFFSET, FRICTION]) == []
    x, scale = refit(judge.evidence, [*chosen, OFFSET]).x[:20], chosen[0].prior_scale(judge.evidence.robot)
    assert (abs(x / scale).max() > BEYOND) == (share > 1)


def powers(scale: float) -> list[Effect]:
    """scale v (1 - 10 v)^2: it brakes at every speed, and around .1 rad/s its powers undo each other."""
    curved = {"quadratic_coefficient": -20.0 * scale, "cubic_coefficient": 100.0 * scale}
    return [
        Effect("viscous_friction", (ELBOW,), {"viscous_coefficient": scale}),
        Effect("nonlinear_viscous_friction", (ELBOW,), curved),
    ]


def test_powers_of_the_speed_that_undo_each_other_many_times_over_are_told() -> None:
    law = [Term("viscous_friction", 1), Term("nonlinear_viscous_friction", 1)]
    slow = [one_way(powers(3000.0), seed) for seed in (1, 2)]
    judge, _ = judged_of(slow, *law, OFFSET)
    # The trap is there: all there is makes less than a tenth of what one of the powers does.
    x = judge.evidence.fit(law)
    assert x[0] * 0.1 > 5 * MOST_TORQUE * torque_moving(judge.evidence)[1]
    # The largest alone goes: without it the other is no more than there is.
    assert undone(judge, law) == [law[1]]
    assert undone(judge, law[:1]) == []
    # What stands beside them has no part in it.
    assert undone(judge, [OFFSET, *law]) == [law[1]]
    # And a search does not end with them.
    judge, candidates = judged_of(slow)
    found = find(judge, candidates, lambda step: None)
    assert undone(found.judge, found.terms) == []
    assert all(t.effect != "nonlinear_viscous_friction" for t in found.terms)
    # Control: the same law where the joint shows all of it, at .1 rad/s and at ten times that.
    judge, _ = judged_of([noisy_log(powers(1.0), seed, "train", 0.01) for seed in (1, 2)], *law)
    assert undone(judge, law) == []


def hardly_turning(effects: Sequence[Effect], seed: int) -> Trajectory:
    """As :func:`noisy_log`, but the elbow goes to and fro over a tenth of a radian."""
    log = noisy_log([], seed, "train", 0.0)
    rng, time = np.random.default_rng(seed), log.time
    q = np.column_stack([log["q"][:, 0], 0.05 * np.sin(2.0 * time + seed)])
    dq = np.gradient(q, time, axis=0)
    tau = predict(ROBOT, list(effects), q, dq, np.gradient(dq, time, axis=0), time)
    return Trajectory(log.name, "train", time, {"q": q, "dq": dq, "tau": tau + 0.005 * rng.normal(size=tau.shape)})


def test_a_spring_and_an_offset_that_undo_each_other_are_told() -> None:
    """Over a short way a wave and a constant make the bow of any law: on a Med7 that turned by a third of a radian, an
    offset of 9 N m and a spring of 17 where no more than half a newton metre was ever measured."""
    crest = {"stiffness": 200.0, "rest_position": 0.5 * np.pi}
    bow = [
        Effect("joint_spring", (ELBOW,), crest, {"shape": "sine"}),
        Effect("torque_offset", (ELBOW,), {"offset": 200.0}),
    ]
    spring, offset = Term("joint_spring", 1, (("shape", "sine"),)), Term("torque_offset", 1)
    judge, _ = judged_of([hardly_turning(bow, seed) for seed in (1, 2)], spring, offset)
    # The trap is there: both are many times all that there is.
    most = MOST_TORQUE * torque_moving(judge.evidence)[1]
    assert abs(judge.evidence.fit([offset, spring])[0]) > 5 * most
    assert len(undone(judge, [offset, spring])) == 1, "without the one, the other is no more than there is"
    # Control: either alone is as large, and is measured.
    for one, effect in ((spring, bow[0]), (offset, bow[1])):
        judge, _ = judged_of([hardly_turning([effect], seed) for seed in (1, 2)], one)
        assert np.abs(judge.evidence.fit([one])).max() > 5 * most
        assert undone(judge, [one]) == []


@pytest.mark.parametrize(("middle", "rest", "shape"), [(2.0, 2.0, "linear"), (2.5, 2.3, "linear"), (2.0, 2.0, "sine")])
def test_a_spring_far_from_the_zero_of_its_joint_is_no_more_than_there_is(
    middle: float, rest: float, shape: str
) -> None:
    """Its stiffness and where it rests are two numbers of one torque, wherever the URDF has the zero."""
    spring = Effect("joint_spring", (ELBOW,), {"stiffness": 40.0, "rest_position": rest}, {"shape": shape})
    logs = []
    for seed in (1, 2):
        log = noisy_log([], seed, "train", 0.0)
        q = np.column_stack([log["q"][:, 0], middle + 0.4 * np.sin(0.9 * log.time + seed)])
        dq = np.gradient(q, log.time, axis=0)
        tau = predict(ROBOT, [spring], q, dq, np.gradient(dq, log.time, axis=0), log.time)
        tau += 0.02 * np.random.default_rng(seed).normal(size=tau.shape)
        logs.append(Trajectory(log.name, "train", log.time, {"q": q, "dq": dq, "tau": tau}))
    judge, _ = judged_of(logs, term := spring.term(ROBOT))
    # The trap is there: of its coordinates one alone is far more than there is.
    x = judge.evidence.fit([term])
    parts = [judge.evidence.square_at(term, part) for part in np.diag(x)]
    assert shape == "sine" or max(parts) > (MOST_TORQUE * torque_moving(judge.evidence)[1]) ** 2
    assert undone(judge, [term]) == []


def strokes(force: float, seed: int) -> Trajectory:
    """The elbow rests but for a second to and fro in ten; at rest it shows nothing of its friction."""
    log = noisy_log([], seed, "train", 0.0)
    time = log.time
    inside = np.clip(np.mod(time, 10.0) - 4.0, 0.0, 1.0)
    q = np.column_stack([log["q"][:, 0], 0.4 * np.sin(np.pi * inside) ** 2])
    dq = np.gradient(q, time, axis=0)
    tau = predict(ROBOT, [], q, dq, np.gradient(dq, time, axis=0), time)
    tau[:, 1] += force * np.sign(dq[:, 1]) * (np.abs(dq[:, 1]) > 1e-9)
    rng = np.random.default_rng(seed)
    return Trajectory(log.name, "train", time, {"q": q, "dq": dq, "tau": tau + 0.01 * rng.normal(size=tau.shape)})


@pytest.mark.parametrize("force", [5.0, 25.0, 100.0])
def test_friction_that_is_nearly_all_torque_of_a_joint_that_rests_mostly_stays(force: float) -> None:
    law = Term("coulomb_friction", 1)
    judge, _ = judged_of([strokes(force, seed) for seed in (1, 2)], law)
    (x,) = judge.evidence.fit([law])
    assert x == pytest.approx(force, rel=0.05)
    # The trap is there: over all rows it is far more than there is.
    assert x > MOST_TORQUE * judge.evidence.problem.torque_size[1]
    assert undone(judge, [law]) == []
