"""What a joint says while it stands holds what motion leaves open, and changes nothing that motion knows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from tests.small_arm import arm
from tests.test_loop_standing import COULOMB, FRICTION, NOISE, RATE, SETTINGS, pushed, run

from hybrid_dynamics.effects import Term, family
from hybrid_dynamics.loop import Model
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.identifiability import undetermined
from hybrid_dynamics.loop.process import process
from hybrid_dynamics.loop.resting import FAR, LEAST, SHARE, Resting, resting_rows
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

SHOULDER, ELBOW = arm().joint_names
FLOOR = np.full(2, NOISE)


def terms(*names: str) -> list[Term]:
    return [t for name in names for t in family(name).terms(arm(), np.ones(2, bool), SETTINGS.options)]


def evidence(runs: Sequence[Trajectory], asked: Sequence[Term], base: Model | None = None) -> Evidence:
    own = base or Model(arm(), ())
    return Evidence.of(own, [process(r, arm(), SETTINGS.process) for r in runs], asked, SETTINGS)


def fitted(of: Evidence, asked: Sequence[Term], floor: Array, at_rest: bool = True) -> Array:
    weighed = of.weigh(floor)
    if not at_rest:
        # The control: the rows at rest weigh nothing.
        weighed._at_rest = np.zeros(2)
    return weighed.fit(asked)


def rows(runs: Sequence[Trajectory], base: Model | None = None) -> Resting:
    own = base or Model(arm(), ())
    processed = [process(r, arm(), SETTINGS.process) for r in runs]
    left = [r.tau - r.smooth(own.predict(r.motion.q, r.motion.dq, r.motion.ddq, r.motion.time)) for r in processed]
    return resting_rows(own, processed, left, SETTINGS)


def in_turn() -> Trajectory:
    """The shoulder moves for 6 s, then the elbow, .5 N m off in step with the creeping shoulder (1 mrad/s)."""
    time = np.arange(int(12 * RATE)) / RATE
    fade = [np.clip(np.minimum(time - a, b - time) / 0.5, 0, 1) for a, b in ((0.5, 5.5), (6.5, 11.5))]
    q = np.column_stack([f * f * (3 - 2 * f) * 0.6 * np.sin(2.5 * time) for f in fade])
    q[:, 0] -= 0.001 / 0.8 * np.cos(0.8 * time)
    spline = make_interp_spline(time, q, k=5)
    tau = arm().inverse_dynamics(q, spline(time, 1), spline(time, 2))
    tau[:, 1] += np.where(time < 6.0, 0.0, 0.5 * np.sin(0.8 * time))
    return Trajectory(
        "turn", "train", time, {"q": q, "tau": tau + np.random.default_rng(1).normal(size=tau.shape) * 0.1}
    )


def test_a_joint_that_stands_holds_what_its_motion_leaves_open() -> None:
    (coupling,) = [
        t for t in terms("joint_coupling") if t.joint == 1 and t.options["rows"] == "own" and t.options["sign_of"]
    ]
    of, floor = evidence([in_turn()], [coupling]), np.full(2, 0.1)
    with_rest, without = (fitted(of, [coupling], floor, at_rest) for at_rest in (True, False))
    stands = of.problem.resting.rows[0][:, 1]
    rms = [float(np.sqrt(np.mean(of.linear([coupling], x)[0][stands, 1] ** 2))) for x in (with_rest, without)]
    # What the elbow leaves in motion is .5 N m: more than a few times that it was never seen to hold at rest.
    assert rms[0] < 3 * 0.5
    assert rms[1] > 20 * 0.5, "the control"


@pytest.mark.parametrize("held", [0.9 * COULOMB, -0.9 * COULOMB])
def test_what_friction_holds_at_rest_does_not_move_what_motion_knows(held: float) -> None:
    asked = terms("viscous_friction", "torque_offset")
    asked += [t for t in terms("coulomb_friction") if not t.settings]
    rested = [pushed(pushed(run(name, seed), held), held, joint=1) for name, seed in (("a", 1), ("b", 2))]
    of = evidence(rested, asked)
    assert (of.problem.resting.samples > 1).all()
    x, control = fitted(of, asked, FLOOR), fitted(of, asked, FLOOR, at_rest=False)
    errors = np.sqrt(np.diag(of.weigh(FLOOR).covariance(asked, x)))
    assert np.all(np.abs(x - control) < errors)
    assert np.any(x != control)


def test_a_brake_or_a_hand_is_no_friction() -> None:
    assert rows([run("a", 1)]).rows[0].any(axis=0).all()
    size = rows([run("a", 1)]).size
    for torque in (1.5 * FAR * size[1], -1.5 * FAR * size[1]):
        seen = rows([pushed(run("a", 1), torque, joint=1)])
        assert seen.rows[0].any(axis=0).tolist() == [True, False]
        assert seen.samples[1] == 0
        assert seen.weights(FLOOR)[1] == 0


def test_size_and_weight() -> None:
    of = rows([run("a", 1), run("b", 2)])
    moving = np.sum([process(run(n, s), arm(), SETTINGS.process).mask.sum(axis=0) for n, s in (("a", 1), ("b", 2))], 0)
    # One rest a run: what friction holds stays the same in it, however long it lasts.
    assert of.samples.tolist() == [2.0, 2.0]
    assert np.all(of.samples <= np.maximum(SHARE * moving, LEAST))
    assert of.size[1] == pytest.approx(COULOMB, rel=0.05)
    count = np.sum([own.sum(axis=0) for own in of.rows], axis=0)
    assert np.allclose(of.weights(FLOOR) * count, of.samples / of.size**2)
    assert of.weights(np.array([0.0, 100.0])).tolist() == [0.0, of.samples[1] / count[1] / 1e4]
    # Friction that the starting model has holds as much, though it leaves nothing in motion.
    knows = rows([run("a", 1)], Model(arm(), FRICTION))
    assert knows.size[1] == pytest.approx(COULOMB, rel=0.05)
    assert not rows([run("a", 1, stop=(1.0, 1.0))]).rows[0].any()


def test_moments_that_are_left_out_count_no_more_at_rest() -> None:
    asked = terms("torque_offset")
    of = evidence([run("a", 1)], asked)
    clear = fitted(of, asked, FLOOR)
    (stands,) = of.problem.resting.rows
    part = slice(int(np.flatnonzero(stands[:, 1])[0]), int(np.flatnonzero(stands[:, 1])[-1]) + 1)
    without = fitted(of.leave_out(0, part, 1), asked, FLOOR)
    control = fitted(of, asked, FLOOR, at_rest=False)
    assert without[1] == pytest.approx(control[1], abs=1e-12)
    assert without[0] == clear[0]
    assert clear[1] != control[1]


def one_way(held: float) -> Trajectory:
    """Both joints go forward and rest, twice; friction of 1.5 N m, which at rest holds ``held``."""
    time = np.arange(int(16 * RATE)) / RATE
    phase = np.clip(np.mod(time, 8.0) - 1.0, 0.0, 3.0) / 3.0
    step = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
    q = np.column_stack([0.8 * (step + np.floor(time / 8.0)) - 0.8] * 2)
    spline = make_interp_spline(time, q, k=5)
    moves = spline(time, 1) > 0.005
    tau = arm().inverse_dynamics(q, spline(time, 1), spline(time, 2)) + np.where(moves, COULOMB, held)
    return Trajectory(
        "one way", "train", time, {"q": q, "tau": tau + np.random.default_rng(2).normal(size=tau.shape) * NOISE}
    )


@pytest.mark.parametrize("held", [0.9 * COULOMB, -0.9 * COULOMB])
def test_what_only_rests_tell_is_left_open_and_its_error_says_so(held: float) -> None:
    asked = terms("torque_offset") + [t for t in terms("coulomb_friction") if not t.settings]
    of = evidence([one_way(held)], asked).weigh(FLOOR)
    assert (of.problem.resting.samples > 0).all()
    x = of.fit(asked)
    errors = np.sqrt(np.diag(of.covariance(asked, x)))
    truth = np.array([0.0, 0.0, COULOMB, COULOMB])
    assert np.all(np.abs(x - truth) < 2 * errors)
    for term in asked:
        assert undetermined(of, asked, term), "a joint that goes one way does not tell an offset from friction"
