"""Torques each in a unit of its own, as motor currents are: no links make them together; and what is not that."""

from dataclasses import replace

import numpy as np
import pytest
from tests.panda_arm import FRICTION, JOINTS, load_panda, recorded

from hybrid_dynamics.check import torque as torque_module
from hybrid_dynamics.check import units as units_module
from hybrid_dynamics.check.findings import Finding
from hybrid_dynamics.check.torque import check_torque
from hybrid_dynamics.effects import Effect, Term, predict
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory

#: N m per ampere of three sizes of motors and their gears.
MOTORS = np.array([12.0, 12.0, 10.0, 4.0, 4.0, 2.5, 2.5])
#: Length [s] of a log, and its noise.
LOG = (16.0, 5)


@pytest.fixture(scope="module")
def panda() -> Robot:
    return load_panda()


@pytest.fixture(scope="module")
def run(panda: Robot) -> Trajectory:
    return recorded(panda, FRICTION, *LOG)


def units(robot: Robot, log: Trajectory) -> list[Finding]:
    return [f for f in check_torque(robot, [log])[0] if f.code == "torque_unit"]


@pytest.mark.parametrize("scale", [2.0, 4.0, 8.0])
def test_motor_currents_are_told_where_each_might_be_a_lighter_link(panda, run, scale):
    # From a sixth to three times the model's: no factor is out of proportion by itself.
    (found,) = units(panda, run.with_signals(tau=run["tau"] * scale / MOTORS))
    assert found.severity == "hard"
    assert not found.suggestion
    assert "torque_constant" in found.text


def test_the_factors_told_are_those_of_the_motors(panda, run):
    (found,) = units(panda, run.with_signals(tau=run["tau"] * 2.0 / MOTORS))
    told = found.text.rsplit("is measured: ", 1)[1].split(", ")
    factors = {name: float(value) for name, value in (entry.split() for entry in told)}
    assert len(factors) >= 4
    for name, factor in factors.items():
        assert factor == pytest.approx(2.0 / MOTORS[JOINTS.index(name)], rel=0.1)


def test_currents_of_an_arm_whose_links_weigh_otherwise_are_told_too(panda):
    tool = Term("payload")
    numbers = tool.family().parameters_of(np.r_[3.0, 0.1, 0.0, 0.4, 0.06, 0.06, 0.03, 0.0, 0.0, 0.0], panda, tool)
    log = recorded(panda, [*FRICTION, Effect("payload", (), numbers)], *LOG)
    (found,) = units(panda, log.with_signals(tau=log["tau"] / MOTORS))
    assert found.severity == "hard"


@pytest.mark.parametrize("factor", [0.4, 1.0, 2.5])
def test_one_unit_for_all_is_none_of_its_own_whatever_the_links_weigh(panda, run, factor):
    # A URDF of another density, or a gain of all joints.
    assert units(panda, run.with_signals(tau=run["tau"] * factor)) == []


def test_a_heavy_tool_springs_and_gains_are_no_units(panda):
    tool = Term("payload")
    numbers = tool.family().parameters_of(np.r_[6.0, 0.3, 0.0, 1.2, 0.3, 0.3, 0.1, 0.0, 0.0, 0.0], panda, tool)
    springs = [
        Effect("joint_spring", (JOINTS[j],), {"stiffness": k, "rest_position": 0.2}, {"shape": "sine"})
        for j, k in ((1, 40.0), (3, 15.0))
    ]
    gains = [Effect("torque_gain", (JOINTS[j],), {"gain": k}) for j, k in ((1, 1.4), (3, 0.7))]
    for effects in ([Effect("payload", (), numbers)], springs, gains):
        assert units(panda, recorded(panda, [*FRICTION, *effects], *LOG)) == []


@pytest.mark.parametrize(("factor", "severity"), [(4.0, "warning"), (0.2, "warning"), (12.0, "hard")])
def test_one_joint_alone_is_refused_only_beyond_all_proportion(panda, run, factor, severity):
    other = np.where(np.arange(7) == 3, factor, 1.0)
    (found,) = units(panda, run.with_signals(tau=run["tau"] * other))
    assert found.severity == severity
    assert ("one joint alone may lack something else" in found.text) == (severity == "warning")


def test_a_joint_whose_torque_is_silent_has_no_say(panda, run):
    tau = 2.0 * run["tau"] / MOTORS
    tau[:, 6] = 0.0
    (found,) = units(panda, run.with_signals(tau=tau))
    assert found.severity == "hard"
    assert JOINTS[6] not in found.text.rsplit("is measured: ", 1)[1]


@pytest.mark.parametrize("stands_at", [0.37, -0.0041])
def test_a_torque_that_never_changes_hides_no_other_joints_unit_and_is_none(panda, run, stands_at):
    # What an offset leaves of it is rounding, in which links would be beyond all others.
    tau = run["tau"].copy()
    tau[:, 5] = stands_at
    assert units(panda, run.with_signals(tau=tau)) == []
    # Control: the others' motor currents are told all the same.
    (found,) = units(panda, run.with_signals(tau=np.where(np.arange(7) == 5, tau, 2.0 * tau / MOTORS)))
    assert found.severity == "hard"


def small_motion(robot, effects, seed):
    """7.6 s of a few tenths of a radian about some pose: little of what links make, and much of friction."""
    rng = np.random.default_rng(seed)
    time, omega = np.arange(0.0, 7.6, 0.005), 2 * np.pi * np.array([0.15, 0.4, 0.8, 1.1])[:, None, None]
    pose = np.clip(rng.uniform(-1, 1, 7), robot.position_limits[0] + 0.5, robot.position_limits[1] - 0.5)
    size = 0.25 * rng.uniform(0.2, 1.0, (4, 1, 7)) / np.sqrt(omega)
    angle = omega * time[None, :, None] + rng.uniform(0, 2 * np.pi, (4, 1, 7))
    q = pose + (size * np.sin(angle)).sum(axis=0)
    dq, ddq = ((size * omega * np.cos(angle)).sum(axis=0), -(size * omega**2 * np.sin(angle)).sum(axis=0))
    tau = predict(robot, effects, q, dq, ddq, time) + 0.05 * rng.normal(size=q.shape)
    return Trajectory("run", "train", time, {"q": q, "dq": dq, "tau": tau})


@pytest.mark.parametrize("joint", [4, 5])
def test_friction_that_turns_over_along_the_way_is_no_unit(panda, monkeypatch, joint):
    """Presliding friction of a wrist, .15 rad long, that is most of its torque: no factor of any other joint."""
    held = Effect("hysteresis_friction", (JOINTS[joint],), {"presliding_stiffness": 2.0 / 0.15, "coulomb_torque": 2.0})
    log = small_motion(panda, [held], 3)
    assert units(panda, log) == []
    # Controls: to friction that turns over at once, and of which links need not make anything as described, it is one;
    # and a joint that is read in another unit, as described but for its factor, is told with such friction elsewhere.
    other = np.where(np.arange(7) == 3, 12.0, 1.0)
    (found,) = units(panda, log.with_signals(tau=log["tau"] * other))
    assert found.severity == "hard"
    monkeypatch.setattr(units_module, "PRESLIDING", ())
    assert units(panda, log) == []
    own = units_module._under

    def as_described(robot, parts, columns, gravity, fits):
        return own(robot, parts, columns, gravity, [replace(f, left=0.0) for f in fits])

    monkeypatch.setattr(units_module, "_under", as_described)
    (wrong,) = units(panda, log)
    # Links and factors of other parts say so of the fifth joint alone.
    assert wrong.severity == ("hard" if joint == 5 else "warning")


def few_moves(robot: Robot, seed: int) -> Trajectory:
    """7.5 s of three moves from pose to pose, links that weigh otherwise than the URDF says, presliding friction."""
    rng = np.random.default_rng(seed)
    heavier = robot.copy()
    for body in heavier.model.inertias.tolist()[1:]:
        body.mass *= np.exp(0.2 * rng.normal())
        body.lever = body.lever * np.exp(0.15 * rng.normal())
    low, high = np.clip(robot.position_limits, -2.5, 2.5)
    poses = (low + high) / 2 + 0.25 * (high - low) * rng.uniform(-1, 1, (4, 7))
    time = np.arange(0.0, 7.5, 0.02)
    share = np.clip(1.25 * (time / 2.5 % 1.0), 0.0, 1.0)[:, None]
    smooth, move = share**3 * (10 - 15 * share + 6 * share**2), np.minimum((time / 2.5).astype(int), 2)
    q = poses[move] + smooth * (poses[move + 1] - poses[move])
    dq = np.gradient(q, time, axis=0)
    rough = [
        Effect("hysteresis_friction", (j,), {"presliding_stiffness": f / 0.15, "coulomb_torque": f})
        for j, f in zip(JOINTS, 0.06 * robot.effort_limits, strict=True)
    ]
    tau = predict(heavier, rough, q, dq, np.gradient(dq, time, axis=0), time)
    return Trajectory("run", "train", time, {"q": q, "tau": tau + 0.03 * tau.std(axis=0) * rng.normal(size=tau.shape)})


@pytest.mark.parametrize("seed", [21, 43, 51])
def test_a_few_moves_of_links_that_weigh_otherwise_are_no_unit(panda, monkeypatch, seed):
    # Gravity seems turned by 16 to 19 degrees then, and no links at all make up for gravity that is not there.
    log = few_moves(panda, seed)
    findings, _ = check_torque(panda, [log])
    assert [f.code for f in findings if f.severity == "hard"] == []
    # By a share that links leave of any such log it is a matter of gravity alone.
    monkeypatch.setattr(units_module, "FAILS", 0.0)
    findings, _ = check_torque(panda, [log])
    assert [f.code for f in findings if f.severity == "hard"] == []
    # Control: under that gravity alone it is refused.
    own = units_module.check_own_units

    def under_that(robot, parts, columns, forms, gravities):
        return own(robot, parts, columns, forms, gravities[:1])

    monkeypatch.setattr(torque_module, "check_own_units", under_that)
    (wrong,) = units(panda, log)
    assert wrong.severity == "hard"


def test_factors_of_motors_carry_over_and_links_of_one_unit_do_not(panda, run, monkeypatch):
    asked = []
    own = units_module._Shown.held_out

    def held_out(shown, start):
        asked.append(own(shown, start))
        return asked[-1]

    monkeypatch.setattr(units_module._Shown, "held_out", held_out)
    (found,) = units(panda, run.with_signals(tau=2.0 * run["tau"] / MOTORS))
    assert found.severity == "hard"
    with_factors, without = asked
    # The last wrist is mostly noise.
    assert np.all(with_factors[:6] < 0.02)
    assert without[:6].sum() > 20 * with_factors[:6].sum()


@pytest.mark.parametrize(
    ("joints", "factor", "severity"),
    [((6,), 1000.0, "hard"), ((6,), 0.1, "hard"), ((4, 6), 1000.0, "hard"), ((), 1.0, "")],
)
def test_a_wrist_in_another_unit_is_told_of_an_arm_with_a_tool_that_the_model_lacks(panda, joints, factor, severity):
    """Then the links as described do not explain it, times any factor: other links do, next to exactly."""
    tool = Term("payload")
    numbers = tool.family().parameters_of(np.r_[8.0, 1.2, 0.0, 1.6, 0.34, 0.34, 0.02, 0.0, -0.12, 0.0], panda, tool)
    log = recorded(panda, [*FRICTION, Effect("payload", (), numbers)], 8.0, 3)
    other = np.where(np.isin(np.arange(7), joints), factor, 1.0)
    found = units(panda, log.with_signals(tau=log["tau"] * other))
    assert [f.severity for f in found] == ([severity] if severity else [])
