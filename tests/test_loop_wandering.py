"""What one of the runs surely lacks is no name, and what differs between runs and is there in all of them is one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop import LoopSettings, Model, close_loop
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.loop.wandering import notes_of, wandering

ROBOT = arm()
FIRST, SECOND = ROBOT.joint_names
NOISE = 0.05


def offset(value: float) -> Effect:
    return Effect("torque_offset", (FIRST,), {"offset": value})


def coulomb(value: float) -> Effect:
    return Effect("coulomb_friction", (FIRST,), {"coulomb_torque": value})


def judged(by_run: Sequence[Effect], start: Sequence[Effect] = ()) -> tuple[Judge, Term]:
    """The judge of one run for each effect, at the model that has one such effect for all, and its term."""
    settings = LoopSettings()
    train = [noisy_log([effect], seed, "train", NOISE) for seed, effect in enumerate(by_run, 1)]
    judge, _, _ = gather(Model(ROBOT, tuple(start)), read_motion(ROBOT, train, [], settings), settings)
    term = by_run[0].term(ROBOT)
    return judge.adding([term]).at([term]), term


def test_a_constant_that_runs_do_not_have_is_none() -> None:
    judge, term = judged([offset(-2.0), offset(0.6), offset(-1.7)])
    assert wandering(judge, [term]) == {term: ["train_2"]}
    (note,) = notes_of(wandering(judge, [term]), ROBOT.joint_names)
    assert note.startswith(f"torque_offset of {FIRST}: train_2 surely has less than half of it, so it is no finding")
    # Controls: the same in all runs, or what is given.
    assert wandering(judge, [term], [term]) == {}
    judge, term = judged([offset(-2.0)] * 3)
    assert wandering(judge, [term]) == {}


@pytest.mark.parametrize("sizes", [(0.8, 1.6), (1.0, 1.0), (1.0, 2.2, 1.2)])
def test_friction_that_is_twice_as_large_in_a_cold_run_is_friction_in_all(sizes: Sequence[float]) -> None:
    judge, term = judged([coulomb(size) for size in sizes])
    assert wandering(judge, [term]) == {}


def test_a_gain_is_measured_from_one() -> None:
    """Of 1.3 in one run and none in another, 1.0 is more than half of the mean, and nothing of what it is about."""

    def gain(value: float) -> Effect:
        return Effect("torque_gain", (FIRST,), {"gain": value})

    judge, term = judged([gain(1.3), gain(1.0), gain(1.3)])
    assert wandering(judge, [term]) == {term: ["train_2"]}
    judge, term = judged([gain(1.3), gain(1.2), gain(1.3)])
    assert wandering(judge, [term]) == {}


def test_a_run_that_knows_little_of_it_contradicts_nothing() -> None:
    """The joint hardly moves there, so its friction could be anything."""
    still = noisy_log([coulomb(1.0)], 2, "train", NOISE)
    q = still["q"] * np.array([1e-3, 1.0])
    dq = still["dq"] * np.array([1e-3, 1.0])
    tau = ROBOT.inverse_dynamics(q, dq, np.gradient(dq, still.time, axis=0))
    rng = np.random.default_rng(7)
    still = still.with_signals(q=q, dq=dq, tau=tau + NOISE * rng.normal(size=tau.shape))
    settings = LoopSettings()
    moving = noisy_log([coulomb(1.0)], 1, "train", NOISE)
    judge, _, _ = gather(Model(ROBOT), read_motion(ROBOT, [moving, still], [], settings), settings)
    term = coulomb(1.0).term(ROBOT)
    assert wandering(judge.adding([term]).at([term]), [term]) == {}


def test_one_run_contradicts_nothing() -> None:
    judge, term = judged([offset(-2.0)])
    assert wandering(judge, [term]) == {}


def test_the_loop_does_not_name_it_and_says_why() -> None:
    """A constant of the first joint differs from run to run, and is nothing in one; its friction is the same in all."""
    sizes = (-2.0, 0.6, -1.7, -2.2)
    train = [noisy_log([coulomb(1.0), offset(size)], seed, "train", NOISE) for seed, size in enumerate(sizes, 1)]
    test = [noisy_log([coulomb(1.0), offset(-1.0)], 9, "test", NOISE)]
    diagnosis = close_loop(ROBOT, train, test, LoopSettings(effects=("coulomb_friction", "torque_offset"))).diagnosis
    assert [(e.effect.effect, e.effect.joints) for e in diagnosis.effects] == [("coulomb_friction", (FIRST,))]
    assert any("train_2 surely has less than half of it" in note for note in diagnosis.notes)
    assert diagnosis.verdict != "explained"
