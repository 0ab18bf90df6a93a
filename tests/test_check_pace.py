"""A clock that is off by a factor of two: inertia follows its square, weight knows nothing of it."""

import numpy as np
import pytest
from tests.panda_arm import FRICTION, JOINTS, load_panda, recorded

from hybrid_dynamics.check.findings import Finding
from hybrid_dynamics.check.torque import check_torque
from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory

#: Length [s] of a log, and its noise.
LOG = (20.0, 3)


@pytest.fixture(scope="module")
def panda() -> Robot:
    return load_panda()


@pytest.fixture(scope="module")
def run(panda: Robot) -> Trajectory:
    return recorded(panda, FRICTION, *LOG)


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
        assert clock(panda, recorded(panda, [*FRICTION, *effects], *LOG), 1.0) == []


def test_a_torque_without_weight_is_told_as_that_and_not_as_a_clock(panda, run):
    q = run["q"]
    weight = panda.inverse_dynamics(q, 0 * q, 0 * q)
    bare = run.with_signals(tau=run["tau"] - weight)
    assert clock(panda, bare, 1.0) == []
    assert [f.code for f in check_torque(panda, [bare])[0] if f.severity == "hard"] == ["torque_weight"]


def test_a_torque_that_nobody_measured_is_no_clock(panda, run):
    # Zeros hold no inertia, to the last digit.
    tau = run["tau"].copy()
    for silent in ([4, 5, 6], [0, 2, 4, 5, 6]):
        tau[:, silent] = 0.0
        assert clock(panda, run.with_signals(tau=tau), 1.0) == []
    tau = run["tau"].copy()
    tau[:, 4:] = 0.0
    (found,) = clock(panda, run.with_signals(tau=tau), 2.0)
    assert "2 times too slow" in found.text
