"""A torque to which the controller adds gravity itself is told as that; what only looks like it is not."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.panda_arm import load_panda
from tests.small_arm import URDF, arm

from hybrid_dynamics.check import check_before_fit
from hybrid_dynamics.check.columns import Columns, columns_of, standing
from hybrid_dynamics.check.completed import true_stretches
from hybrid_dynamics.check.suggestion import combined
from hybrid_dynamics.check.torque import check_torque
from hybrid_dynamics.check.weight import check_weight, weigh
from hybrid_dynamics.cli import main
from hybrid_dynamics.effects import Effect, predict, with_effects
from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.loop import close_loop
from hybrid_dynamics.readers import read_log, write_log
from hybrid_dynamics.readers.description import describe
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation.excitation import excitation, excitations
from hybrid_dynamics.trajectory import Trajectory

COMPENSATED = describe({"gravity": "compensated"})


@pytest.fixture(scope="module")
def panda() -> Robot:
    return load_panda()


def friction(robot: Robot) -> list[Effect]:
    named = list(zip(robot.joint_names, 0.02 * robot.effort_limits, strict=True))
    return [
        *(Effect("coulomb_friction", (j,), {"coulomb_torque": float(f)}) for j, f in named),
        *(Effect("viscous_friction", (j,), {"viscous_coefficient": float(f)}) for j, f in named),
    ]


@pytest.fixture(scope="module")
def run(panda: Robot) -> Trajectory:
    return excitation(panda, friction(panda), duration=16.0, rate=100.0)


def weight_of(robot: Robot, log: Trajectory) -> np.ndarray:
    still = np.zeros_like(log["q"])
    return robot.inverse_dynamics(log["q"], still, still)


def without(robot: Robot, log: Trajectory, times: float = 1.0) -> Trajectory:
    """``log`` as a controller commands it that adds gravity of ``robot`` so many ``times``."""
    return log.with_signals(tau=log["tau"] - times * weight_of(robot, log))


def columns_and_gravity(robot: Robot, logs: Sequence[Trajectory]) -> tuple[Columns, np.ndarray]:
    return columns_of(robot, true_stretches(robot, logs)), standing(robot)


def weighed(robot: Robot, *logs: Trajectory) -> list[str]:
    return [f.severity for f in check_weight(*columns_and_gravity(robot, logs))]


def told_by_check(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    with pytest.raises(SystemExit) as end:
        main(["check", *arguments])
    return int(end.value.code or 0), capsys.readouterr().out


def test_a_torque_without_gravity_is_told_with_what_mends_it(panda, run):
    findings, _ = check_torque(panda, [without(panda, run)])
    assert [(f.severity, f.code, f.suggestion) for f in findings] == [
        ("hard", "torque_weight", {"gravity": "compensated"})
    ]
    assert "controller adds gravity itself" in findings[0].text
    assert check_torque(panda, [run])[0] == []


def test_it_is_refused_and_not_answered_with_links_without_mass(panda, run):
    with pytest.raises(InputError, match=r"holds no weight of the links .* say gravity: compensated"):
        close_loop(panda, [without(panda, run)], [])


def test_one_log_of_several_is_told_by_its_name(panda, run):
    other = excitation(panda, friction(panda), name="whole", duration=16.0, rate=100.0)
    found = [f for f in check_before_fit(panda, [other]) if f.code == "torque_weight"]
    assert found == []
    with pytest.raises(InputError, match="run run: the torque holds no weight of the links"):
        check_before_fit(panda, [other, without(panda, run)])


def test_wrists_whose_current_is_hardly_ever_more_than_nothing_hide_no_missing_weight(panda, run):
    # They have next to no noise, and so told everything of the inertia: that there is none.
    rng = np.random.default_rng(0)

    def silent(log: Trajectory) -> Trajectory:
        tau = log["tau"] + rng.normal(0.0, 0.1, log["tau"].shape)
        tau[:, 4:] = 0.002 * (rng.random((len(tau), 3)) < 0.1)
        return log.with_signals(tau=tau)

    assert weighed(panda, silent(without(panda, run))) == ["hard"]
    assert weighed(panda, silent(run)) == []


@pytest.mark.parametrize("seconds", [8.0, 16.0])
@pytest.mark.parametrize("name", ["ur5_robot.urdf", "xarm7.urdf", "ur3_robot.urdf"])
def test_arms_of_other_makers_with_links_that_weigh_otherwise(name, seconds):
    robot = Robot.from_urdf(find_description(name))
    rng = np.random.default_rng(7)
    heavier = robot.copy()
    for body in heavier.model.inertias.tolist()[1:]:
        body.mass *= np.exp(0.2 * rng.normal())
    log = excitation(heavier, friction(robot), duration=seconds, rate=100.0)
    assert weighed(robot, log) == []
    assert weighed(robot, without(heavier, log)) == ["hard"]


@pytest.mark.parametrize("times", [2.0, 3.0])
def test_links_whose_inertia_the_urdf_has_too_little_of_keep_their_weight(times):
    robot = Robot.from_urdf(find_description("ur5_robot.urdf"))
    slower = robot.copy()
    for k in range(1, slower.model.njoints):
        slower.model.inertias[k].inertia = slower.model.inertias[k].inertia * times
    log = excitation(slower, friction(robot), duration=30.0, rate=100.0)
    found = weigh(*columns_and_gravity(robot, [log]))
    assert found is not None
    assert found.motion > 1.3
    assert weighed(robot, log) == []
    assert weighed(robot, without(robot, log)) == ["hard"]


@pytest.mark.parametrize("seed", [5, 58])
def test_an_arm_on_a_wall_holds_its_weight_where_it_lifts(seed):
    """About one pose an arm that hangs on a wall lifts little on the joints that would lift if it stood; the others
    say that nothing is missing. (Found on ten seconds of a Rokae AR5.)"""
    robot = Robot.from_urdf(find_description("ur5_robot.urdf"))
    rng, time = np.random.default_rng(seed), np.arange(800) / 100.0
    low, high = (np.clip(limit, -2.5, 2.5) for limit in robot.position_limits)
    middle, size = rng.uniform(0.8 * low, 0.8 * high), rng.uniform(0.05, 0.2, (3, 6))
    rate, phase = np.array([1.0, 2.3, 4.1])[:, None, None], rng.uniform(0, 2 * np.pi, (3, 6))
    angle = rate * time[:, None] + phase[:, None]
    q = middle + np.sum(size[:, None] * np.sin(angle), axis=0)
    dq, ddq = (np.sum(size[:, None] * part, axis=0) for part in (rate * np.cos(angle), -(rate**2) * np.sin(angle)))
    wall = Effect("gravity_tilt", (), {"roll": 0.0, "pitch": np.pi / 2})
    tau = predict(robot, [*friction(robot), wall], q, dq, ddq, time)
    tau += 0.003 * robot.effort_limits * rng.normal(size=q.shape)
    log = Trajectory("run", "train", time, {"q": q, "tau": tau})
    assert [f.severity for f in check_weight(*columns_and_gravity(robot, [log]), tilted=True)] == ["warning"]
    assert [f.code for f in check_torque(robot, [log])[0]] == ["mounting"]
    # The control: without what it weighs there.
    hung, _ = with_effects(robot, [wall])
    held = log.with_signals(tau=tau - hung.inverse_dynamics(q, np.zeros_like(q), np.zeros_like(q)))
    assert "torque_weight" in [f.code for f in check_torque(robot, [held])[0]]


@pytest.mark.parametrize("still", [0, 1])
def test_a_joint_that_moves_alone_has_its_weight(still):
    log = excitation(arm(), friction(arm()), duration=15.0, rate=100.0, still=[still])
    assert weighed(arm(), log) == []


def test_the_one_joint_that_lifts_may_be_balanced_by_a_spring():
    """Of a pan and tilt one joint has a say: told, and not refused; so where the base may stand otherwise."""
    text = URDF.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 0 1"/>', 1)
    tilt = Robot.from_text(text, "tilt.urdf")
    log = without(tilt, excitation(tilt, friction(tilt), duration=16.0, rate=100.0))
    found = weigh(*columns_and_gravity(tilt, [log]))
    assert found is not None
    assert len(found.weight) == 1
    assert weighed(tilt, log) == ["warning"]
    (finding,) = check_weight(*columns_and_gravity(arm(), [without(arm(), excitation(arm()))]), tilted=True)
    assert (finding.severity, finding.suggestion) == ("warning", {})
    assert finding.text.endswith("a base that stands so that no joint lifts anything looks the same")


@pytest.mark.parametrize("gravity", [(0, 0, 9.81), (9.81, 0, 0), (0, -6.9367, -6.9367)], ids=["ceiling", "wall", "45"])
def test_an_arm_mounted_otherwise_has_its_weight(panda, gravity):
    mounted = panda.copy()
    mounted.model.gravity.linear = np.array(gravity, float)
    assert weighed(panda, excitation(mounted, friction(panda), duration=16.0, rate=100.0)) == []


def test_a_joint_whose_weight_a_spring_balances_is_no_compensation(panda, run):
    balanced = run["tau"].copy()
    balanced[:, 1] -= weight_of(panda, run)[:, 1]
    assert weighed(panda, run.with_signals(tau=balanced)) == []


def test_a_payload_is_seen_in_what_the_controller_leaves(panda):
    held = Effect(
        "payload",
        (),
        {"mass": 2.0, "com_x": 0.0, "com_y": 0.0, "com_z": 0.1}
        | dict.fromkeys(("inertia_xx", "inertia_xy", "inertia_yy", "inertia_xz", "inertia_yz", "inertia_zz"), 0.0)
        | {"inertia_xx": 0.01, "inertia_yy": 0.01, "inertia_zz": 0.01},
    )
    # The controller knows nothing of the payload: its weight is commanded.
    log = excitation(panda, [*friction(panda), held], duration=16.0, rate=100.0)
    assert weighed(panda, log) == []
    assert weighed(panda, without(panda, log)) == ["hard"]


def test_another_unit_is_not_told_as_a_missing_weight(panda, run):
    findings, _ = check_torque(panda, [run.with_signals(tau=1e3 * run["tau"])])
    assert [f.code for f in findings] == ["torque_unit"]


def test_what_a_model_has_left_is_no_torque_in_another_unit(panda, run):
    log = excitation(panda, friction(panda), duration=16.0, rate=100.0)
    bare = excitation(panda, (), duration=16.0, rate=100.0, torque_noise_share=0.0)
    external = log.with_signals(tau=log["tau"] - 0.98 * bare["tau"])
    findings, _ = check_torque(panda, [external])
    assert [(f.severity, f.code, f.suggestion) for f in findings] == [("hard", "torque_links", {})]
    assert "an external torque" in findings[0].text
    findings, _ = check_torque(panda, [run.with_signals(tau=0.02 * run["tau"])])
    assert [f.code for f in findings] == ["torque_unit"]


def test_an_arm_that_lies_flat_has_no_weight_to_miss():
    flat = Robot.from_text(URDF.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 0 1"/>'), "flat.urdf")
    log = excitation(flat, (), duration=16.0, rate=200.0)
    assert np.ptp(weight_of(flat, log)) < 1e-9
    assert weigh(*columns_and_gravity(flat, [log])) is None
    assert weighed(arm(), excitation(arm(), (), duration=16.0, rate=200.0)) == []


def test_weight_that_was_added_to_a_torque_that_held_it_is_told(panda, run):
    assert weighed(panda, without(panda, run, -1.0)) == ["warning"]
    heavy = panda.copy()
    for body in heavy.model.inertias.tolist()[1:]:
        body.mass *= 2.0
        body.inertia = body.inertia * 2.0
    # Links twice as heavy move twice as much, too.
    assert weighed(panda, excitation(heavy, friction(panda), duration=16.0, rate=100.0)) == []


def test_too_few_rows_say_nothing(panda, run):
    few = true_stretches(panda, [run])
    short = [replace(few[0], **{s: getattr(few[0], s)[:100] for s in ("q", "dq", "ddq", "tau")})]
    assert weigh(columns_of(panda, short), standing(panda)) is None


@settings(max_examples=20, deadline=None)
@given(factor=st.floats(0.4, 2.5), share=st.floats(0.0, 1.0))
def test_what_is_weighed_is_what_is_in_the_torque(factor, share):
    robot = arm()
    log = excitation(robot, (), duration=8.0, rate=100.0, torque_noise_share=0.0, encoder_bits=0)
    columns, gravity = columns_and_gravity(robot, [log])
    weight = columns.gravity @ gravity
    found = weigh(replace(columns, tau=factor * (columns.tau - share * weight)), gravity)
    assert found is not None
    # The torque was smoothed like the motion, which leaves per cents of what changes fast.
    assert found.motion == pytest.approx(factor, rel=0.05)
    np.testing.assert_allclose(found.weight, factor * (1 - share), atol=0.05 * factor)


def test_what_was_compensated_is_added_as_the_urdf_has_it(tmp_path):
    robot = arm()
    [log], _ = excitations(robot, (), train=1, test=0, duration=4.0, rate=100.0)
    write_log(tmp_path / "whole.parquet", log, robot.joint_names)
    write_log(tmp_path / "rest.parquet", without(robot, log), robot.joint_names)
    whole = read_log(tmp_path / "whole.parquet", robot)
    added = read_log(tmp_path / "rest.parquet", robot, log=COMPENSATED)
    np.testing.assert_allclose(added["tau"], whole["tau"], atol=1e-12)
    assert np.abs(read_log(tmp_path / "rest.parquet", robot)["tau"] - whole["tau"]).max() > 1.0
    with pytest.raises(ConfigError, match=r"log.gravity is compensated; expected the robot"):
        read_log(tmp_path / "rest.parquet", robot.joint_names, log=COMPENSATED)


def test_what_was_added_hides_no_fault_of_what_was_logged(tmp_path, capsys):
    """A torque that never changes has no weight, plateaus are those of the log, a slip of a position weighs nothing."""
    robot = arm()
    [log], _ = excitations(robot, (), train=1, test=0, duration=8.0, rate=200.0)
    rest = without(robot, log)
    dead = rest["tau"].copy()
    dead[:, 1] = 0.3
    top = 0.4 * np.abs(rest["tau"]).max(axis=0)
    slipped = rest["q"].copy()
    slipped[700, 0] += 2.0
    faults = {
        "dead": rest.with_signals(tau=dead),
        "clipped": rest.with_signals(tau=np.clip(rest["tau"], -top, top)),
        "slipped": rest.with_signals(q=slipped),
    }
    for name, run in faults.items():
        write_log(tmp_path / f"{name}.parquet", run, robot.joint_names)
    read = read_log(tmp_path / "dead.parquet", robot, log=COMPENSATED)
    assert np.ptp(read["tau"], axis=0)[1] == 0.0
    assert np.ptp(read["tau"], axis=0)[0] > 1.0
    np.testing.assert_allclose(
        read_log(tmp_path / "slipped.parquet", robot, log=COMPENSATED)["tau"], log["tau"], atol=0.1
    )
    (tmp_path / "log.yaml").write_text("gravity: compensated\n")
    (tmp_path / "robot.urdf").write_text(URDF)
    asked = ["--robot", str(tmp_path / "robot.urdf"), "--log", str(tmp_path / "log.yaml"), "--data"]
    _, said = told_by_check(capsys, *asked, str(tmp_path / "clipped.parquet"))
    assert "saturation" in said


def test_units_and_signs_come_before_the_weight(tmp_path):
    robot = arm()
    [log], _ = excitations(robot, (), train=1, test=0, duration=4.0, rate=100.0)
    rest = without(robot, log)
    write_log(tmp_path / "rest.parquet", rest.with_signals(tau=-1e3 * rest["tau"]), robot.joint_names)
    description = describe({"gravity": "compensated", "units": {"tau": "Nmm"}, "sign": {"tau": -1}})
    read = read_log(tmp_path / "rest.parquet", robot, log=description)
    np.testing.assert_allclose(read["tau"], log["tau"], atol=1e-9)


def test_check_mends_it_and_close_loop_answers(tmp_path, capsys):
    robot = arm()
    hidden = [Effect("viscous_friction", ("elbow",), {"viscous_coefficient": 1.0})]
    train, _ = excitations(robot, hidden, train=2, test=0, duration=8.0, rate=200.0)
    (tmp_path / "robot.urdf").write_text(URDF)
    for log in train:
        write_log(tmp_path / f"{log.name}.parquet", without(robot, log), robot.joint_names)
    paths = [str(tmp_path / f"{log.name}.parquet") for log in train]
    asked = ["--robot", str(tmp_path / "robot.urdf"), "--data", *paths]
    cure = tmp_path / "log.yaml"
    code, said = told_by_check(capsys, *asked)
    assert code == 2
    assert "holds no weight of the links" in said
    told_by_check(capsys, *asked, "--apply-suggestion", str(cure))
    assert "gravity: compensated" in cure.read_text()
    code, said = told_by_check(capsys, *asked, "--log", str(cure))
    assert (code, "torque_weight" in said) == (0, False)
    result = close_loop(robot, [read_log(p, robot, log=cure) for p in paths], [])
    assert [(e.effect, e.joints) for e in result.model.effects] == [("viscous_friction", ("elbow",))]
    assert result.model.effects[0].parameters["viscous_coefficient"] == pytest.approx(1.0, rel=0.02)


def test_a_cure_that_is_one_word_comes_on_top_of_what_was_described(panda, run):
    findings = check_torque(panda, [without(panda, run)])[0]
    mended, told = combined({"units": {"q": "deg"}}, findings, panda.joint_names)
    assert mended == {"units": {"q": "deg"}, "gravity": "compensated"}
    assert [line.split(" (")[0] for line in told] == ["mends torque_weight: gravity"]
