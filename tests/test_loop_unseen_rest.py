"""What a named law may have besides is listed where the runs would not show it, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect, Term, predict
from hybrid_dynamics.loop import LoopSettings, Model, close_loop
from hybrid_dynamics.loop.alternatives import indistinguishable
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.loop.unseen import unseen_beside
from hybrid_dynamics.trajectory import Trajectory

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
DRY = Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 0.6})
#: Twice the Coulomb torque below a tenth of the runs' speeds.
RISE = Effect("stribeck_friction", (ELBOW,), {"coulomb_torque": 0.6, "static_torque": 1.2, "stribeck_velocity": 0.02})
SETTINGS = LoopSettings(sign_widths=(0.0,))
NOISE = 0.2


def _log(effect: Effect, seed: int, split: str, pace: float) -> Trajectory:
    """A run of the arm that takes ``1 / pace`` times as long."""
    slow = noisy_log([], seed, split, 0.0)
    return noisy_log([effect], seed, split, NOISE) if pace == 1 else _again(slow, effect, pace, seed)


def _again(log: Trajectory, effect: Effect, pace: float, seed: int) -> Trajectory:
    """``log`` with its clock slower, and the torque that the arm with ``effect`` needs then."""
    time = log.time / pace
    dq = log["dq"] * pace
    ddq = np.gradient(dq, time, axis=0)
    tau = predict(ROBOT, [effect], log["q"], dq, ddq, time)
    tau = tau + NOISE * np.random.default_rng(seed + 100).normal(size=tau.shape)
    return replace(log, time=time, signals={"q": log["q"], "dq": dq, "tau": tau})


def _listed(effect: Effect, pace: float) -> list[Term]:
    """What is listed beside Coulomb friction of the elbow, named alone."""
    train = [_log(effect, seed, "train", pace) for seed in (1, 2)]
    logs = read_motion(ROBOT, train, [_log(effect, 51, "test", pace)], SETTINGS)
    judge, terms, _ = gather(Model(ROBOT), logs, SETTINGS)
    dry = next(t for t in terms if t.effect == "coulomb_friction" and t.joint == 1)
    judge = judge.at([dry])
    assert isinstance(judge, Judge)
    return unseen_beside(judge, [dry], dry)


@pytest.mark.parametrize("effect", [DRY, RISE], ids=["dry", "with a rise"])
def test_a_rise_that_fast_runs_do_not_show_is_listed(effect: Effect) -> None:
    (general,) = _listed(effect, 1.0)
    assert (general.effect, general.joint) == ("stribeck_friction", 1)


def test_what_slow_runs_show_is_not_there_is_not_listed() -> None:
    assert _listed(DRY, 0.05) == []


def test_it_is_told_with_the_motion_that_would_tell() -> None:
    train = [_log(DRY, seed, "train", 1.0) for seed in (1, 2)]
    (named,) = close_loop(ROBOT, train, [_log(DRY, 51, "test", 1.0)], SETTINGS).diagnosis.effects
    assert named.effect.effect == "coulomb_friction"
    (told,) = [a for a in named.indistinguishable_from if a["effects"][0]["effect"] == "stribeck_friction"]
    assert "50 % more than coulomb_friction would not show" in told["why"]
    assert "slowly" in told["motion_that_would_tell"]


@pytest.mark.parametrize("offset", [0.0, 0.3])
def test_an_unseen_rest_is_listed_once_whatever_else_may_stand_for_the_name(offset: float) -> None:
    """Friction and an offset together may be friction that is rougher one way, and the friction may rise at rest."""
    both = [DRY, *([Effect("torque_offset", (ELBOW,), {"offset": offset})] if offset else [])]
    runs = [noisy_log(both, seed, split, NOISE) for seed, split in ((1, "train"), (2, "train"), (51, "test"))]
    judge, candidates, _ = gather(Model(ROBOT), read_motion(ROBOT, runs[:2], runs[2:], SETTINGS), SETTINGS)
    terms = [next(t for t in candidates if (t.effect, t.joint) == (e.effect, 1)) for e in both]
    listed = indistinguishable(judge.at(terms), terms, candidates)[terms[0]]
    names = [[e["effect"] for e in other["effects"]] for other in listed]
    assert names.count(["stribeck_friction"]) == 1
    assert (["asymmetric_coulomb_friction"] in names) is bool(offset)
