"""What went wrong on arms that nobody had tuned to, each case on data made here: verdicts that may be trusted."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.loop import LoopResult, close_loop
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation.excitation import excitation, excitations
from hybrid_dynamics.trajectory import Trajectory

BODY = {
    "mass": 1.5, "com_x": 0.03, "com_y": -0.02, "com_z": 0.1, "inertia_xx": 0.004, "inertia_xy": 0.0,
    "inertia_yy": 0.004, "inertia_xz": 0.0, "inertia_yz": 0.0, "inertia_zz": 0.003,
}  # fmt: skip
ALL_CLEAR = ("nothing_missing", "explained")


@pytest.fixture(scope="module")
def panda() -> Robot:
    return Robot.from_urdf(find_description("panda.urdf"), lock=("panda_finger_joint1", "panda_finger_joint2"))


def friction(robot: Robot, joints: tuple[int, ...] = (0, 1, 2, 3)) -> list[Effect]:
    names = [robot.joint_names[j] for j in joints]
    return [
        *(Effect("coulomb_friction", (n,), {"coulomb_torque": 1.0}) for n in names),
        *(Effect("viscous_friction", (n,), {"viscous_coefficient": 1.0}) for n in names),
    ]


def named(result: LoopResult) -> set[tuple[str, tuple[str, ...]]]:
    return {(e.effect.effect, e.effect.joints) for e in result.diagnosis.effects}


@pytest.mark.parametrize(("roll", "pitch"), [(np.pi / 2, 0.0), (0.7, 2.5)], ids=["on its side", "anywhere"])
def test_an_arm_mounted_anyhow_is_neither_refused_nor_torn_apart(roll, pitch, panda):
    effects = [Effect("gravity_tilt", (), {"roll": roll, "pitch": pitch}), *friction(panda)]
    train, test = excitations(panda, effects, train=2, test=1, duration=8.0)
    result = close_loop(panda, train, test)
    assert named(result) == {(e.effect, e.joints) for e in effects}
    assert result.diagnosis.verdict == "explained"
    tilt = next(e.effect for e in result.diagnosis.effects if e.effect.effect == "gravity_tilt")
    assert all(-np.pi <= v <= np.pi for v in tilt.parameters.values())
    found, true = (gravity_direction(panda, p) for p in (tilt.parameters, {"roll": roll, "pitch": pitch}))
    assert np.arccos(np.clip(found @ true, -1, 1)) < np.deg2rad(0.2)


def gravity_direction(robot: Robot, parameters: dict[str, float]) -> np.ndarray:
    """Direction of gravity in the base frame under a tilt."""
    from hybrid_dynamics.effects import with_effects

    changed, _ = with_effects(robot, [Effect("gravity_tilt", (), parameters)])
    vector = np.asarray(changed.model.gravity.linear)
    return vector / np.linalg.norm(vector)


def test_joints_that_stand_still_in_one_run_keep_an_honest_floor_and_their_friction(panda):
    effects = friction(panda, (3, 5))
    moving = excitation(panda, effects, name="moving", duration=10.0, seed=1)
    still = excitation(panda, effects, name="still", duration=10.0, seed=2, still=(3, 5))
    test = excitation(panda, effects, name="test", split="test", duration=8.0, seed=3)
    result = close_loop(panda, [moving, still], [test])
    assert {("coulomb_friction", ("panda_joint4",)), ("viscous_friction", ("panda_joint4",))} <= named(result)
    truth = excitation_noise(panda)
    for j in (3, 5):
        # The encoder adds a little to the torque noise; a floor that follows the samples is hundreds of times too low.
        assert 0.7 * truth[j] < result.diagnosis.noise_floor_low[j] < 2.0 * truth[j]


def excitation_noise(robot: Robot) -> np.ndarray:
    """(n,) [N m] of white torque noise after the loop's filter (25 Hz at 500 Hz): what the excitations carry."""
    from hybrid_dynamics.loop.process import hann_kernel

    return 0.003 * robot.effort_limits * np.sqrt(np.sum(hann_kernel(1 / 25.0, 2e-3) ** 2))


def test_friction_and_a_payload_are_named_from_one_run_of_five_seconds(panda):
    effects = [Effect("payload", (), BODY), *friction(panda, (1, 3))]
    run = excitation(panda, effects, name="short", duration=6.5, seed=4)
    test = excitation(panda, effects, name="test", split="test", duration=6.5, seed=5)
    result = close_loop(panda, [run], [test])
    assert ("payload", ()) in named(result)
    assert {("viscous_friction", ("panda_joint2",)), ("coulomb_friction", ("panda_joint2",))} <= named(result)
    assert named(result) <= {(e.effect, e.joints) for e in effects}
    error = result.diagnosis.error["test"]
    assert error.after.relative_error < 0.3 * error.before.relative_error  # type: ignore[operator]


def test_a_name_that_the_test_runs_contradict_is_said_kept_inactive_and_left_out_of_the_model(panda, tmp_path):
    # Friction that has gone in the test run: nothing in the training runs can know.
    effects = friction(panda, (1,))
    train, _ = excitations(panda, effects, train=2, test=1, duration=8.0)
    test = excitation(panda, (), name="test", split="test", duration=8.0, seed=9)
    result = close_loop(panda, train, [test])
    d = result.diagnosis
    against = [e for e in d.effects if not e.confirmed]
    assert {e.effect.effect for e in against} == {"coulomb_friction", "viscous_friction"}
    assert all(e.why_not for e in against)
    assert result.model.effects == ()
    assert len(result.model.inactive) == len(against)
    change = d.error["test"]
    assert change.after.rmse[1] > 2 * change.before.rmse[1]
    assert change.after_confirmed is not None
    assert change.after_confirmed.rmse == pytest.approx(change.before.rmse)
    assert d.verdict not in ALL_CLEAR
    result.model.save(tmp_path / "model.json")
    again = type(result.model).load(tmp_path / "model.json", panda)
    assert (again.effects, len(again.inactive)) == ((), len(against))
    # The same friction still there: confirmed.
    kept = close_loop(panda, train, excitations(panda, effects, train=2, test=1, duration=8.0)[1])
    assert all(e.confirmed for e in kept.diagnosis.effects)


def late(run: Trajectory, seconds: float) -> Trajectory:
    rows = round(seconds / run.dt)
    return replace(run.rows(slice(rows, None)), signals={"q": run["q"][rows:], "tau": run["tau"][:-rows]})


def test_a_torque_recorded_late_is_no_all_clear_unless_the_delay_is_named(panda):
    train, test = excitations(panda, (), train=2, test=1, duration=8.0)
    result = close_loop(panda, [late(r, 0.05) for r in train], [late(r, 0.05) for r in test])
    d = result.diagnosis
    assert d.verdict not in ALL_CLEAR or ("time_delay", ()) in named(result)


def two_joint_law(run: Trajectory) -> np.ndarray:
    torque = np.zeros_like(run["tau"])
    torque[:, 1] = np.sin(run["q"][:, 2]) * np.cos(2 * run["q"][:, 3])
    return torque


def memory_law(run: Trajectory) -> np.ndarray:
    torque = np.zeros_like(run["tau"])
    fade = np.exp(-run.dt / 0.3)
    torque[:, 3] = lfilter([1 - fade], [1, -fade], np.tanh(np.gradient(run["q"][:, 3], run.dt) / 0.05))
    return torque


@pytest.mark.parametrize("law", [two_joint_law, memory_law])
def test_a_law_outside_the_catalogue_raises_the_alarm(law, panda):
    train, test = excitations(panda, (), train=3, test=1, duration=8.0)
    added = [r.with_signals(tau=r["tau"] + law(r)) for r in (*train, *test)]
    d = close_loop(panda, added[:3], added[3:]).diagnosis
    joint = int(np.argmax(np.abs(law(train[0])).max(axis=0)))
    assert d.verdict not in ALL_CLEAR
    assert d.motion_dependent[joint] or d.cannot_tell[joint]
    assert not any(f for j, f in enumerate(d.motion_dependent) if j != joint)


@pytest.mark.parametrize("colour", ["autoregressive", "pink"])
def test_coloured_noise_alone_is_no_alarm_and_nothing_is_named(colour, panda):
    rng = np.random.default_rng(5)
    runs = []
    for k in range(3):
        run = excitation(panda, (), name=f"run_{k}", split="train" if k < 2 else "test", duration=8.0,
                       torque_noise_share=0.0, seed=20 + k)  # fmt: skip
        noise = rng.normal(size=run["tau"].shape)
        if colour == "autoregressive":
            noise = lfilter([1], [1, -np.exp(-run.dt / 0.05)], noise, axis=0)
        else:
            spectrum = np.fft.rfft(noise, axis=0)
            frequency = np.fft.rfftfreq(len(noise), run.dt)[:, None]
            spectrum[1:] /= np.sqrt(frequency[1:])
            spectrum[0] = 0
            noise = np.fft.irfft(spectrum, len(noise), axis=0)
        noise *= 0.003 * panda.effort_limits / noise.std(axis=0)
        runs.append(run.with_signals(tau=run["tau"] + noise))
    result = close_loop(panda, runs[:2], runs[2:])
    assert named(result) == set()
    assert result.diagnosis.verdict == "nothing_missing"


def test_asked_what_changed_where_nothing_did_the_answer_is_nothing(panda):
    effects = friction(panda, (1, 3))
    train, test = excitations(panda, effects, train=2, test=1, duration=8.0)
    calibrated = close_loop(panda, train, test)
    other = [excitation(panda, effects, name=f"other_{k}", duration=8.0, seed=40 + k) for k in range(2)]
    again = close_loop(panda, other[:1], [replace(other[1], split="test")], start=calibrated.model)
    assert named(again) == set()
    assert again.diagnosis.verdict == "nothing_missing"
    # With a payload it is the payload.
    loaded = [excitation(panda, [*effects, Effect("payload", (), BODY)], name=f"l_{k}", duration=8.0, seed=50 + k)
              for k in range(2)]  # fmt: skip
    changed = close_loop(panda, loaded[:1], [replace(loaded[1], split="test")], start=calibrated.model)
    assert named(changed) == {("payload", ())}


def test_what_a_neighbour_does_to_a_joint_is_named_though_nothing_is_left_of_the_neighbour(panda):
    """A motor that brakes its neighbour, whose own torque is explained: only one row says something is missing."""
    coupling = Effect(
        "joint_coupling",
        ("panda_joint5",),
        {"viscous_coefficient": 0.4, "coulomb_torque": 0.5, "armature": 0.0},
        {"from_joint": "panda_joint6", "rows": "own", "sign_of": "partner"},
    )
    train, test = excitations(panda, [coupling], train=2, test=1, duration=8.0)
    result = close_loop(panda, train, test)
    assert named(result) == {("joint_coupling", ("panda_joint5",))}
    found = result.diagnosis.effects[0].effect
    assert dict(found.settings)["from_joint"] == "panda_joint6"
    assert found.parameters["coulomb_torque"] == pytest.approx(0.5, rel=0.1)
    assert result.diagnosis.verdict == "explained"


def test_a_delay_that_is_this_way_in_one_run_and_that_way_in_another_is_no_cause(panda):
    """Clocks of two recordings that were started by hand: nothing on the whole, so no property of the robot."""
    runs = []
    for k, late in enumerate((0.002, -0.002, 0.0)):
        run = excitation(panda, [], name=f"r{k}", split="test" if k == 2 else "train", duration=8.0, seed=60 + k)
        tau = np.column_stack([np.interp(run.time - late, run.time, column) for column in run["tau"].T])
        runs.append(run.with_signals(tau=tau))
    result = close_loop(panda, runs[:2], runs[2:])
    for entry in result.diagnosis.effects:
        delay = entry.effect.parameters.get("delay")
        assert delay is None or abs(delay) > entry.effect.std_errors["delay"]
