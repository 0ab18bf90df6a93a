"""A clock that is off by a factor of two: inertia follows its square, weight knows nothing of it."""

import numpy as np
import pytest
from tests.panda_arm import FRICTION, JOINTS, load_panda, recorded

from hybrid_dynamics.check.columns import columns_of, standing
from hybrid_dynamics.check.completed import true_stretches
from hybrid_dynamics.check.findings import Finding
from hybrid_dynamics.check.torque import check_torque
from hybrid_dynamics.check.weight import weigh
from hybrid_dynamics.effects import Effect, Term, predict
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.excitation import excitation
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


def slowly(robot: Robot, times: float) -> Trajectory:
    """The motion of 20 s so many ``times`` slower, noise of 0.05 N m."""
    log = excitation(robot, FRICTION, duration=20.0, rate=200.0)
    time, rng = times * log.time, np.random.default_rng(0)
    dq = np.gradient(log["q"], time, axis=0)
    tau = predict(robot, FRICTION, log["q"], dq, np.gradient(dq, time, axis=0), time)
    return Trajectory("run", "train", time, {"q": log["q"], "tau": tau + rng.normal(0.0, 0.05, tau.shape)})


@pytest.mark.parametrize("times", [2.0, 4.0])
def test_wrists_whose_current_is_hardly_ever_more_than_nothing_are_no_clock(panda, times):
    # A PAL TIAGo: one step of the wrists' current is more than they draw, so one sample in ten is another than 0.
    run = slowly(panda, times)
    tau = run["tau"].copy()
    tau[:, 5:] = 0.002 * (np.random.default_rng(0).random((len(tau), 2)) < 0.1)
    silent = run.with_signals(tau=tau)
    assert clock(panda, silent, 1.0) == []
    # Control: the joints that lift tell a clock that is off.
    assert [f.severity for f in clock(panda, silent, 0.5)] == ["hard"]


@pytest.mark.parametrize("times", [3.0, 6.0])
@pytest.mark.parametrize("slower", [2.0, 4.0, 0.5])
def test_a_clock_that_is_off_is_told_of_slow_logs_too(panda, times, slower):
    assert [f.severity for f in clock(panda, slowly(panda, times), slower)] == ["hard"]
    assert clock(panda, slowly(panda, times), 1.0) == []


def test_a_clock_is_only_doubted_where_the_joint_that_lifts_most_is_balanced(panda):
    spring = Effect("joint_spring", (JOINTS[1],), {"stiffness": -60.0, "rest_position": 0.0}, {"shape": "sine"})
    (found,) = clock(panda, recorded(panda, [*FRICTION, spring], *LOG), 0.5)
    assert found.severity == "warning"


#: Friction that falls with the speed, as gears' does.
FALLING = [
    Effect("stribeck_friction", (j,), {"coulomb_torque": 0.5, "static_torque": 1.0, "stribeck_velocity": 0.05})
    for j in JOINTS
]


def one_way(robot: Robot, seed: int) -> Trajectory:
    """20 s at 100 Hz of all joints along one way, slowly: inertia makes a hundredth of the torque, or less."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, 20.0, 0.01)
    way = 0.05 * time + 0.05 * np.sin(6 * np.pi * time / 20.0)
    q = np.array([0.0, 0.0, 0.0, -1.8, 0.0, 1.5, 0.0]) + 0.5 * rng.normal(size=7) * way[:, None]
    dq = np.gradient(q, time, axis=0)
    tau = predict(robot, FALLING, q, dq, np.gradient(dq, time, axis=0), time)
    return Trajectory("run", "train", time, {"q": q, "tau": tau + rng.normal(0.0, 0.005, tau.shape)})


@pytest.mark.parametrize("seed", range(4))
def test_inertia_below_what_the_weight_may_be_off_by_tells_no_clock(panda, run, seed):
    # Of a slow way along which friction falls, .03 +- .03 of an xArm's inertia had been told, and its log refused.
    def own(log: Trajectory) -> float:
        found = weigh(columns_of(panda, true_stretches(panda, [log])), standing(panda))
        assert found is not None
        return found.clear_motion_error + found.clear_off

    assert own(one_way(panda, seed)) > 1.0
    assert clock(panda, one_way(panda, seed), 1.0) == []
    # Control: a lively motion tells it to a tenth.
    assert own(run) < 0.1
