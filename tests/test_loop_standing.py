"""A joint that stands: friction holds a part of what is left, and what it does not hold is no all-clear."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from tests.small_arm import arm

from hybrid_dynamics.cli.words import details
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop import LoopSettings, Model, close_loop, write_diagnosis
from hybrid_dynamics.loop.process import process
from hybrid_dynamics.loop.standing import BREAKS_AWAY, LASTS, SHARE, Standing, beyond_friction
from hybrid_dynamics.loop_report.rest import HELD, STANDING, UNTESTED, state_of
from hybrid_dynamics.loop_report.words import still_open
from hybrid_dynamics.trajectory import Trajectory

RATE, NOISE, COULOMB = 200.0, 0.02, 1.5
SHOULDER, ELBOW = arm().joint_names
FRICTION = (
    Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": COULOMB}),
    Effect("viscous_friction", (SHOULDER,), {"viscous_coefficient": 0.8}),
    Effect("coulomb_friction", (ELBOW,), {"coulomb_torque": COULOMB}),
)
SETTINGS = LoopSettings(effects=("coulomb_friction", "viscous_friction"))
#: Both joints stand from the third second to the sixth.
STANDS = slice(int(3.2 * RATE), int(5.8 * RATE))


def run(
    name: str,
    seed: int,
    split: str = "train",
    stop: float = 0.0,
    moves: tuple[float, float] = (1.0, 1.0),
    duration: float = 9.0,
) -> Trajectory:
    """The arm with its friction; the motion rests between 3 and 6 s down to ``stop`` of its pace."""
    rng = np.random.default_rng(seed)
    time = np.arange(int(duration * RATE)) / RATE
    s = np.clip(np.abs(time - 4.5) - 1.5, 0.0, 1.0)
    pace = stop + (1.0 - stop) * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    phase = np.cumsum(pace) / RATE
    q = (
        np.stack([sum(np.sin(w * phase + rng.uniform(0, 6)) for w in (1.7, 2.9, 4.3)) for _ in range(2)], axis=1)
        * moves
    )
    spline = make_interp_spline(time, 0.5 * q, k=5)
    motion = spline(time), spline(time, 1), spline(time, 2)
    tau = Model(arm(), FRICTION).predict(*motion, time)
    return Trajectory(name, split, time, {"q": motion[0], "tau": tau + rng.normal(size=tau.shape) * NOISE})


def pushed(of: Trajectory, torque: float, joint: int = 0) -> Trajectory:
    """Where ``joint`` stands, ``torque`` [N m] beside its weight: friction, something that pushes, or both."""
    tau, q = of["tau"].copy(), of["q"][STANDS]
    tau[STANDS, joint] = arm().inverse_dynamics(q, np.zeros_like(q), np.zeros_like(q))[:, joint] + torque
    return of.with_signals(tau=tau)


def left(of: Trajectory, model: Model | None = None) -> Standing:
    return beyond_friction(
        model or Model(arm(), FRICTION), [process(of, arm(), SETTINGS.process)], np.full(2, NOISE), SETTINGS
    )


def test_what_friction_holds_is_let_pass_and_what_it_does_not_is_measured() -> None:
    assert not left(run("a", 1)).seen.any()
    for torque in (0.95 * BREAKS_AWAY * COULOMB, -0.95 * BREAKS_AWAY * COULOMB):
        assert not left(pushed(run("a", 1), torque)).seen.any(), "a joint breaks away late"
    for torque in (8.0, -8.0):
        found = left(pushed(run("a", 1), torque, joint=1))
        assert found.seen.tolist() == [False, True]
        assert found.rms[1] == pytest.approx(8.0, abs=3 * NOISE)
        assert found.held[1] == pytest.approx(COULOMB)
        assert found.seconds[1] == pytest.approx(2.6, abs=0.1)
        assert found.share[1] > 0.9
        assert found.longest == ("", found.longest[1])
        assert found.longest[1].startswith("most in run a between 3.")


def test_the_same_push_on_a_joint_that_moves_is_not_said_of_one_that_stands() -> None:
    of = run("a", 1, stop=0.4)
    tau = of["tau"].copy()
    tau[STANDS] += 8.0
    assert not left(of.with_signals(tau=tau)).seen.any()


def test_a_moment_is_let_pass_and_a_joint_that_never_moves_too() -> None:
    of = run("a", 1)
    tau = of["tau"].copy()
    tau[STANDS.start : STANDS.start + int(0.3 * RATE)] += 8.0
    assert not left(of.with_signals(tau=tau)).seen.any()
    silent = beyond_friction(
        Model(arm(), FRICTION), [process(pushed(of, 8.0), arm(), SETTINGS.process)], np.array([0.0, NOISE]), SETTINGS
    )
    assert not silent.seen.any()
    # Of a log that stands for long, a little more than half a second is little.
    still = run("still", 2, moves=(1e-4, 1e-4), duration=15.0)
    for seconds, seen in ((LASTS + 0.1, False), (SHARE * 15 + 0.2, True)):
        tau = still["tau"].copy()
        tau[: int((seconds + 0.1) * RATE)] += 8.0
        assert left(still.with_signals(tau=tau)).seen.all() == seen


def test_friction_that_grows_with_the_load_or_is_read_too_large_holds_as_much_more() -> None:
    grows = Effect("load_dependent_friction", (SHOULDER,), {"load_coefficient": 0.5}, {"sign_width": 1e-4})
    large = Effect("torque_gain", (SHOULDER,), {"gain": 2.0})
    of = process(run("a", 1), arm(), SETTINGS.process)
    rest = np.abs(of.time - 4.5) < 1.0
    m = of.motion
    held = [
        of.smooth(Model(arm(), effects).turning(m.q, m.dq, m.ddq, 0.02, m.time, m.began)[1])[rest, 0].mean()
        for effects in ((FRICTION[0],), (FRICTION[0], grows), (FRICTION[0], large))
    ]
    load = np.abs(arm().inverse_dynamics(m.q, m.dq, m.ddq)[np.abs(m.time - 4.5) < 0.5, 0].mean())
    assert held[0] == pytest.approx(COULOMB)
    assert held[1] == pytest.approx(COULOMB + 0.5 * load, rel=0.02)
    assert held[2] == pytest.approx(2 * COULOMB)


def test_an_all_clear_is_not_given_where_something_holds_a_joint_that_stands(tmp_path) -> None:
    train = [run("a", 1), run("b", 2)]
    clear = close_loop(arm(), train, [run("c", 3, "test")], SETTINGS)
    assert clear.diagnosis.verdict == "explained", "the control"
    assert not any(clear.diagnosis.beyond_friction)
    result = close_loop(arm(), train, [pushed(run("c", 3, "test"), 8.0)], SETTINGS)
    d = result.diagnosis
    assert d.verdict == "partly_explained"
    assert {(e.effect.effect, e.effect.joints) for e in d.confirmed} == {(e.effect, e.joints) for e in FRICTION}
    assert d.beyond_friction[0] == pytest.approx(8.0, abs=0.2)
    assert d.beyond_friction[1] == 0.0
    assert [entry["joint"] for entry in d.unexplained] == [SHOULDER]
    assert d.unexplained[0]["share_of_residual_variance"] > 0.9
    assert any(line.startswith(f"{SHOULDER}: while it stands ") and "most in run c" in line for line in d.notes)
    write_diagnosis(tmp_path / "diagnosis.json", d)
    value = json.loads((tmp_path / "diagnosis.json").read_text())
    assert state_of(value, 0) == ("open", HELD)
    assert state_of(value, 1)[1] == STANDING, "what friction of a joint that stands is, its motion does not say"
    assert any(line.startswith(f"not down to noise: {SHOULDER}: while it stands ") for line in details(value))
    assert still_open(value)[0].startswith(f"{SHOULDER}: while it stands ")


def test_test_runs_that_stand_prove_nothing() -> None:
    train = [run("a", 1), run("b", 2)]
    with pytest.raises(InputError, match=r"no joint moves more than 0\.02 rad in the test runs"):
        close_loop(arm(), train, [run("c", 3, "test", moves=(1e-3, 1e-3))], SETTINGS)
    late = run("d", 4)
    rest = late.with_signals(q=np.where((late.time < 4.0)[:, None], late["q"], late["q"][int(4.0 * RATE)]))
    with pytest.raises(InputError, match="in the last part of the training runs, which is held out"):
        close_loop(arm(), [rest], [], SETTINGS)
    one = close_loop(arm(), train, [run("c", 3, "test", moves=(1.0, 1e-3))], SETTINGS).diagnosis
    assert f"{ELBOW}: stands still in the test runs, which say nothing of what is found on it" in one.notes
    value = one.to_json()
    assert state_of(value, 1) == ("unseen", UNTESTED)
    assert state_of(value, 0)[1] == STANDING
