"""What one of the runs surely lacks is no name, and what differs between runs and is there in all of them is one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect, Term, predict
from hybrid_dynamics.loop import LoopSettings, Model, close_loop
from hybrid_dynamics.loop.augment import refit
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.loop.wandering import wandering, without_wandering
from hybrid_dynamics.trajectory import Trajectory

ROBOT = arm()
FIRST, SECOND = ROBOT.joint_names
NOISE = 0.05


def offset(value: float) -> Effect:
    return Effect("torque_offset", (FIRST,), {"offset": value})


def coulomb(value: float) -> Effect:
    return Effect("coulomb_friction", (FIRST,), {"coulomb_torque": value})


def viscous(value: float) -> Effect:
    return Effect("viscous_friction", (FIRST,), {"viscous_coefficient": value})


def log(effects: Sequence[Effect], seed: int, noise: float = NOISE) -> Trajectory:
    return noisy_log(effects, seed, "train", noise)


def judged(
    train: Sequence[Trajectory], effects: Sequence[Effect], start: Model | None = None
) -> tuple[Judge, list[Term]]:
    """The judge of ``train`` at the model that has ``effects``, the same for all runs, and their terms."""
    settings = LoopSettings()
    judge, _, _ = gather(start or Model(ROBOT), read_motion(ROBOT, train, [], settings), settings)
    terms = [effect.term(ROBOT) for effect in effects]
    return judge.adding(terms).at(terms), terms


def lacked(train: Sequence[Trajectory], effects: Sequence[Effect], start: Model | None = None) -> dict[str, list[str]]:
    """Of the names of ``effects`` those that runs lack, with these runs."""
    judge, terms = judged(train, effects, start)
    fitted = refit(judge.evidence, terms)
    found = wandering(judge.over(fitted.evidence), terms, fitted.x, terms)
    return {term.effect: [name for name, *_ in said] for term, (_, said) in found.items()}


@pytest.mark.parametrize("noise", [(NOISE, NOISE, NOISE), (0.5, 0.05, 0.5), (0.05, 0.05, 0.5)])
def test_a_constant_that_one_run_does_not_have_is_none(noise: Sequence[float]) -> None:
    """Whichever run is known best: it is the value that is named which a run lacks."""
    sizes = (-2.0, 0.6, -1.7)
    train = [log([offset(size)], seed, own) for seed, (size, own) in enumerate(zip(sizes, noise, strict=True), 1)]
    assert lacked(train, [offset(-1.0)]) == {"torque_offset": ["train_2"]}
    # The control: the same in all runs.
    assert lacked([log([offset(-2.0)], seed) for seed in (1, 2, 3)], [offset(-2.0)]) == {}


@pytest.mark.parametrize(("least", "lacks"), [(0.85, True), (1.35, False)])
def test_a_run_that_has_more_than_half_has_it(least: float, lacks: bool) -> None:
    """Of 2.6, 2.2 and .85 the mean is about 1.9, of 2.6, 2.2 and 1.35 about 2.05."""
    train = [log([offset(size)], seed) for seed, size in enumerate((2.6, 2.2, least), 1)]
    assert bool(lacked(train, [offset(2.0)])) == lacks


@pytest.mark.parametrize("sizes", [(0.8, 1.6), (1.0, 2.2, 1.2)])
def test_friction_that_is_twice_as_large_in_a_cold_run_is_friction_in_all(sizes: Sequence[float]) -> None:
    train = [log([coulomb(size), viscous(0.3)], seed) for seed, size in enumerate(sizes, 1)]
    assert lacked(train, [coulomb(1.0), viscous(0.3)]) == {}


def test_a_run_that_knows_little_of_it_contradicts_nothing() -> None:
    """What it says is far below half, and its error far above that."""
    train = [log([offset(size)], seed) for seed, size in enumerate((2.0, 3.0), 1)]
    third = log([offset(0.4)], 3)
    rng = np.random.default_rng(5)
    # Slow noise of several newton metres: the mean of a run is hardly known.
    slow = np.cumsum(rng.normal(size=len(third.time))) * 0.25
    noisy = third.with_signals(tau=third["tau"] + slow[:, None] * [1.0, 0.0])
    assert lacked([*train, noisy], [offset(2.0)]) == {}
    # The control: without the noise it contradicts.
    assert lacked([*train, third], [offset(2.0)]) == {"torque_offset": ["train_3"]}


def test_of_what_the_starting_model_has_the_change_may_be_any_in_every_run() -> None:
    train = [log([coulomb(size)], seed) for seed, size in enumerate((5.8, 5.1, 5.8, 5.9), 1)]
    assert lacked(train, [coulomb(0.6)], Model(ROBOT, (coulomb(5.0),))) == {}


def test_one_run_contradicts_nothing() -> None:
    assert lacked([log([offset(-2.0)], 1)], [offset(-2.0)]) == {}


def test_what_goes_stays_in_the_model_and_is_told() -> None:
    sizes = (-2.0, 0.6, -1.7)
    train = [log([coulomb(1.0), offset(size)], seed) for seed, size in enumerate(sizes, 1)]
    judge, terms = judged(train, [coulomb(1.0), offset(-1.0)])
    there, names, beside, (note,) = without_wandering(judge, terms, [])
    assert [t.effect for t in names] == ["coulomb_friction"]
    assert [(t.effect, t.joint) for t in beside] == [("torque_offset", 0)]
    assert note.startswith(f"torque_offset of {FIRST}: -1.0")
    assert "N m fit all runs together, and train_2 0.6 +- " in note
    # What is predicted is nearly what was: it is held within the size that was found.
    found = refit(there.evidence, [*names, *beside]).x
    assert found[-1] == pytest.approx(refit(judge.evidence, terms).x[-1], rel=0.1)
    assert without_wandering(judge, terms, [], terms)[1:] == (terms, [], [])
    # With no name left nothing is estimated beside.
    alone, (single,) = judged([log([offset(size)], seed) for seed, size in enumerate(sizes, 1)], [offset(-1.0)])
    assert without_wandering(alone, [single], [])[1:3] == ([], [])


def test_the_loop_does_not_name_it_and_says_why_once() -> None:
    """A constant of the first joint differs from run to run, and is nothing in one; its friction is the same in all."""
    sizes = (-2.0, 0.6, -1.7, -2.2)
    train = [log([coulomb(1.0), offset(size)], seed) for seed, size in enumerate(sizes, 1)]
    test = [noisy_log([coulomb(1.0), offset(-1.0)], 9, "test", NOISE)]
    diagnosis = close_loop(ROBOT, train, test, LoopSettings(effects=("coulomb_friction", "torque_offset"))).diagnosis
    assert [(e.effect.effect, e.effect.joints) for e in diagnosis.effects] == [("coulomb_friction", (FIRST,))]
    assert sum("train_2 0.6" in note for note in diagnosis.notes) == 1
    assert diagnosis.verdict != "explained"


def test_a_run_in_which_the_joint_turns_one_way_tells_no_friction_from_an_offset() -> None:
    """There they are one column: of neither it says how much, and it is solved all the same."""
    time = np.arange(4000) / 200.0
    q = np.stack([0.6 * time - 0.3 * np.cos(time), 0.4 * np.sin(1.3 * time)], axis=1)
    dq, rng = np.gradient(q, time, axis=0), np.random.default_rng(3)
    tau = predict(ROBOT, [coulomb(1.0), offset(-1.4)], q, dq, np.gradient(dq, time, axis=0), time)
    one_way = Trajectory("one_way", "train", time, {"q": q, "dq": dq, "tau": tau + NOISE * rng.normal(size=tau.shape)})
    train = [*(log([coulomb(1.0), offset(0.9)], seed) for seed in (1, 2)), one_way]
    assert lacked(train, [coulomb(1.0), offset(0.9)]) == {}
    # The control: with no friction beside it, the constant of that run is known.
    judge, (_, constant) = judged(train, [coulomb(1.0), offset(0.9)])
    fitted = refit(judge.evidence, [constant])
    assert wandering(judge.over(fitted.evidence), [constant], fitted.x, [constant])
