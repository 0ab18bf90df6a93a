"""A joint that stands: friction holds a part of what is left, and what it does not hold is no all-clear."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from tests.small_arm import arm

from hybrid_dynamics.cli.words import details
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop import LoopSettings, Model, close_loop, resting, write_diagnosis
from hybrid_dynamics.loop.carried import Left
from hybrid_dynamics.loop.diagnosis import predict_run
from hybrid_dynamics.loop.process import process
from hybrid_dynamics.loop.standing import BREAKS_AWAY, LASTS, LONG, SHARE, Standing, beyond_friction
from hybrid_dynamics.loop_report.rest import HELD, STANDING, UNTESTED, state_of
from hybrid_dynamics.loop_report.words import still_open
from hybrid_dynamics.trajectory import Trajectory

RATE, NOISE, COULOMB = 200.0, 0.02, 1.5
SHOULDER, ELBOW = arm().joint_names


def coulomb(joint: str, **settings: float) -> Effect:
    return Effect("coulomb_friction", (joint,), {"coulomb_torque": COULOMB}, settings)


VISCOUS = Effect("viscous_friction", (SHOULDER,), {"viscous_coefficient": 0.8})
FRICTION = (coulomb(SHOULDER), VISCOUS, coulomb(ELBOW))
SETTINGS = LoopSettings(effects=("coulomb_friction", "viscous_friction"))
#: Joints stand from the third second to the sixth.
STANDS = slice(int(3.2 * RATE), int(5.8 * RATE))


def run(
    name: str,
    seed: int,
    split: str = "train",
    effects: Sequence[Effect] = FRICTION,
    stop: tuple[float, float] = (0.0, 0.0),
    moves: tuple[float, float] = (1.0, 1.0),
    duration: float = 9.0,
) -> Trajectory:
    """The arm with ``effects``; the motion of each joint rests between 3 and 6 s, down to ``stop`` of its pace."""
    rng = np.random.default_rng(seed)
    time = np.arange(int(duration * RATE)) / RATE
    s = np.clip(np.abs(time - 4.5) - 1.5, 0.0, 1.0)
    fade = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    q = np.zeros((len(time), 2))
    for j in range(2):
        phase = np.cumsum(stop[j] + (1.0 - stop[j]) * fade) / RATE
        q[:, j] = 0.5 * moves[j] * sum(np.sin(w * phase + rng.uniform(0, 6)) for w in (1.7, 2.9, 4.3))
    spline = make_interp_spline(time, q, k=5)
    # A joint that stands does so to the last bit, and holds what its own friction does not.
    dq = np.where(np.abs(spline(time, 1)) < 1e-6, 0.0, spline(time, 1))
    tau = Model(arm(), tuple(effects)).predict(q, dq, spline(time, 2), time)
    return Trajectory(name, split, time, {"q": q, "tau": tau + rng.normal(size=tau.shape) * NOISE})


def pushed(of: Trajectory, torque: float, joint: int = 0, rows: slice = STANDS) -> Trajectory:
    """``torque`` [N m] more on ``joint``: what friction holds where it stands, something that pushes, or both."""
    tau = of["tau"].copy()
    tau[rows, joint] += torque
    return of.with_signals(tau=tau)


def parts(runs: Sequence[Trajectory], model: Model) -> list[Left]:
    processed = [process(of, arm(), SETTINGS.process) for of in runs]
    return [(of, of.tau - predict_run(model, of), of.mask) for of in processed]


def left(*runs: Trajectory, test: Sequence[Trajectory] = (), effects: Sequence[Effect] = FRICTION) -> Standing:
    """Training ``runs`` and ``test`` runs (else one that is clear), and the model of ``effects``."""
    model = Model(arm(), tuple(effects))
    tests = test or [run("clear", 9, effects=effects)]
    return beyond_friction(model, parts(runs, model), parts(tests, model), np.full(2, NOISE), SETTINGS)


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
        assert found.where[0] == ""
        assert found.where[1].startswith("run a from 3.")
        assert " N m are left (rms, 2." in found.notes(("a", "b"))[0]
        assert " N are left" in found.notes(("a", "b"), ("b",))[0]


@pytest.mark.parametrize("offset", [1.0, 3.0])
def test_its_share_is_of_all_that_is_left_also_in_motion(offset: float) -> None:
    one = run("a", 1)
    moving = run("a", 1, effects=(*FRICTION, Effect("torque_offset", (ELBOW,), {"offset": offset})))
    found = left(pushed(moving, 8.0 - offset, joint=1), test=[run("clear", 9)])
    stood = found.seconds[1] * found.rms[1] ** 2
    kept = process(one, arm(), SETTINGS.process).mask[:, 1]
    in_motion = kept.mean() * 9.0 * offset**2
    assert found.share[1] == pytest.approx(stood / (stood + in_motion), abs=0.03)
    assert found.share[0] == 0.0


def test_every_stretch_is_told_with_its_own_times() -> None:
    both = run("a", 1)
    for start in (3.3, 4.9):
        both = pushed(both, 8.0, rows=slice(int(start * RATE), int((start + 0.6) * RATE)))
    first, second = left(both).where[0].removeprefix("run a ").split(" and ")
    assert first.startswith("from 3.")
    assert second.startswith("from 4.8")


def test_of_many_runs_those_with_most_of_it_are_told() -> None:
    several = [pushed(run(f"r{k}", k), 8.0, rows=slice(STANDS.start, STANDS.start + 140 + 20 * k)) for k in range(6)]
    told = left(*several).where[0].split("; ")
    assert [part.split(" from")[0] for part in told] == ["run r5", "run r4", "run r3", "3 more runs"]


def test_the_same_push_on_a_joint_that_moves_is_not_said_of_one_that_stands() -> None:
    assert not left(pushed(run("a", 1, stop=(0.4, 0.4)), 8.0)).seen.any()


def test_a_moment_is_let_pass_and_a_joint_that_never_moves_too() -> None:
    brief = slice(STANDS.start, STANDS.start + int(0.3 * RATE))
    assert not left(pushed(run("a", 1), 8.0, rows=brief)).seen.any()
    model = Model(arm(), FRICTION)
    clear = parts([run("clear", 9)], model)
    unknown = np.array([0.0, NOISE])
    assert not beyond_friction(model, parts([pushed(run("a", 1), 8.0)], model), clear, unknown, SETTINGS).seen.any()
    # Of a log that stands for long, a little more than half a second is little.
    still = run("still", 2, moves=(1e-4, 1e-4), duration=15.0)
    for seconds, seen in ((LASTS + 0.1, False), (SHARE * 15 + 0.2, True)):
        start = slice(0, int((seconds + 0.1) * RATE))
        assert left(pushed(still, 8.0, rows=start)).seen[0] == seen
    hour = run("still", 2, moves=(1e-4, 1e-4), duration=100.0)
    assert left(pushed(hour, 8.0, rows=slice(0, int((LONG + 0.3) * RATE)))).seen[0], "less than a twentieth, and long"
    # However many other runs there are.
    clear_runs = [run(f"clear_{k}", 20 + k) for k in range(25)]
    assert left(*clear_runs, test=[pushed(run("a", 1), 8.0)]).seen.tolist() == [True, False]


def test_what_happened_once_in_motion_hides_nothing_that_happens_at_rest() -> None:
    once = slice(int(7.5 * RATE), int(8.3 * RATE))
    test = pushed(pushed(run("a", 1), 8.0), 8.0, rows=once)
    assert left(run("b", 2), test=[test]).seen.tolist() == [True, False]
    # A model that is off in motion, too, has that told already.
    assert not left(run("b", 2), test=[pushed(pushed(run("a", 1), 8.0), 4.0, rows=slice(0, None))]).seen.any()


def test_a_joint_that_stands_while_its_partner_moves_has_the_partners_torque() -> None:
    for rows, sign in (("own", "partner"), ("both", "sum"), ("both", "difference")):
        coupling = Effect(
            "joint_coupling",
            (SHOULDER,),
            {"viscous_coefficient": 2.0, "coulomb_torque": 1.0, "armature": 0.1},
            {"from_joint": ELBOW, "rows": rows, "sign_of": sign},
        )
        effects = (*FRICTION, coupling)
        one_rests = run("a", 1, effects=effects, stop=(0.0, 1.0))
        assert not left(one_rests, effects=effects).seen.any()
        assert left(pushed(one_rests, 16.0), effects=effects).seen.tolist() == [True, False]
        # Where both rest the partner may be about to go either way: its share holds, too.
        both_rest = run("a", 1, effects=effects)
        assert not left(pushed(both_rest, 0.95 * BREAKS_AWAY * (COULOMB + 1.0)), effects=effects).seen.any()
        assert left(pushed(both_rest, 8.0), effects=effects).seen.tolist() == [True, False]


def test_a_sign_that_turns_over_slowly_holds_its_whole_torque_at_rest() -> None:
    effects = (coulomb(SHOULDER, sign_width=0.2), VISCOUS, coulomb(ELBOW))
    of = run("a", 1, effects=effects)
    assert not left(pushed(of, 0.9 * COULOMB), effects=effects).seen.any()
    found = left(pushed(of, 8.0), effects=effects)
    assert found.held[0] == pytest.approx(COULOMB + 0.8 * SETTINGS.process.slow_speed, rel=1e-3)


def test_friction_that_grows_with_the_load_or_is_read_too_large_holds_as_much_more() -> None:
    grows = Effect("load_dependent_friction", (SHOULDER,), {"load_coefficient": 0.5}, {"sign_width": 1e-4})
    large = Effect("torque_gain", (SHOULDER,), {"gain": 2.0})
    of = process(run("a", 1), arm(), SETTINGS.process)
    rest = np.abs(of.time - 4.5) < 1.0
    m = of.motion
    held = [
        of.smooth(Model(arm(), effects).turning(m.q, m.dq, m.ddq, 0.02, [0], m.time, m.began)[1])[rest, 0].mean()
        for effects in ((FRICTION[0],), (FRICTION[0], grows), (FRICTION[0], large))
    ]
    load = np.abs(arm().inverse_dynamics(m.q, m.dq, m.ddq)[np.abs(m.time - 4.5) < 0.5, 0].mean())
    assert held[0] == pytest.approx(COULOMB)
    assert held[1] == pytest.approx(COULOMB + 0.5 * load, rel=0.02)
    assert held[2] == pytest.approx(2 * COULOMB)


def test_a_torque_that_comes_late_is_still_that_of_the_motion_before(monkeypatch: pytest.MonkeyPatch) -> None:
    viscous = Effect("viscous_friction", (SHOULDER,), {"viscous_coefficient": 40.0})
    late = Effect("time_delay", (), {"delay": 0.45}, {"response": "lag"})
    effects = (viscous, late)
    of = run("a", 1, effects=effects)
    floor = np.full(2, NOISE)

    def seen(one: Trajectory) -> list[bool]:
        model = Model(arm(), effects)
        whole = parts([one], model)
        # Before the log begins nobody knows the torque; what that leaves is no noise.
        known = [(r, e, keep & (r.time > 1.5)[:, None]) for r, e, keep in whole]
        return list(beyond_friction(model, known, known, floor, SETTINGS).seen)

    assert seen(of) == [False, False]
    assert seen(pushed(of, 8.0)) == [True, False]
    monkeypatch.setattr(resting, "FORGETS", 0.0)
    assert seen(of) == [True, False], "the control"


def test_a_push_that_is_named_in_motion_and_goes_on_at_rest_is_one() -> None:
    on = slice(int(1.5 * RATE), int(5.0 * RATE))
    contact = Effect("external_contact", (SHOULDER,), {"torque": 8.0}, {"intervals": ((1.5, 2.9),), "only_run": "a"})
    effects = (*FRICTION, contact)
    of = pushed(run("a", 1), 8.0, rows=on)
    assert not left(of, effects=effects).seen.any()
    assert left(pushed(of, 8.0, joint=1), effects=effects).seen.tolist() == [False, True], "another joint"
    later = pushed(pushed(run("a", 1), 8.0, rows=slice(on.start, STANDS.start)), -12.0, rows=slice(860, STANDS.stop))
    assert left(later, effects=effects).seen.tolist() == [True, False], "another push, the other way and later"
    # One that is over before the joint stands is another one.
    over = pushed(pushed(run("a", 1), 8.0, rows=slice(int(0.5 * RATE), int(1.5 * RATE))), 8.0)
    contact = Effect("external_contact", (SHOULDER,), {"torque": 8.0}, {"intervals": ((0.5, 1.5),), "only_run": "a"})
    assert left(over, effects=(*FRICTION, contact)).seen.tolist() == [True, False]


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
    assert any(line.startswith(f"{SHOULDER}: while it stands ") and "run c from 3." in line for line in d.notes)
    write_diagnosis(tmp_path / "diagnosis.json", d)
    value = json.loads((tmp_path / "diagnosis.json").read_text())
    assert state_of(value, 0) == ("open", HELD)
    assert state_of(value, 1)[1] == STANDING, "what friction of a joint that stands is, its motion does not say"
    said = f"not down to noise: {SHOULDER}: while it stands "
    assert any(line.startswith(said) for line in details(value))
    assert still_open(value)[0].startswith(f"{SHOULDER}: while it stands ")
    assert len([line for line in details(value) if SHOULDER in line and "down to noise" in line]) == 1
    # What happened once in motion does not hide it.
    once = slice(int(7.5 * RATE), int(8.3 * RATE))
    twice = close_loop(arm(), train, [pushed(pushed(run("c", 3, "test"), 8.0), 8.0, rows=once)], SETTINGS).diagnosis
    assert twice.beyond_friction[0] == pytest.approx(8.0, abs=0.2)
    # A doubt that is another one is told beside it.
    doubtful = value | {"cannot_tell": [True, False]}
    assert any(line.startswith(said) for line in details(doubtful))
    assert any(line.startswith(f"cannot be told: {SHOULDER}") for line in details(doubtful))
    assert any("may be noise or an effect" in line for line in still_open(doubtful))


def test_test_runs_that_stand_prove_nothing() -> None:
    train = [run("a", 1), run("b", 2)]
    with pytest.raises(InputError, match=r"no joint moves faster than 0\.02 rad/s on 20 samples of the test runs"):
        close_loop(arm(), train, [run("c", 3, "test", moves=(1e-3, 1e-3))], SETTINGS)
    late = run("d", 4)
    q = np.where((late.time < 4.0)[:, None], late["q"], late["q"][int(4.0 * RATE)])
    # A twitch at the end is no motion to prove anything on, but it is no rest that could be cut off, either.
    q[-10:] += 0.01
    rest = late.with_signals(q=q)
    with pytest.raises(InputError, match="cut off the end at which the robot rests"):
        close_loop(arm(), [rest], [], SETTINGS)
    # A jog on which nothing can be measured is no motion either, whatever the torque.
    jog = run("c", 3, "test")
    short = jog.with_signals(q=np.where((jog.time < 0.2)[:, None], jog["q"], jog["q"][int(0.2 * RATE)]))
    with pytest.raises(InputError, match="give test runs in motion, or none"):
        close_loop(arm(), train, [pushed(short, 0.8, rows=slice(0, None))], SETTINGS)
    one = close_loop(arm(), train, [run("c", 3, "test", moves=(1.0, 1e-3))], SETTINGS).diagnosis
    assert f"{ELBOW}: stands still in the test runs, which say nothing of what is found on it" in one.notes
    value = one.to_json()
    assert state_of(value, 1) == ("unseen", UNTESTED)
    assert state_of(value, 0)[1] == STANDING
