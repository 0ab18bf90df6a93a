"""A fit of everything at once that predicts the test runs much better says that names are missing, and where."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.small_arm import arm, noisy_log
from tests.test_loop_beside import links

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop.everything import better_with_everything
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.trace import Judge

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
HIDDEN = (
    links(0.15),
    Effect("viscous_friction", (SHOULDER,), {"viscous_coefficient": 1.0}),
    Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 1.0}),
)


def _asked(
    hidden: tuple[Effect, ...] = HIDDEN, noise: float = 0.1, **settings: object
) -> tuple[Judge, list[Term], list[Run]]:
    train = [noisy_log(list(hidden), k, "train", noise) for k in (1, 2)]
    logs = read_motion(ROBOT, train, [noisy_log(list(hidden), 3, "test", noise)], replace(LoopSettings(), **settings))
    judge, terms, _ = gather(Model(ROBOT), logs, replace(LoopSettings(), **settings))
    return judge, terms, logs.test


def test_where_names_are_missing_it_is_said() -> None:
    judge, terms, test = _asked()
    (note,) = better_with_everything(judge, terms, Model(ROBOT), test)
    assert SHOULDER in note
    assert "effects are missing" in note


def test_only_the_joint_is_told_that_lacks_something() -> None:
    friction = HIDDEN[1:]
    judge, terms, test = _asked(friction)
    (note,) = better_with_everything(judge, terms, Model(ROBOT), test)
    assert SHOULDER in note
    assert ELBOW not in note


@pytest.mark.parametrize("hidden", [HIDDEN[1:], ()])
def test_the_true_model_is_not_beaten(hidden: tuple[Effect, ...]) -> None:
    judge, terms, test = _asked(hidden)
    assert better_with_everything(judge, terms, Model(ROBOT, hidden), test) == []


@pytest.mark.parametrize(("off", "told"), [(1.002, False), (1.5, True)])
def test_what_is_much_better_in_the_last_digits_only_is_not_told(off: float, told: bool) -> None:
    viscous = Effect("viscous_friction", (SHOULDER,), {"viscous_coefficient": off})
    judge, terms, test = _asked(HIDDEN[1:], noise=1e-5)
    assert bool(better_with_everything(judge, terms, Model(ROBOT, (viscous, HIDDEN[2])), test)) is told


def test_nothing_is_asked_where_links_are_in_or_not_asked_for() -> None:
    judge, terms, test = _asked()
    # Friction is missing, but nobody could say that the links had not been given their chance.
    assert better_with_everything(judge, terms, Model(ROBOT, HIDDEN[:1]), test) == []
    judge, terms, test = _asked(effects=("viscous_friction", "torque_offset"))
    assert better_with_everything(judge, terms, Model(ROBOT), test) == []
