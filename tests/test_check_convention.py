"""A log that counts joints otherwise than the URDF is told as that, and what only looks like it is not."""

from dataclasses import replace

import numpy as np
import pytest
from tests.panda_arm import load_panda

import hybrid_dynamics.check.convention as convention_module
import hybrid_dynamics.check.torque as torque_module
from hybrid_dynamics.check.columns import columns_of, standing
from hybrid_dynamics.check.convention import Convention, _Counted, _Limits, check_convention
from hybrid_dynamics.check.findings import Finding
from hybrid_dynamics.check.forms import Fit, Forms
from hybrid_dynamics.check.guess import Guess, few_rows
from hybrid_dynamics.check.samples import stretches
from hybrid_dynamics.check.suggestion import combined
from hybrid_dynamics.check.torque import check_torque
from hybrid_dynamics.check.units import check_unit
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation.excitation import excitation
from hybrid_dynamics.trajectory import Trajectory


def friction(robot: Robot, size: float = 0.01) -> list[Effect]:
    """Viscous and Coulomb friction of every joint, as a share of its effort limit."""
    named = list(zip(robot.joint_names, size * robot.effort_limits, strict=True))
    return [
        *(Effect("coulomb_friction", (j,), {"coulomb_torque": float(f)}) for j, f in named),
        *(Effect("viscous_friction", (j,), {"viscous_coefficient": float(f)}) for j, f in named),
    ]


@pytest.fixture(scope="module")
def panda() -> Robot:
    return load_panda()


@pytest.fixture(scope="module")
def ur5() -> Robot:
    return Robot.from_urdf(find_description("ur5_robot.urdf"))


@pytest.fixture(scope="module")
def run(panda) -> Trajectory:
    return excitation(panda, friction(panda), duration=16.0, rate=100.0)


@pytest.fixture(scope="module")
def ur5_run(ur5) -> Trajectory:
    return excitation(ur5, friction(ur5), duration=16.0, rate=100.0)


def counted(run: Trajectory, sign: dict[int, int], zero: dict[int, float]) -> Trajectory:
    """``run`` as another convention reads it: ``sign`` of q and tau, then ``zero`` [rad] on q, by joint."""
    n = run.n_joints
    s, shift = np.ones(n), np.zeros(n)
    for j, value in sign.items():
        s[j] = value
    for j, angle in zero.items():
        shift[j] = angle
    return run.with_signals(q=s * run["q"] + shift, tau=s * run["tau"])


def mended(log: Trajectory, cure: dict) -> Trajectory:
    """``log`` read by the keys of a ``log.yaml``: value = sign * value + offset."""
    ones = [1] * log.n_joints
    sign, offset = cure.get("sign", {}), cure.get("offset", {})
    q = np.array(sign.get("q", ones)) * log["q"] + np.array(offset.get("q", np.zeros(log.n_joints)))
    return log.with_signals(q=q, tau=np.array(sign.get("tau", ones)) * log["tau"])


@pytest.mark.parametrize(
    ("sign", "zero"),
    [
        ({}, {1: np.pi / 2}),
        ({}, {1: -np.pi / 2, 3: np.pi / 2}),
        ({3: -1}, {3: np.pi / 2}),
        ({1: -1, 3: -1}, {}),
        ({}, {3: np.pi}),
    ],
    ids=["a quarter turn", "two of them", "turned round as well", "two turned round", "half a turn"],
)
def test_another_convention_is_told_and_its_cure_gives_the_arm_back(panda, run, sign, zero):
    log = counted(run, sign, zero)
    (found,) = [f for f in check_torque(panda, [log])[0] if f.severity == "hard"]
    assert found.code == "convention"
    assert "at panda_joint" in found.text
    back = mended(log, dict(found.suggestion))
    # Counted by the cure the arm weighs what it does: another reading of the same postures is as good.
    still = np.zeros_like(run["q"])
    weight = panda.inverse_dynamics(run["q"], still, still) * (back["tau"] / run["tau"])
    read = panda.inverse_dynamics(back["q"], still, still)
    assert np.sqrt(np.mean((read - weight) ** 2, axis=0)) == pytest.approx(0, abs=0.02 * np.abs(weight).max())
    assert not [f for f in check_torque(panda, [back])[0] if f.severity != "note"]


def test_the_arm_as_the_urdf_counts_it_is_no_other_convention(panda, ur5, run, ur5_run):
    assert [f.code for f in check_torque(panda, [run])[0]] == []
    assert [f.code for f in check_torque(ur5, [ur5_run])[0]] == []


def body(mass: float, x: float, y: float, z: float) -> Effect:
    inertia = {f"inertia_{a}{b}": 0.05 * (a == b) for a, b in ("xx", "xy", "yy", "xz", "yz", "zz")}
    return Effect("payload", (), {"mass": mass, "com_x": x, "com_y": y, "com_z": z} | inertia)


@pytest.mark.parametrize(
    "effect",
    [
        body(6.0, -0.05, -0.09, 0.17),
        body(5.0, 0.3, 0.0, 0.1),
        Effect("joint_spring", ("wrist_1_joint",), {"stiffness": 12.0, "rest_position": 0.7}, {"shape": "linear"}),
        Effect("gravity_tilt", (), {"roll": 1.4, "pitch": 0.5}),
        Effect("position_offset", ("elbow_joint",), {"offset": 0.4}),
        Effect("position_offset", ("wrist_2_joint",), {"offset": -0.5}),
    ],
    ids=["tool", "tool aside", "spring", "on a wall", "elbow", "wrist"],
)
def test_what_an_arm_may_have_beyond_its_description_is_no_other_convention(ur5, effect):
    log = excitation(ur5, [*friction(ur5), effect], duration=16.0, rate=100.0)
    assert "convention" not in [f.code for f in check_torque(ur5, [log])[0]]


def test_what_others_explain_as_well_is_doubtful_and_no_cure_is_given(panda, run, monkeypatch):
    log = counted(run, {}, {1: np.pi / 2})
    monkeypatch.setattr(convention_module, "_otherwise", lambda *given: [np.full(len(given[-1]), 0.015)])
    (found,) = [f for f in check_torque(panda, [log])[0] if f.code == "convention"]
    assert found.severity == "warning"
    assert not found.suggestion


def test_a_doubtful_convention_keeps_no_other_check_from_speaking(panda, run, monkeypatch):
    doubtful = Finding("convention", "warning", "it looks as if")
    monkeypatch.setattr(torque_module, "check_convention", lambda *_: [doubtful])
    late = run.with_signals(tau=np.roll(run["tau"], 20, axis=0))
    assert {"convention", "torque_delay"} <= {f.code for f in check_torque(panda, [late])[0]}


def test_a_joint_stays_within_its_limits_by_a_whole_turn(panda, run):
    parts = stretches([run])
    limits = _Limits(panda, parts)
    low, high = panda.position_limits
    for j in range(7):
        for turn in range(4):
            if (quarters := limits.within(j, 1, turn)) is not None:
                assert quarters % 4 == turn
                ends = [p.q[:, j] + quarters * np.pi / 2 for p in parts]
                assert min(e.min() for e in ends) > low[j] - 0.21
                assert max(e.max() for e in ends) < high[j] + 0.21
    # Its elbow bends one way only.
    assert limits.within(3, -1, 0) is None


def test_a_joint_that_slides_has_no_quarter_turn():
    robot = Robot.from_text(
        """<robot name="slide"><link name="base"/>
        <link name="a"><inertial><mass value="2"/>
        <inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="s" type="prismatic"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
        <limit lower="-1" upper="1" effort="50" velocity="1"/></joint></robot>""",
        "slide.urdf",
    )
    time = np.arange(400) / 100
    run = Trajectory("run", "train", time, {"q": 0.1 * np.sin(time)[:, None], "tau": np.full((400, 1), 19.62)})
    limits = _Limits(robot, stretches([run]))
    assert [limits.within(0, s, 0) for s in (1, -1)] == [0, 0]
    assert not limits.turns[0]


def test_the_cure_is_what_a_log_yaml_takes():
    convention = Convention((1, -1, 1), (0, 1, -2))
    assert convention.changed == [1, 2]
    assert convention.cure(np.zeros(3)) == {
        "offset": {"q": [0.0, 1.570796, -3.141593]},
        "sign": {"q": [1, -1, 1], "dq": [1, -1, 1], "tau": [1, -1, 1]},
    }
    assert Convention((1, 1), (0, 0)).cure(np.zeros(2)) == {}


def test_a_cure_comes_before_what_a_model_adds_to_the_positions():
    known, read = np.array([0.3, 0.2]), np.array([0.5, -0.4])
    convention = Convention((-1, 1), (1, 0))
    cure = convention.cure(known)
    counted = np.array([-1, 1]) * (read + known) + convention.offset
    assert np.array(cure["sign"]["q"]) * read + np.array(cure["offset"]["q"]) + known == pytest.approx(counted)


def test_a_cure_comes_on_top_of_what_the_log_yaml_has():
    raw = np.array([0.5, -0.4])
    old: dict[str, dict[str, list[float]]] = {"sign": {"q": [1, -1]}, "offset": {"q": [0.1, 0.2]}}
    cure = Convention((1, -1), (0, 1)).cure(np.zeros(2))
    new, _ = combined(old, [Finding("convention", "hard", "so", suggestion=cure)], ["a", "b"])
    before = np.array([1, -1]) * raw + np.array([0.1, 0.2])
    after = np.array(new["sign"]["q"]) * raw + np.array(new["offset"]["q"])
    assert after == pytest.approx([before[0], -before[1] + np.pi / 2], abs=1e-6)
    assert old["offset"]["q"] == [0.1, 0.2]


def test_a_guess_that_explains_as_much_leaves_no_convention(panda, run):
    """An arm on a wall, say."""
    log = counted(run, {}, {1: np.pi / 2})
    parts = stretches([log])
    columns = columns_of(panda, parts)
    told = as_told(panda, Forms(columns))
    assert check_convention(panda, parts, told, told, columns)
    rival = replace(told, scores=tuple(s - 10.0 for s in told.scores))
    assert check_convention(panda, parts, told, rival, columns) == []


def as_told(robot: Robot, forms: Forms) -> Guess:
    gravity = standing(robot)
    scores = tuple(forms.fit(j, gravity).score for j in range(forms.n))
    return Guess(gravity, (1,) * forms.n, tuple(range(forms.n)), None, None, 1.0, scores, 0.0)


def test_little_of_many_joints_is_no_convention(panda, run, monkeypatch):
    parts = stretches([run.with_signals(tau=run["tau"] + 5 * np.sin(run.time * np.arange(2, 9)[:, None]).T)])
    columns = columns_of(panda, parts)
    told = as_told(panda, Forms(columns))

    def better(*_):
        here = convention_module._scores(panda, few_rows(parts), told.gravity)
        return [_Counted(Convention((1,) * 7, (0, 1, 0, 0, 0, 0, 0)), here - 0.4)]

    monkeypatch.setattr(convention_module, "_search", better)
    assert check_convention(panda, parts, told, told, columns) == []


@pytest.mark.parametrize("joint", ["shoulder_lift_joint", "elbow_joint"])
def test_one_large_rotor_is_no_clock(ur5, joint):
    """Seventy times what the joint moves: but the others need no other clock."""
    rotor = Effect("armature", (joint,), {"armature": 150.0})
    log = excitation(ur5, [*friction(ur5), rotor], duration=30.0, rate=100.0)
    assert "time_scale" not in [f.code for f in check_torque(ur5, [log])[0]]


def test_links_of_three_times_the_inertia_are_no_clock(ur5, ur5_run):
    still = np.zeros_like(ur5_run["q"])
    dq = np.gradient(ur5_run["q"], ur5_run.dt, axis=0)
    ddq = np.gradient(dq, ur5_run.dt, axis=0)
    weight = ur5.inverse_dynamics(ur5_run["q"], still, still)
    motion = ur5.inverse_dynamics(ur5_run["q"], dq, ddq) - weight
    for times in (0.3, 3.0):
        log = ur5_run.with_signals(tau=weight + times * motion)
        # No motion tells it from a clock that is off by 1.7; nobody takes rates for each other by that.
        assert [f.severity for f in check_torque(ur5, [log])[0] if f.code == "time_scale"] in ([], ["warning"])


def test_a_unit_is_told_by_most_joints_not_by_one_of_two():
    def fit(alpha: float) -> Fit:
        return Fit(0.1, np.array([alpha, 0.0, 0.0, 0.0, 0.0]), 10.0)

    free = np.zeros(2, bool)
    assert check_unit(["a", "b"], [fit(0.0086), fit(0.92)], free) == []
    (found,) = check_unit(["a", "b"], [fit(1e-3), fit(1.1e-3)], free)
    assert found.code == "torque_unit"
    assert found.severity == "hard"


@pytest.mark.parametrize("factor", [10.0, 100.0])
def test_a_wrong_clock_of_one_joint_alone_is_told(factor):
    text = """<robot name="pendulum"><link name="base"/>
        <link name="a"><inertial><origin xyz="0 0 -.3"/><mass value="2"/>
        <inertia ixx=".02" iyy=".02" izz=".02" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="s" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/>
        <limit lower="-3" upper="3" effort="50" velocity="9"/></joint></robot>"""
    robot = Robot.from_text(text, "pendulum.urdf")
    run = excitation(robot, friction(robot, 0.002), duration=30.0, rate=200.0)
    slow = Trajectory("run", "train", run.time * factor, run.signals)
    assert "time_scale" in [f.code for f in check_torque(robot, [slow])[0]]
