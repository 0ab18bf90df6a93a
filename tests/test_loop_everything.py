"""A fit of everything at once that predicts the test runs much better says that names are missing, and where."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.small_arm import arm, heavier_links, noisy_log

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop import LoopSettings, Model, close_loop
from hybrid_dynamics.loop import close as close_module
from hybrid_dynamics.loop.everything import Everything, better_with_everything
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.trajectory import Trajectory

ROBOT = arm()
NO_STEPS = np.zeros(2)
SHOULDER, ELBOW = ROBOT.joint_names
HIDDEN = (
    heavier_links(0.15),
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
    rival = better_with_everything(judge, terms, Model(ROBOT), test, NO_STEPS)
    assert rival.better[0]
    (note,) = rival.notes(ROBOT.joint_names)
    assert f"{SHOULDER} ({rival.times[0]:.2g} times)" in note
    assert "effects are missing" in note


def test_only_the_joint_is_told_that_lacks_something() -> None:
    friction = HIDDEN[1:]
    judge, terms, test = _asked(friction)
    rival = better_with_everything(judge, terms, Model(ROBOT), test, NO_STEPS)
    assert rival.better.tolist() == [True, False]
    (note,) = rival.notes(ROBOT.joint_names)
    assert SHOULDER in note
    assert ELBOW not in note


@pytest.mark.parametrize("hidden", [HIDDEN[1:], ()])
def test_the_true_model_is_not_beaten(hidden: tuple[Effect, ...]) -> None:
    judge, terms, test = _asked(hidden)
    rival = better_with_everything(judge, terms, Model(ROBOT, hidden), test, NO_STEPS)
    assert not rival.better.any()
    assert rival.notes(ROBOT.joint_names) == []


@pytest.mark.parametrize(("off", "told"), [(1.002, False), (1.5, True)])
def test_what_is_much_better_in_the_last_digits_only_is_not_told(off: float, told: bool) -> None:
    viscous = Effect("viscous_friction", (SHOULDER,), {"viscous_coefficient": off})
    judge, terms, test = _asked(HIDDEN[1:], noise=1e-5)
    assert (
        bool(better_with_everything(judge, terms, Model(ROBOT, (viscous, HIDDEN[2])), test, NO_STEPS).better.any())
        is told
    )


def test_steps_of_the_torque_are_no_effects_that_are_missing() -> None:
    """The elbow's torque goes through three steps: what they round away follows the motion and has a mean."""
    step = np.array([0.0, 4.0])

    def coarse(run: Trajectory) -> Trajectory:
        tau = run["tau"].copy()
        tau[:, 1] = np.round((tau[:, 1] - 1.2) / step[1]) * step[1]
        return run.with_signals(tau=tau)

    runs = [coarse(noisy_log([], k, split, 0.0)) for k, split in ((1, "train"), (2, "train"), (3, "test"))]
    logs = read_motion(ROBOT, runs[:2], runs[2:], LoopSettings())
    judge, terms, _ = gather(Model(ROBOT), logs, LoopSettings())
    assert logs.rounded_away[1] == step[1] / 2
    assert not better_with_everything(judge, terms, Model(ROBOT), logs.test, logs.rounded_away).better.any()
    assert better_with_everything(judge, terms, Model(ROBOT), logs.test, NO_STEPS).better[1], "the control"


def test_links_without_the_friction_beside_them_are_told() -> None:
    judge, terms, test = _asked()
    assert better_with_everything(judge, terms, Model(ROBOT, HIDDEN[:1]), test, NO_STEPS).better.tolist() == [
        True,
        False,
    ]
    assert not better_with_everything(judge, terms, Model(ROBOT, HIDDEN), test, NO_STEPS).better.any()


def test_nothing_is_asked_where_the_starting_model_has_the_links_or_nobody_asks_for_them() -> None:
    logs = [noisy_log(list(HIDDEN), k, split, 0.1) for k, split in ((1, "train"), (2, "train"), (3, "test"))]
    motion = read_motion(ROBOT, logs[:2], logs[2:], LoopSettings())
    start = Model(ROBOT, HIDDEN[:1])
    judge, terms, _ = gather(start, motion, LoopSettings())
    assert not better_with_everything(judge, terms, start, motion.test, NO_STEPS).better.any()
    judge, terms, test = _asked(effects=("viscous_friction", "torque_offset"))
    assert not better_with_everything(judge, terms, Model(ROBOT), test, NO_STEPS).better.any()


@pytest.mark.parametrize(("times", "verdict", "left"), [(1.0, "explained", []), (4.0, "partly_explained", [ELBOW])])
def test_a_joint_that_a_fit_of_everything_predicts_better_is_not_explained(
    monkeypatch: pytest.MonkeyPatch, times: float, verdict: str, left: list[str]
) -> None:
    monkeypatch.setattr(close_module, "better_with_everything", lambda *given: Everything(np.array([1.0, times])))
    runs = [noisy_log(list(HIDDEN[1:]), k, split, 0.05) for k, split in ((1, "train"), (2, "train"), (3, "test"))]
    diagnosis = close_loop(ROBOT, runs[:2], runs[2:]).diagnosis
    assert diagnosis.verdict == verdict
    assert [entry["joint"] for entry in diagnosis.unexplained] == left
    assert [entry["share_of_residual_variance"] for entry in diagnosis.unexplained] == [0.75] * len(left)
    assert any("fitted at once" in note and ELBOW in note for note in diagnosis.notes) is bool(left)
