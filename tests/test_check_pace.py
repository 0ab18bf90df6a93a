"""A clock that is off by a factor of two: inertia follows its square, weight knows nothing of it."""

import numpy as np
import pytest

from hybrid_dynamics.check.findings import Finding
from hybrid_dynamics.check.torque import check_torque
from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation.excitation import excitation
from hybrid_dynamics.trajectory import Trajectory

JOINTS = [f"panda_joint{j}" for j in range(1, 8)]
FRICTION = [
    *(Effect("coulomb_friction", (j,), {"coulomb_torque": 0.5}) for j in JOINTS),
    *(Effect("viscous_friction", (j,), {"viscous_coefficient": 0.8}) for j in JOINTS),
]


@pytest.fixture(scope="module")
def panda() -> Robot:
    return Robot.from_urdf(find_description("panda.urdf"), ("panda_finger_joint1", "panda_finger_joint2"))


def recorded(robot: Robot, effects: list[Effect]) -> Trajectory:
    log = excitation(robot, effects, duration=20.0, rate=200.0)
    noise = np.random.default_rng(3).normal(size=log["tau"].shape)
    return log.with_signals(tau=log["tau"] + 0.05 * noise)


@pytest.fixture(scope="module")
def run(panda: Robot) -> Trajectory:
    return recorded(panda, FRICTION)


def clock(robot: Robot, run: Trajectory, slower: float) -> list[Finding]:
    read = Trajectory(run.name, run.split, run.time * slower, {k: v for k, v in run.signals.items() if k != "dq"})
    return [f for f in check_torque(robot, [read])[0] if f.code == "time_scale"]


@pytest.mark.parametrize(
    ("slower", "told"),
    [(2.0, "2 times too slow"), (4.0, "4 times too slow"), (0.5, "2 times too fast"), (0.25, "4 times too fast")],
)
def test_a_rate_that_was_guessed_wrong_is_refused_with_its_factor(panda, run, slower, told):
    (found,) = clock(panda, run, slower)
    assert found.severity == "hard"
    assert told in found.text


def test_a_clock_that_is_right_is_not_accused(panda, run):
    assert clock(panda, run, 1.0) == []
    assert clock(panda, run, 1.1) == []


def test_what_changes_inertia_or_weight_alone_by_rights_is_no_clock(panda):
    tool = Term("payload")
    numbers = tool.family().parameters_of(np.r_[4.0, 0.2, 0.0, 0.5, 0.1, 0.1, 0.03, 0.0, 0.0, 0.0], panda, tool)
    rotors = [Effect("armature", (j,), {"armature": 0.6}) for j in JOINTS]
    spring = Effect("joint_spring", (JOINTS[1],), {"stiffness": 20.0, "rest_position": 0.1}, {"shape": "sine"})
    heavy = Effect("torque_gain", (), {"gain": 1.6})
    for effects in ([Effect("payload", (), numbers)], rotors, [spring], [heavy]):
        assert clock(panda, recorded(panda, [*FRICTION, *effects]), 1.0) == []


def test_a_torque_without_weight_is_told_as_that_and_not_as_a_clock(panda, run):
    q = run["q"]
    weight = panda.inverse_dynamics(q, 0 * q, 0 * q)
    bare = run.with_signals(tau=run["tau"] - weight)
    assert clock(panda, bare, 1.0) == []
    assert [f.code for f in check_torque(panda, [bare])[0] if f.severity == "hard"] == ["torque_weight"]
