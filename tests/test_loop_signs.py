"""How dry friction turns over is chosen by reversals, too; what holds a resting joint proves no law."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.ndimage import uniform_filter1d
from tests.test_loop_slow_sign import ELBOW, ROBOT, judged

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.effects.sign import WIDTH
from hybrid_dynamics.loop import LoopResult, Model, close_loop
from hybrid_dynamics.loop.diagnosis import predict_run
from hybrid_dynamics.loop.signs import _rows, choose_signs
from hybrid_dynamics.loop.trace import Gain, Judge
from hybrid_dynamics.trajectory import Trajectory

#: Noise of the torque [N m].
NOISE = 0.02

SHARP = Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": 2.0})


def wide_of(terms: list[Term]) -> list[Term]:
    return [t for t in terms if t.joint == 1 and t.effect == "coulomb_friction" and t.options.get(WIDTH) == 0.08]


def width(terms: list[Term]) -> float:
    (term,) = terms
    return float(term.options.get(WIDTH, 0.0))


def test_a_sign_that_is_wrong_at_every_reversal_is_let_go() -> None:
    judge, terms = judged([SHARP])
    assert width(choose_signs(judge, wide_of(terms))[1]) < 0.03


@pytest.mark.parametrize(("share", "sharp"), [(0.5, True), (2.0, False)])
def test_moving_rows_are_weighed_against_reversals(monkeypatch: pytest.MonkeyPatch, share: float, sharp: bool) -> None:
    """The few blocks of a short log may surely prefer a wide sign; they lose by it only what they gain."""
    judge, terms = judged([SHARP])
    chosen = wide_of(terms)
    every, reversals = _rows(judge.evidence, 1)
    assert 0 < sum(r.sum() for r in reversals) < 0.2 * sum(r.sum() for r in every)
    plain = next(t for t in terms if t.joint == 1 and t.effect == "coulomb_friction" and not t.settings)
    wrong, right = (judge.evidence.held_out_on(t, 1, (reversals,))[0] for t in (chosen, [plain]))
    assert right < 0.2 * wrong
    lost = share * float(wrong - right) * judge.evidence.weights[1]
    per_joint = np.array([0.0, lost / judge.evidence.weights[1] / judge.evidence.samples[1]])
    assert per_joint[1] > judge.settings.floor_share * judge.floor[1] ** 2
    monkeypatch.setattr(Judge, "gain", lambda *_: Gain(lost, 0.1 * lost, per_joint, 20))
    assert (width(choose_signs(judge, chosen)[1]) < 0.03) == sharp


def test_rows_of_a_rest_are_no_reversals() -> None:
    judge, _ = judged([SHARP])
    for run, mask in zip(judge.evidence.runs, judge.evidence.mask, strict=True):
        assert mask is run.mask
        low, high = np.searchsorted(run.time, (run.time[0] + 2.0, run.time[0] + 4.0))
        mask[low:high, 1] = False
        every, reversals = _rows(judge.evidence, 1)
        at = next(i for i, other in enumerate(judge.evidence.runs) if other is run)
        # All of it but what is braking and starting; among all rows it counts.
        assert 0 < reversals[at][low:high].sum() < 0.15 * (high - low)
        assert every[at][low:high].all()
        assert reversals[at].sum() > 0


def test_pushed_moments_choose_no_sign() -> None:
    judge, _ = judged([SHARP])
    run = judge.evidence.runs[0]
    low, high = np.searchsorted(run.time, (run.time[0] + 2.0, run.time[0] + 4.0))
    pushed = run.mask[low:high, 1]
    assert pushed.any()
    every, reversals = _rows(judge.evidence.leave_out(0, slice(int(low), int(high)), 1), 1)
    assert not every[0][low:high][pushed].any()
    assert not reversals[0][low:high][pushed].any()
    assert every[1].all()


@pytest.mark.slow
def test_a_sharp_sign_does_not_follow_the_rounding_of_a_joint_at_rest() -> None:
    """A joint that rests between moves has a speed of nothing but rounding, now of this sign and now of that."""
    result = close_loop(ROBOT, [pauses(0)], [pauses(1)])
    assert left_at_rest(result, result.model) < 3 * NOISE
    # Control: with a sharp sign the same friction comes and goes.
    sharp = Model(ROBOT, tuple(replace(e, settings={}) if WIDTH in e.settings else e for e in result.model.effects))
    assert left_at_rest(result, sharp) > 10 * NOISE


def pauses(seed: int) -> Trajectory:
    """A run of moves with a second of rest after each, dry friction that turns over within 2 mrad/s."""
    rng = np.random.default_rng(seed)
    rate, poses = 200.0, rng.uniform(-1.2, 1.2, (9, 2))
    s = np.linspace(0.0, 1.0, 200, endpoint=False)
    step = s**3 * (10 - 15 * s + 6 * s * s)
    parts = [np.vstack([a + (b - a) * step[:, None], np.tile(b, (200, 1))]) for a, b in pairwise(poses)]
    q = uniform_filter1d(np.concatenate(parts), 9, axis=0, mode="nearest")
    time = np.arange(len(q)) / rate
    path = make_interp_spline(time, q, k=5)
    dry = [Effect("coulomb_friction", (j,), {"coulomb_torque": 2.0}, {WIDTH: 0.002}) for j in ROBOT.joint_names]
    tau = Model(ROBOT, tuple(dry)).predict(q, path(time, 1), path(time, 2))
    return Trajectory(
        f"run{seed}", "test" if seed else "train", time, {"q": q, "tau": tau + rng.normal(0, NOISE, q.shape)}
    )


def left_at_rest(result: LoopResult, model: Model) -> float:
    """Root mean square [N m] of what ``model`` leaves in the middle of the rests of the test run, worst joint."""
    (run,) = result.test
    left = run.tau - predict_run(model, run)
    rest = np.abs(np.mod(run.time, 2.0) - 1.5) < 0.3
    return float(np.sqrt(np.mean(left[rest] ** 2, axis=0)).max())
