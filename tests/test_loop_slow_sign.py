"""Dry friction that turns over slowly is one law; what is curved for another reason stays as it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect, Term, predict
from hybrid_dynamics.effects.sign import WIDTH
from hybrid_dynamics.loop import LoopResult, LoopSettings, Model, close_loop, slow_sign
from hybrid_dynamics.loop import find as find_module
from hybrid_dynamics.loop.augment import effects_of, refit
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.tangents import covariance_with_settings
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.simulation.excitation import excitations
from hybrid_dynamics.trajectory import Trajectory

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
STEP = Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 2.0}, {WIDTH: 0.3})
VISCOUS = Effect("viscous_friction", (ELBOW,), {"viscous_coefficient": 0.4})


def closed(effects: Sequence[Effect]) -> LoopResult:
    train, test = excitations(ROBOT, effects, train=2, test=1, duration=8.0, rate=250.0)
    return close_loop(ROBOT, train, test)


def named(result: LoopResult) -> dict[str, Effect]:
    return {e.effect.effect: e.effect for e in result.diagnosis.effects}


def judged(effects: Sequence[Effect], noise: float = 0.003, seed: int = 0) -> tuple[Judge, list[Term]]:
    """Evidence of two runs, torque noise as a share of the effort limits, and what may be named."""
    settings = LoopSettings()
    train, test = excitations(
        ROBOT, effects, train=2, test=1, duration=8.0, rate=250.0, torque_noise_share=noise, seed=seed
    )
    judge, terms, _ = gather(Model(ROBOT), read_motion(ROBOT, train, test, settings), settings)
    return judge, terms


@pytest.mark.slow
@pytest.mark.parametrize("beside", [[], [VISCOUS]])
def test_a_smooth_step_is_one_law_with_its_width(monkeypatch: pytest.MonkeyPatch, beside: list[Effect]) -> None:
    truth = [STEP, *beside]
    result = closed(truth)
    found = named(result)
    assert set(found) == {e.effect for e in truth}
    # Beside viscous friction a wider step with less of it is nearly the same; the curve is what the data determines.
    assert found["coulomb_friction"].settings[WIDTH] == pytest.approx(0.3, rel=0.4 if beside else 0.15)
    dq = np.column_stack([np.zeros(50), np.linspace(0.05, max(np.abs(run.dq[:, 1]).max() for run in result.train), 50)])
    still = np.zeros_like(dq)
    curve = [m.predict(still, dq, still)[:, 1] for m in (result.model, Model(ROBOT, tuple(truth)))]
    np.testing.assert_allclose(curve[0], curve[1], atol=0.02 * np.abs(curve[1]).max())
    # Control: without the offer the search makes the step of several laws, none of them as wide.
    monkeypatch.setattr(find_module, "slow_signs", lambda judge, chosen: (judge, list(chosen)))
    without = named(closed(truth))
    assert len(without) > 1
    assert all(e.settings.get(WIDTH, 0.0) < 0.2 for e in without.values())


def test_a_viscous_friction_that_bends_stays_one() -> None:
    law = {"quadratic_coefficient": 0.5, "cubic_coefficient": 0.2}
    judge, terms = judged([VISCOUS, Effect("nonlinear_viscous_friction", (ELBOW,), law)])
    own = [t for t in terms if t.joint == 1 and t.family().viscous_powers]
    assert len(own) == 2
    assert set(slow_sign.slow_signs(judge, own)[1]) == set(own)


@pytest.mark.parametrize(("noise", "step"), [(0.015, True), (0.003, False)])
def test_a_curve_of_three_numbers_is_a_step_where_noise_hides_the_difference(noise: float, step: bool) -> None:
    """Two numbers that do as well are the simpler law, also where chance has the third a little better."""
    speed = np.linspace(0.0, 2.0, 50)
    powers = np.stack([speed, speed**2, speed**3], axis=1)
    c1, c2, c3 = np.linalg.lstsq(powers, 2.0 * np.tanh(speed / 0.8), rcond=None)[0]
    curve = {"quadratic_coefficient": float(c2), "cubic_coefficient": float(c3)}
    viscous = Effect("viscous_friction", (ELBOW,), {"viscous_coefficient": float(c1)})
    judge, terms = judged([viscous, Effect("nonlinear_viscous_friction", (ELBOW,), curve)], noise, seed=2)
    own = [t for t in terms if t.joint == 1 and t.family().viscous_powers]
    found = slow_sign.slow_signs(judge, own)[1]
    assert ([t.effect for t in found] == ["coulomb_friction"]) == step
    assert step or set(found) == set(own)


def test_a_step_is_told_from_a_curve_where_the_joint_is_hardly_faster_than_it_is_wide() -> None:
    """Slow runs: a curved viscous law, which goes on to bend, would brake less and less beyond them, and then drive."""
    runs: list[Trajectory] = []
    for log in excitations(ROBOT, [], train=2, test=1, duration=8.0, rate=250.0):
        for run in log:
            time = 9.0 * run.time
            dq = np.gradient(run["q"], time, axis=0)
            step = Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 2.0}, {WIDTH: 0.2})
            tau = predict(ROBOT, [step, VISCOUS], run["q"], dq, np.gradient(dq, time, axis=0), time)
            noise = np.random.default_rng(len(runs)).normal(0.0, 0.02, tau.shape)
            runs.append(Trajectory(run.name, run.split, time, {"q": run["q"], "dq": dq, "tau": tau + noise}))
    settings = LoopSettings()
    judge, terms, _ = gather(Model(ROBOT), read_motion(ROBOT, runs[:2], runs[2:], settings), settings)
    assert 0.25 < float(judge.evidence.problem.fastest[1]) < 0.45
    own = [t for t in terms if t.joint == 1 and t.family().viscous_powers]
    found = {t.effect: t.options for t in slow_sign.slow_signs(judge, own)[1]}
    assert set(found) <= {"coulomb_friction", "viscous_friction"}
    assert found["coulomb_friction"][WIDTH] == pytest.approx(0.2, rel=0.3)


def test_a_sharp_sign_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    judge, terms = judged([Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 2.0}, {WIDTH: 0.03})])
    own = [t for t in terms if t.joint == 1 and t.effect == "coulomb_friction" and t.options.get(WIDTH) == 0.03]
    asked: list[int] = []
    monkeypatch.setattr(slow_sign, "_best_step", lambda judge, rest, joint: asked.append(joint))
    assert slow_sign.slow_signs(judge, own)[1] == own
    assert asked == []


def test_a_step_as_wide_as_the_motion_is_viscous_friction() -> None:
    # Where the joint never leaves the foot of the step its height says nothing: the width would end at its end.
    fastest = float(judged([])[0].evidence.problem.fastest[1])
    wide = Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 20.0}, {WIDTH: 20.0 * fastest})
    judge, terms = judged([wide])
    own = [t for t in terms if t.joint == 1 and t.family().viscous_powers]
    assert slow_sign._best_step(judge, [], 1) is None
    assert set(slow_sign.slow_signs(judge, own)[1]) == set(own)


@pytest.mark.parametrize(("width", "shared"), [(0.3, True), (0.03, False)])
def test_the_height_of_a_slow_step_is_as_unsure_as_its_width_makes_it(width: float, shared: bool) -> None:
    # Between foot and top a wider step with a higher top is nearly the same; a sharp one has no such partner.
    judge, _ = judged([replace(STEP, settings={WIDTH: width}), VISCOUS])
    own = [Term("coulomb_friction", 1, ((WIDTH, width),)), Term("viscous_friction", 1)]
    judge = judge.adding(own)
    fitted = refit(judge.evidence, own)
    judge, x = judge.over(fitted.evidence), fitted.x
    given_width = np.sqrt(np.diag(judge.evidence.covariance(own, x)))
    with_width = np.sqrt(np.diag(covariance_with_settings(judge.evidence, own, x)))
    assert len(with_width) == 2 + shared
    assert bool(with_width[0] > 1.2 * given_width[0]) is shared
    told = [e.std_errors for e in effects_of(judge.evidence, own, x, covariance_with_settings(judge.evidence, own, x))]
    assert told[0]["coulomb_torque"] == pytest.approx(with_width[0], rel=1e-6)
    assert told[1]["viscous_coefficient"] == pytest.approx(with_width[1], rel=1e-6)
