"""Does the torque fit the motion? Each fault is told as itself, and what is no fault passes."""

from dataclasses import replace

import numpy as np
import pytest
from tests.panda_arm import JOINTS, load_panda

from hybrid_dynamics.check import checked
from hybrid_dynamics.check.columns import Columns, columns_of, of_each, standing
from hybrid_dynamics.check.delay import find_delay
from hybrid_dynamics.check.forms import Forms
from hybrid_dynamics.check.guess import Guess
from hybrid_dynamics.check.order import places
from hybrid_dynamics.check.samples import Stretch, direction, stretches
from hybrid_dynamics.check.torque import _shown_by, _signs, check_torque, outvoted
from hybrid_dynamics.effects import Effect, predict
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation.excitation import excitation
from hybrid_dynamics.trajectory import Trajectory

FRICTION = [
    *(Effect("coulomb_friction", (j,), {"coulomb_torque": 0.5}) for j in JOINTS),
    *(Effect("viscous_friction", (j,), {"viscous_coefficient": 0.4}) for j in JOINTS),
]


@pytest.fixture(scope="module")
def panda() -> Robot:
    return load_panda()


@pytest.fixture(scope="module")
def run(panda) -> Trajectory:
    return excitation(panda, FRICTION, duration=16.0, rate=200.0)


def told(robot, *runs) -> list[tuple[str, str, str]]:
    return [(f.severity, f.code, f.joint) for f in check_torque(robot, runs)[0]]


def test_a_log_without_fault_passes_without_a_word(panda, run):
    assert told(panda, run) == []


@pytest.mark.parametrize("joint", range(7))
def test_a_wrong_sign_is_found_on_every_joint_wrists_included(panda, run, joint):
    turned = run.with_signals(tau=run["tau"] * np.where(np.arange(7) == joint, -1, 1))
    assert told(panda, turned) == [("hard", "torque_sign", JOINTS[joint])]
    findings, _ = check_torque(panda, [turned])
    assert findings[0].suggestion == {"sign": {"tau": [-1 if j == joint else 1 for j in range(7)]}}


def test_all_signs_wrong_is_no_arm_that_hangs_upside_down(panda, run):
    assert told(panda, run.with_signals(tau=-run["tau"])) == [("hard", "torque_sign", "")]


@pytest.mark.parametrize("gravity", [(0, 0, 9.81), (9.81, 0, 0), (0, -6.9367, -6.9367)], ids=["ceiling", "wall", "45"])
def test_an_arm_mounted_otherwise_passes_and_its_gravity_is_found(panda, gravity):
    mounted = panda.copy()
    mounted.model.gravity.linear = np.array(gravity, float)
    log = excitation(mounted, FRICTION, duration=16.0, rate=200.0)
    findings, found = check_torque(panda, [log])
    assert [(f.severity, f.code) for f in findings] == [("note", "mounting")]
    assert findings[0].text.startswith("the base does not stand as the URDF says")
    np.testing.assert_allclose(found, gravity, atol=0.3)


def test_a_base_that_leans_a_little_may_as_well_carry_links_that_weigh_otherwise(panda):
    leaning = panda.copy()
    leaning.model.gravity.linear = 9.81 * np.array([np.sin(0.4), 0.0, -np.cos(0.4)])
    findings, _ = check_torque(leaning, [excitation(leaning, FRICTION, duration=16.0, rate=200.0)])
    assert findings == []
    findings, _ = check_torque(panda, [excitation(leaning, FRICTION, duration=16.0, rate=200.0)])
    assert [(f.severity, f.code) for f in findings] == [("note", "mounting")]
    assert findings[0].text.startswith("the base may not stand as the URDF says: gravity fits best at 23 deg")
    assert "links that weigh other than the URDF" in findings[0].text


@pytest.mark.parametrize("pair", [(0, 1), (1, 3), (3, 4)])
@pytest.mark.parametrize("signals", [("tau",), ("q",), ("q", "tau")], ids="-".join)
def test_exchanged_columns_are_told_with_the_joints(panda, run, pair, signals):
    order = np.arange(7)
    order[list(pair)] = pair[::-1]
    swapped = run.with_signals(**{s: run[s][:, order] for s in signals})
    findings, _ = check_torque(panda, [swapped])
    assert [(f.severity, f.code) for f in findings] == [("hard", "joint_order")]
    assert findings[0].joint == JOINTS[pair[0]]
    columns = findings[0].suggestion["columns"]
    assert set(signals) <= set(columns)
    assert columns[signals[0]] == [f"{signals[0]}{k + 1}" for k in order]


#: Two links side by side, of which each could be taken for the other with another mass.
LINKS = (("l1", 5, 0.1, 0.05), ("l2", 4, 0.2, 0.06), ("l3", 2, 0.15, 0.02), ("l4", 0.8, 0.05, 0.004))
AXES = (
    ("pan", "base", "l1", 0.1, "0 0 1", 80),
    ("lift", "l1", "l2", 0.1, "0 1 0", 80),
    ("elbow", "l2", "l3", 0.4, "0 1 0", 80),
    ("wrist", "l3", "l4", 0.3, "1 0 0", 20),
)


def four() -> Robot:
    bodies = "".join(
        f'<link name="{name}"><inertial><origin xyz="0 0 {z}"/><mass value="{mass}"/><inertia ixx="{i}" iyy="{i}" '
        f'izz="{i / 4}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        for name, mass, z, i in LINKS
    )
    joints = "".join(
        f'<joint name="{name}" type="revolute"><origin xyz="0 0 {z}"/><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{axis}"/><limit lower="-2.5" upper="2.5" velocity="4" effort="{effort}"/></joint>'
        for name, parent, child, z, axis, effort in AXES
    )
    return Robot.from_text(f'<robot name="four"><link name="base"/>{bodies}{joints}</robot>', "four")


def slow(effects: list[Effect], pace: float, seed: int) -> Trajectory:
    """An excitation of :func:`four` run ``pace`` times slower, with .3 N m of noise on every joint."""
    log = excitation(four(), [], duration=16.0, rate=200.0)
    time, q = log.time * pace, log["q"]
    dq = np.gradient(q, time, axis=0)
    tau = predict(four(), effects, q, dq, np.gradient(dq, time, axis=0), time)
    noise = 0.3 * np.random.default_rng(seed).normal(size=q.shape)
    return Trajectory("slow", "train", time, {"q": q, "dq": dq, "tau": tau + noise})


@pytest.mark.parametrize("seed", range(3))
def test_all_signs_wrong_is_one_convention_also_where_a_joint_says_nothing(seed):
    """Some controllers publish what the joint does to the drive; an upright first joint in slow motion shows nothing of
    it."""
    run = slow([Effect("coulomb_friction", ("lift",), {"coulomb_torque": 1.0})], 8.0, seed)
    assert told(four(), run) == []
    findings, _ = check_torque(four(), [run.with_signals(tau=-run["tau"])])
    assert [(f.severity, f.code, f.joint) for f in findings] == [("hard", "torque_sign", "")]
    assert findings[0].suggestion == {"sign": {"tau": [-1, -1, -1, -1]}}
    # Control: where one joint that shows its sign has it right, it is those that are turned round.
    turned = run.with_signals(tau=run["tau"] * np.array([1, -1, -1, 1]))
    assert {f.joint for f in check_torque(four(), [turned])[0]} == {"lift", "elbow"}


@pytest.mark.parametrize("right", [0, 4, 6])
def test_one_joint_that_has_its_sign_right_speaks_against_all_being_turned(panda, run, right):
    """However noisy: a cure for all would turn it round, and be asked back in the next look."""
    noise = np.full(7, 0.05)
    noise[right] = 0.5
    rng = np.random.default_rng(right)
    tau = run["tau"] * np.where(np.arange(7) == right, 1, -1) + noise * run["tau"].std(axis=0) * rng.normal(
        size=run["tau"].shape
    )
    findings = [f for f in check_torque(panda, [run.with_signals(tau=tau)])[0] if f.code == "torque_sign"]
    assert {f.joint for f in findings} == {JOINTS[j] for j in range(7) if j != right}


@pytest.mark.parametrize("seed", range(3))
def test_a_joint_that_is_not_that_of_its_links_hides_no_wall(seed):
    """A wrist's friction says nothing of how the base stands, and on the wall no rotor stands for the weight."""
    leaning = four()
    leaning.model.gravity.linear = np.array([9.81, 0.0, 0.0])
    log = excitation(four(), [], duration=16.0, rate=200.0)
    time, q = log.time * 6.0, log["q"]
    dq = np.gradient(q, time, axis=0)
    friction = [Effect("coulomb_friction", ("wrist",), {"coulomb_torque": 1.0})]
    tau = predict(leaning, friction, q, dq, np.gradient(dq, time, axis=0), time)
    rng = np.random.default_rng(seed)
    tau = tau + 0.05 * rng.normal(size=q.shape)
    # Of the wrist, whose links weigh little, most is of neither: it comes and goes.
    tau[:, 3] += 2.0 * np.sin(0.2 * time + seed)
    findings, gravity = check_torque(four(), [Trajectory("wall", "train", time, {"q": q, "dq": dq, "tau": tau})])
    assert [(f.severity, f.code) for f in findings] == [("note", "mounting")]
    np.testing.assert_allclose(gravity, [9.81, 0.0, 0.0], atol=0.5)


@pytest.mark.parametrize("name", ["train_1", "train_2"])
def test_exchanged_joints_that_other_masses_nearly_explain_are_told(name):
    hidden = [
        Effect("viscous_friction", ("pan",), {"viscous_coefficient": 4.0}),
        Effect("coulomb_friction", ("lift",), {"coulomb_torque": 3.0}),
        Effect("armature", ("elbow",), {"armature": 0.2}),
    ]
    log = excitation(four(), hidden, name=name, duration=10.0, rate=250.0)
    assert told(four(), log) == []
    swapped = log.with_signals(**{s: log[s][:, [0, 2, 1, 3]] for s in ("q", "tau")})
    assert told(four(), swapped) == [("hard", "joint_order", "lift")]


def test_a_position_that_counts_backwards_is_no_wrong_sign_of_the_torque(panda, run):
    mirror = np.where(np.arange(7) == 3, -1, 1)
    assert told(panda, run.with_signals(q=run["q"] * mirror)) == [("hard", "position_sign", JOINTS[3])]


@pytest.mark.parametrize(
    ("factor", "cure"),
    [(1000.0, {"units": {"tau": "Nmm"}}), (100.0, {"gain": {"tau": [0.01]}}), (1e-3, {"units": {"tau": "kNm"}})],
)
def test_a_unit_is_named(panda, run, factor, cure):
    findings, _ = check_torque(panda, [run.with_signals(tau=run["tau"] * factor)])
    assert [(f.severity, f.code) for f in findings] == [("hard", "torque_unit")]
    assert findings[0].suggestion == cure


def test_a_torque_on_the_motors_side_is_told_with_its_factors(panda, run):
    findings, _ = check_torque(panda, [run.with_signals(tau=run["tau"] / np.linspace(100, 50, 7))])
    assert [(f.severity, f.code) for f in findings] == [("hard", "torque_unit")]
    assert "gear_ratio); factors by joint: panda_joint" in findings[0].text
    assert findings[0].suggestion == {}


@pytest.mark.parametrize(("late", "severity"), [(0.2, "hard"), (-0.1, "hard"), (0.05, "warning"), (0.02, "note")])
def test_a_delay_is_measured(panda, run, late, severity):
    shift = round(late / run.dt)
    tau = np.roll(run["tau"], shift, axis=0)
    findings, _ = check_torque(panda, [run.with_signals(tau=tau).rows(slice(60, -60))])
    assert [(f.severity, f.code) for f in findings] == [(severity, "torque_delay")]
    assert findings[0].suggestion["torque_delay"] == pytest.approx(late, abs=0.004)


def slowly(panda: Robot, friction: dict[str, float], name: str, late: int = 0) -> Trajectory:
    """A slow run in which friction is a quarter of what the joints can do; torque recorded ``late`` rows of 5 ms."""
    time = np.arange(4000) / 200.0
    omega = 2 * np.pi * np.array([0.11, 0.13, 0.17, 0.19, 0.23, 0.29, 0.31])
    wave = 0.12 * np.sin(omega * time[:, None] + np.arange(7))
    q = np.mean(panda.position_limits, axis=0) + wave
    dq, ddq = np.gradient(wave, time, axis=0), -(omega**2) * wave
    heights = 0.25 * panda.effort_limits
    rough = [Effect(name, (j,), {k: f * v for k, v in friction.items()}) for j, f in zip(JOINTS, heights, strict=True)]
    tau = predict(panda, rough, q, dq, ddq, time)
    return Trajectory("slow", "train", time[late:], {"q": q[late:], "tau": tau[: len(tau) - late]})


@pytest.mark.parametrize("displacement", [0.002, 0.006, 0.012])
def test_friction_that_turns_over_with_the_distance_is_no_late_clock(panda, displacement):
    presliding = {"coulomb_torque": 1.0, "presliding_stiffness": 1 / displacement}
    assert told(panda, slowly(panda, presliding, "hysteresis_friction")) == []
    assert ("hard", "torque_delay", "") in told(panda, slowly(panda, presliding, "hysteresis_friction", late=30))


def test_sharp_friction_hides_no_clock_and_is_none(panda):
    assert told(panda, slowly(panda, {"coulomb_torque": 1.0}, "coulomb_friction")) == []
    findings, _ = check_torque(panda, [slowly(panda, {"coulomb_torque": 1.0}, "coulomb_friction", late=20)])
    assert [(f.severity, f.code) for f in findings] == [("hard", "torque_delay")]
    assert findings[0].suggestion["torque_delay"] == pytest.approx(0.1, abs=0.02)


def test_a_joint_that_slides_turns_over_within_shorter_ways():
    dt, late = 0.02, 5
    time = dt * np.arange(1505)
    q = 0.3 * np.sin(2 * np.pi * np.array([0.15, 0.195]) * time[:, None] + np.arange(2))
    dq = np.gradient(q, dt, axis=0)
    ddq = np.gradient(dq, dt, axis=0)
    tau = (10 * ddq + 3 * np.sign(dq))[:-late]
    q, dq, ddq = q[late:], dq[late:], ddq[late:]
    columns = Columns(10 * ddq, np.zeros((*q.shape, 3)), np.zeros_like(q), dq, ddq, direction(dq), tau)
    parts = [Stretch("run", dt, 10.0, q, dq, ddq, tau)]

    def torque(j: int) -> tuple[np.ndarray, np.ndarray]:
        return columns.motion[:, j], tau[:, j]

    turning, sliding = (find_delay(columns, parts, torque, slides) for slides in ((), (0, 1)))
    assert turning.seconds == sliding.seconds == pytest.approx(late * dt, abs=dt / 4)
    # Thirty millimetres of presliding would hide a good part of a clock of a tenth of a second; 1.5 do not.
    assert sliding.gain > 1.2 * turning.gain


@pytest.mark.parametrize("factor", [10.0, 0.1, 100.0])
def test_a_clock_that_is_wrong_by_powers_of_ten_is_found(panda, factor):
    slow = excitation(panda, FRICTION, duration=40.0, rate=200.0)
    clock = Trajectory("run", "train", slow.time * factor, slow.signals)
    findings, _ = check_torque(panda, [clock])
    assert [(f.severity, f.code) for f in findings] == [("hard", "time_scale")]


def test_a_wrong_clock_is_found_beside_friction_that_explains_a_joint_by_any_clock(panda):
    strong = [Effect("coulomb_friction", (j,), {"coulomb_torque": 15.0}) for j in JOINTS]
    slow = excitation(panda, strong, duration=40.0, rate=200.0)
    tau = slow["tau"] * np.where(np.arange(7) == 6, 8.0, 1.0)
    clock = Trajectory("run", "train", slow.time * 0.1, {"q": slow["q"], "tau": tau})
    assert "time_scale" in [f[1] for f in told(panda, clock)]


@pytest.mark.parametrize("joint", [3, 5])
def test_one_joint_with_more_weight_and_no_more_inertia_is_no_clock(panda, joint):
    """One clock drives all joints: those that are explained as they stand speak against it."""
    log = excitation(panda, FRICTION, duration=16.0, rate=200.0)
    still = np.zeros_like(log["q"])
    weight = panda.inverse_dynamics(log["q"], still, still)
    tau = log["tau"].copy()
    tau[:, joint] += 4.0 * weight[:, joint]
    assert not [f for f in told(panda, log.with_signals(tau=tau)) if f[1] == "time_scale"]


@pytest.mark.parametrize("com", [(0.0, 0.0, -0.3), (-0.2, 0.1, 0.0), (0.0, -0.2, 0.1)])
@pytest.mark.parametrize("friction", [[], FRICTION], ids=["smooth", "friction"])
def test_an_undeclared_payload_is_no_fault_wherever_it_hangs(panda, com, friction):
    body = {"mass": 4.0, "com_x": com[0], "com_y": com[1], "com_z": com[2]}
    inertia = {f"inertia_{a}{b}": 0.01 * (a == b) for a, b in ("xx", "xy", "yy", "xz", "yz", "zz")}
    log = excitation(panda, [*friction, Effect("payload", (), body | inertia)], duration=16.0, rate=200.0)
    assert [f for f in told(panda, log) if f[0] != "note"] == []


def test_friction_that_outweighs_everything_else_is_no_fault(panda):
    heavy = [Effect("coulomb_friction", (j,), {"coulomb_torque": 40.0}) for j in JOINTS]
    assert told(panda, excitation(panda, heavy, duration=16.0, rate=200.0)) == []


def test_a_spring_on_a_light_wrist_is_no_wrong_sign():
    ur10 = Robot.from_urdf(find_description("ur_description/urdf/ur10_joint_limited_robot.urdf"))
    spring = Effect("joint_spring", ("wrist_3_joint",), {"stiffness": 1.9, "rest_position": -0.2}, {"shape": "linear"})
    log = excitation(ur10, [spring], duration=16.0, rate=200.0, seed=1)
    assert [f for f in told(ur10, log) if f[0] == "hard"] == []
    # The same wrist with friction alone, its sign turned, is refused.
    rough = Effect("coulomb_friction", ("wrist_3_joint",), {"coulomb_torque": 1.0})
    plain = excitation(ur10, [rough], duration=16.0, rate=200.0)
    turned = plain.with_signals(tau=plain["tau"] * np.where(np.arange(6) == 5, -1, 1))
    assert ("hard", "torque_sign", "wrist_3_joint") in told(ur10, turned)


def test_a_tool_on_the_other_side_of_a_light_wrist_is_no_wrong_sign():
    xarm = Robot.from_urdf(find_description("xarm_description/urdf/xarm7.urdf"))
    body = {"mass": 1.2, "com_x": 0.0, "com_y": 0.02, "com_z": 0.12}
    inertia = {f"inertia_{a}{b}": 0.002 * (a == b) for a, b in ("xx", "xy", "yy", "xz", "yz", "zz")}
    tool = Effect("payload", (), body | inertia)
    log = excitation(xarm, [tool], duration=16.0, rate=200.0, seed=2)
    assert [f for f in told(xarm, log) if f[0] == "hard"] == []
    # Control: the same tool where friction at the wrist shows the sign, turned.
    rough = excitation(
        xarm,
        [tool, Effect("coulomb_friction", ("joint7",), {"coulomb_torque": 1.0})],
        duration=16.0,
        rate=200.0,
        seed=2,
    )
    turned = rough.with_signals(tau=rough["tau"] * np.where(np.arange(7) == 6, -1, 1))
    assert ("hard", "torque_sign", "joint7") in told(xarm, turned)


def test_two_late_joints_are_no_late_clock(panda, run):
    late = 60  # rows of 5 ms
    rng = np.random.default_rng(0)
    tau = run["tau"][late:].copy()
    tau[:, 4:6] = run["tau"][:-late, 4:6]
    clock = run.rows(slice(late, None)).with_signals(tau=run["tau"][:-late])
    assert ("hard", "torque_delay", "") in told(panda, clock)
    # Nothing can be said of the other joints: their torque has nothing to do with the motion.
    rest = [0, 1, 2, 3, 6]
    slow = np.cumsum(rng.normal(size=(len(tau), len(rest))), axis=0)
    tau[:, rest] = 20.0 * slow / slow.std(axis=0)
    findings, _ = check_torque(panda, [run.rows(slice(late, None)).with_signals(tau=tau)])
    delays = [f for f in findings if f.code == "torque_delay"]
    assert [f.severity for f in delays] == ["warning"]
    assert not delays[0].suggestion


def test_a_late_clock_is_late_in_both_halves_of_the_log(panda, run):
    late = 40  # rows of 5 ms
    clock = run.rows(slice(late, None)).with_signals(tau=run["tau"][:-late])
    assert ("hard", "torque_delay", "") in told(panda, clock)
    # Late in one half and early in the other: whichever wins over the whole log, no single shift mends it.
    half = run.rows(slice(late, -late))
    turn = len(half.time) // 2
    mixed = np.concatenate([run["tau"][: -2 * late][:turn], run["tau"][2 * late :][turn:]])
    findings, _ = check_torque(panda, [half.with_signals(tau=mixed)])
    delays = [f for f in findings if f.code == "torque_delay"]
    assert delays
    assert all(f.severity == "warning" and not f.suggestion for f in delays)


def test_a_joint_that_moves_one_way_shows_no_sign_of_its_friction(panda, run):
    # A cable whose pull falls off while the wrist turns one way: turned round, it looks like friction.
    way = np.zeros(7)
    way[6] = 1.0
    ramp = 0.4 * run.time[:, None] / run.time[-1] * way
    slow = run.with_signals(q=run["q"] * (1 - way) + ramp * 8.0)
    pull = slow.with_signals(tau=slow["tau"] * (1 - way) - 0.3 * way * (1.0 + ramp[:, [6]]))
    assert ("hard", "torque_sign", JOINTS[6]) not in told(panda, pull)
    # Control: a wrist that moves both ways, its torque turned round.
    assert ("hard", "torque_sign", JOINTS[6]) in told(panda, run.with_signals(tau=run["tau"] * (1 - 2 * way)))


@pytest.mark.parametrize(("returns", "severity"), [(False, "warning"), (True, "hard")])
def test_a_wrist_that_moves_one_way_shows_no_sign_of_its_position(panda, run, returns, severity):
    # Friction that falls with the speed, or a cable: along one way it is a position that counts backwards.
    time, wrist = run.time[:, None], np.arange(7) == 6
    own = 0.4 * np.sin(1.3 * time) if returns else 0.1 * time + 0.04 * np.sin(1.3 * time)
    q = np.where(wrist, own, run["q"])
    dq = np.gradient(q, run.time, axis=0)
    tau = predict(panda, FRICTION, q, dq, np.gradient(dq, run.time, axis=0), run.time)
    tau = np.where(wrist, -2.0 * dq - 0.5 * np.sign(dq), tau)
    parts = stretches([Trajectory("r", "train", run.time, {"q": q, "tau": tau})])
    columns = columns_of(panda, parts)
    told = Guess(standing(panda), (1,) * 7, tuple(range(7)), None, None, 1.0, (-4.0,) * 6 + (0.0,), 0.0)
    best = replace(told, mirror=6, scores=(-4.0,) * 7, price=1.4)
    shows = _shown_by(panda, parts, columns, Forms(columns), best)
    (found,) = _signs(panda, told, best, columns, Forms(columns), np.concatenate([p.q for p in parts]), shows)
    assert (found.severity, found.code, found.joint) == (severity, "position_sign", JOINTS[6])
    assert bool(found.suggestion) == returns


@pytest.mark.parametrize(("returns", "severity"), [(False, "warning"), (True, "hard")])
def test_joints_that_move_one_way_are_not_refused_as_exchanged(panda, returns, severity):
    # From pose to pose; the first and the last joint's torques look like each other's friction (as a KUKA's cables).
    time = np.arange(0.0, 12.0, 0.005)
    waves = np.array([1.0, 0.4, 0.3, -0.5, 0.4, 0.3, 0.0]), np.array([0.0] * 6 + [-1.2])
    phases = 1.3 * time[:, None], 2.1 * time[:, None] + 1.0
    q = np.array([0.0, -0.5, 0.0, -1.8, 0.0, 1.5, 0.0])
    for size, phase in zip(waves, phases, strict=True):
        q = q + size * (0.4 * np.sin(phase) if returns else 0.1 * time[:, None] + 0.04 * np.sin(phase))
    dq = np.gradient(q, time, axis=0)
    tau = predict(panda, FRICTION, q, dq, np.gradient(dq, time, axis=0), time)
    for here, there in ((0, 6), (6, 0)):
        tau[:, here] = 0.5 * np.sign(dq[:, there]) + 3.0 * dq[:, there]
    tau += np.random.default_rng(0).normal(0.0, 0.02, tau.shape)
    found = [f for f in told(panda, Trajectory("r", "train", time, {"q": q, "tau": tau})) if f[1] == "joint_order"]
    assert found == [(severity, "joint_order", JOINTS[0])]


def test_a_wrist_that_turns_with_its_neighbour_is_not_refused_as_exchanged():
    ur10 = Robot.from_urdf(find_description("ur_description/urdf/ur10_joint_limited_robot.urdf"))
    second, third = ur10.joint_names[4:]
    settings = {"from_joint": third, "rows": "own", "sign_of": "partner"}
    law = {"viscous_coefficient": 0.8, "coulomb_torque": 1.0, "armature": 0.0}
    coupled = excitation(ur10, [Effect("joint_coupling", (second,), law, settings)], duration=16.0, rate=200.0)
    findings, _ = check_torque(ur10, [coupled])
    assert [(f.severity, f.code, f.joint, f.suggestion) for f in findings] == [("warning", "joint_order", second, {})]
    assert "joint_coupling" in findings[0].text
    # Control: positions that are exchanged are, where both torques say so.
    own = [Effect("viscous_friction", (name,), {"viscous_coefficient": 0.8}) for name in (second, third)]
    run = excitation(ur10, own, duration=16.0, rate=200.0)
    exchanged = run.with_signals(q=run["q"][:, [0, 1, 2, 3, 5, 4]])
    findings, _ = check_torque(ur10, [exchanged])
    assert [(f.severity, f.code, f.joint) for f in findings] == [("hard", "joint_order", second)]


@pytest.mark.parametrize("moved", [False, True])
def test_a_joint_that_a_coupling_explains_is_not_refused_whose_neighbour_is_right_as_it_stands(moved):
    ur10 = Robot.from_urdf(find_description("ur_description/urdf/ur10_joint_limited_robot.urdf"))
    second, third = ur10.joint_names[4:]
    law = {"viscous_coefficient": 2.0, "coulomb_torque": 3.0, "armature": 0.0}
    own = Effect("viscous_friction", (third,), {"viscous_coefficient": 0.8})
    coupling = Effect("joint_coupling", (second,), law, {"from_joint": third, "rows": "own", "sign_of": "partner"})
    coupled = excitation(ur10, [coupling, own], duration=8.0, rate=200.0)
    # As short runs say it by chance: the neighbour's motion explains the second joint better, the third is explained.
    order = (0, 1, 2, 3, 5, 4)
    told = Guess(standing(ur10), (1,) * 6, tuple(range(6)), None, None, 1.0, (-4.0,) * 4 + (-0.1, -3.0), 0.0)
    best = replace(told, scores=(-4.0,) * 4 + (-3.0, -3.0), price=1.4)
    best = replace(best, source=order) if moved else replace(best, swap=(4, 5))

    def said(run: Trajectory, told: Guess = told, best: Guess = best) -> list[tuple[str, str]]:
        found = places(ur10.joint_names, told, best, columns_of(ur10, stretches([run])))
        return [(f.severity, f.joint) for f in found]

    assert said(coupled) == [("warning", second)]
    # Controls: neither is explained as it stands; and friction of its own is no coupling.
    assert said(coupled, replace(told, scores=(-4.0,) * 4 + (-0.1, -0.1))) == [("hard", second)]
    exchanged = excitation(ur10, [own], duration=8.0, rate=200.0)
    names = ("q", "dq") if not moved else ("tau",)
    exchanged = exchanged.with_signals(**{n: exchanged[n][:, list(order)] for n in names if n in exchanged})
    assert said(exchanged) == [("hard", second)]
    # What explains half of it is no exchange for sure, either.
    half = replace(best, scores=(-4.0,) * 4 + (-0.8, -3.0))
    assert said(exchanged, replace(told, scores=(-4.0,) * 4 + (-0.1, -0.1)), half) == [("warning", second)]


@pytest.mark.parametrize(("left", "severity"), [(0.42, "warning"), (0.05, "hard")])
def test_a_turned_position_that_leaves_much_itself_is_no_refusal(left, severity):
    ur10 = Robot.from_urdf(find_description("ur_description/urdf/ur10_joint_limited_robot.urdf"))
    run = excitation(ur10, [], duration=8.0, rate=200.0)
    turned_run = run.with_signals(q=run["q"] * [1, 1, 1, -1, 1, 1])
    parts = stretches([turned_run])
    columns = columns_of(ur10, parts)
    told = Guess(standing(ur10), (1,) * 6, tuple(range(6)), None, None, 1.0, (-4.0,) * 3 + (-0.03, -4.0, -4.0), 0.0)
    best = replace(told, mirror=3, scores=(-4.0,) * 3 + (float(np.log(left)), -4.0, -4.0), price=0.3)
    found = _signs(ur10, told, best, columns, Forms(columns), np.concatenate([p.q for p in parts]))
    assert [(f.severity, f.code, f.joint) for f in found] == [(severity, "position_sign", ur10.joint_names[3])]


def test_what_no_run_explains_accuses_no_single_run():
    ur10 = Robot.from_urdf(find_description("ur_description/urdf/ur10_joint_limited_robot.urdf"))
    spring = Effect("joint_spring", ("wrist_2_joint",), {"stiffness": 3.0, "rest_position": 0.0}, {"shape": "linear"})
    logs = []
    for k, speed in enumerate((2.0, 3.0, 4.5)):
        run = excitation(ur10, [], name=f"run_{k}", seed=k, duration=16.0, rate=200.0)
        # At one frequency a spring is a rotor turned round; at three it is not.
        q = run["q"].copy()
        q[:, 4] = np.sin(speed * run.time)
        dq = np.gradient(q, run.dt, axis=0)
        tau = predict(ur10, [spring], q, dq, np.gradient(dq, run.dt, axis=0), run.time)
        logs.append(run.with_signals(q=q, tau=tau))
    gravity = standing(ur10)
    assert ("warning", "torque_sign", "wrist_2_joint") in told(ur10, logs[0])
    assert outvoted(ur10, of_each(ur10, logs), gravity) == []
    # Another joint that is wrong in one run brings that run into doubt, and that joint alone.
    turned = logs[0].with_signals(tau=logs[0]["tau"] * np.where(np.arange(6) == 1, -1, 1))
    assert [(run.name, joints) for run, joints in outvoted(ur10, of_each(ur10, [turned, *logs[1:]]), gravity)] == [
        ("run_0", ["shoulder_lift_joint"])
    ]
    with pytest.raises(InputError, match="run run_0: joint shoulder_lift_joint: the measured torque") as told_so:
        checked(ur10, [turned, *logs[1:]], [])
    assert "wrist_2_joint" not in str(told_so.value)
    # Control: where the other runs do explain the joint, the one that does not is accused of it.
    rough = [Effect("coulomb_friction", ("wrist_2_joint",), {"coulomb_torque": 3.0})]
    assert ("run_0", ["wrist_2_joint"]) in [
        (run.name, joints)
        for run, joints in outvoted(
            ur10,
            of_each(ur10, [logs[0], *(excitation(ur10, rough, name=n, duration=16.0, rate=200.0) for n in "ab")]),
            gravity,
        )
    ]
