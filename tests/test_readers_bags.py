"""Bags and MCAP: joints by name, stamps by header, and every unusable bag refused in one line."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.writer import Writer as McapWriter
from mcap_ros2.writer import Writer as McapRos2Writer
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_typestore

from hybrid_dynamics.cli import import_logs
from hybrid_dynamics.errors import HybridDynamicsError, InputError
from hybrid_dynamics.readers import import_log, read_log
from hybrid_dynamics.robots import Robot

JOINTS = ("shoulder", "elbow")
# The bag's own order, with a joint that the robot does not have.
BAG_NAMES = ("gripper", "elbow", "shoulder")
RATE = 100.0
START = 1_700_000_000_000_000_000
DEFINITION = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
URDF = """<robot name="two"><link name="base"/>
<link name="a"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="50" velocity="3"/></joint>
<joint name="elbow" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="50" velocity="3"/></joint></robot>"""


@dataclass
class State:
    """One message, before it is encoded."""

    stamp: int
    name: Sequence[str]
    position: Sequence[float]
    velocity: Sequence[float]
    effort: Sequence[float]
    log_time: int
    topic: str = "/joint_states"


@dataclass
class Recording:
    """What goes into a bag, and the truth in the robot's joint order."""

    states: list[State] = field(default_factory=list)
    q: list[tuple[float, float]] = field(default_factory=list)


def recording(count: int = 200, names: Sequence[str] = BAG_NAMES) -> Recording:
    out = Recording()
    for k in range(count):
        t = k / RATE
        values = {"shoulder": np.sin(2 * t), "elbow": 0.5 * np.cos(3 * t), "gripper": 0.02}
        speeds = {"shoulder": 2 * np.cos(2 * t), "elbow": -1.5 * np.sin(3 * t), "gripper": 0.0}
        q = [float(values.get(n, 0.1)) for n in names]
        out.states.append(
            State(
                START + round(1e9 * t),
                names,
                q,
                [float(speeds.get(n, 0.1)) for n in names],
                [10 * x for x in q],
                START + round(1e9 * t) + 3_000_000,
            )
        )
        out.q.append((float(values["shoulder"]), float(values["elbow"])))
    return out


def ros_message(state: State, store: Any, first: bool) -> Any:
    types = store.types
    seq = {"seq": 0} if first else {}
    stamp = types["builtin_interfaces/msg/Time"](sec=state.stamp // 10**9, nanosec=state.stamp % 10**9)
    return types["sensor_msgs/msg/JointState"](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id="", **seq),
        name=list(state.name),
        position=np.array(state.position, float),
        velocity=np.array(state.velocity, float),
        effort=np.array(state.effort, float),
    )


def write_bag1(folder: Path, run: Recording) -> Path:
    path, store = folder / "run.bag", get_typestore(Stores.ROS1_NOETIC)
    with Bag1Writer(path) as writer:
        topics = {s.topic for s in run.states}
        links = {t: writer.add_connection(t, "sensor_msgs/msg/JointState", typestore=store) for t in sorted(topics)}
        for state in sorted(run.states, key=lambda s: s.log_time):
            raw = store.serialize_ros1(ros_message(state, store, True), "sensor_msgs/msg/JointState")
            writer.write(links[state.topic], state.log_time, raw)
    return path


def write_bag2(folder: Path, run: Recording, plugin: StoragePlugin) -> Path:
    path, store = folder / "run", get_typestore(Stores.ROS2_HUMBLE)
    with Bag2Writer(path, version=9, storage_plugin=plugin) as writer:
        topics = {s.topic for s in run.states}
        links = {t: writer.add_connection(t, "sensor_msgs/msg/JointState", typestore=store) for t in sorted(topics)}
        for state in sorted(run.states, key=lambda s: s.log_time):
            raw = store.serialize_cdr(ros_message(state, store, False), "sensor_msgs/msg/JointState")
            writer.write(links[state.topic], state.log_time, raw)
    return path


def write_mcap(folder: Path, run: Recording) -> Path:
    path = folder / "run.mcap"
    with open(path, "wb") as stream:
        writer = McapRos2Writer(stream)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", DEFINITION)
        for state in sorted(run.states, key=lambda s: s.log_time):
            stamp = {"sec": state.stamp // 10**9, "nanosec": state.stamp % 10**9}
            message = {
                "header": {"stamp": stamp, "frame_id": ""},
                "name": list(state.name),
                "position": list(state.position),
                "velocity": list(state.velocity),
                "effort": list(state.effort),
            }
            writer.write_message(state.topic, schema, message, log_time=state.log_time)
        writer.finish()
    return path


def write_mcap_ros1(folder: Path, run: Recording) -> Path:
    """An MCAP file as converted from a ROS 1 bag."""
    path, store = folder / "run.mcap", get_typestore(Stores.ROS1_NOETIC)
    text, _ = store.generate_msgdef("sensor_msgs/msg/JointState")
    with open(path, "wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros1")
        schema = writer.register_schema("sensor_msgs/JointState", "ros1msg", text.encode())
        channel = writer.register_channel("/joint_states", "ros1", schema)
        for state in run.states:
            raw = store.serialize_ros1(ros_message(state, store, True), "sensor_msgs/msg/JointState")
            writer.add_message(channel, state.log_time, bytes(raw), state.log_time)
        writer.finish()
    return path


KINDS: dict[str, Callable[[Path, Recording], Path]] = {
    "ros1": write_bag1,
    "ros2 sqlite": lambda folder, run: write_bag2(folder, run, StoragePlugin.SQLITE3),
    "ros2 mcap": lambda folder, run: write_bag2(folder, run, StoragePlugin.MCAP),
    "mcap": write_mcap,
    "mcap ros1": write_mcap_ros1,
}


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    (tmp_path / "robot.urdf").write_text(URDF)
    return Robot.from_urdf(tmp_path / "robot.urdf")


@pytest.mark.parametrize("kind", KINDS)
def test_every_format_gives_the_recorded_motion(tmp_path: Path, kind: str) -> None:
    run = recording()
    log = read_log(KINDS[kind](tmp_path, run), JOINTS, "run", "test")
    np.testing.assert_allclose(log["q"], np.array(run.q), atol=1e-12)
    np.testing.assert_allclose(log["tau"], 10 * np.array(run.q), atol=1e-12)
    np.testing.assert_allclose(log["dq"][:, 0], 2 * np.cos(2 * log.time), atol=1e-6)
    assert log.time[0] == 0
    assert log.dt == pytest.approx(1 / RATE, rel=1e-9)


def test_storage_file_of_a_bag_folder_can_be_given_alone(tmp_path: Path) -> None:
    run = recording()
    [storage] = KINDS["ros2 sqlite"](tmp_path, run).glob("*.db3")
    np.testing.assert_allclose(read_log(storage, JOINTS)["q"], np.array(run.q), atol=1e-12)


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_late_and_repeated_messages(tmp_path: Path, kind: str) -> None:
    """Recording order differs from measurement order, and some messages come twice."""
    run, said = recording(), list[str]()
    rng = np.random.default_rng(0)
    for state in run.states:
        state.log_time += int(rng.integers(0, 30_000_000))
    run.states += [State(**{**vars(s), "log_time": s.log_time + 1000}) for s in run.states[10:20]]
    log = read_log(KINDS[kind](tmp_path, run), JOINTS, notify=said.append)
    np.testing.assert_allclose(log["q"], np.array(run.q), atol=1e-12)
    assert any("out of order: sorted by header stamp" in line for line in said)
    assert any("10 messages with a repeated header stamp" in line for line in said)


def test_zero_header_stamps_and_missing_velocity(tmp_path: Path) -> None:
    run, said = recording(), list[str]()
    for state in run.states:
        state.stamp, state.velocity = 0, []
    log = read_log(write_mcap(tmp_path, run), JOINTS, notify=said.append)
    np.testing.assert_allclose(log["q"], np.array(run.q), atol=1e-12)
    assert "dq" not in log
    assert any("time of recording used" in line for line in said)


def test_messages_of_other_joints_are_left_out(tmp_path: Path) -> None:
    """A gripper driver publishes on the same topic."""
    run, said = recording(), list[str]()
    run.states += [
        State(s.stamp + 5_000_000, ["finger"], [0.0], [0.0], [0.0], s.log_time + 5_000_000) for s in run.states
    ]
    log = read_log(write_bag1(tmp_path, run), JOINTS, notify=said.append)
    np.testing.assert_allclose(log["q"], np.array(run.q), atol=1e-12)
    assert any("200 of 400 messages left out" in line for line in said)


def test_topic_is_chosen_when_several(tmp_path: Path) -> None:
    run = recording()
    run.states += [State(**{**vars(s), "topic": "/sim/joint_states", "effort": [1.0, 1.0, 1.0]}) for s in run.states]
    path = write_mcap(tmp_path, run)
    with pytest.raises(InputError, match=r"several JointState topics \(/joint_states, /sim/joint_states\).*--topic"):
        read_log(path, JOINTS)
    assert read_log(path, JOINTS, topic="/sim/joint_states")["tau"].std() == 0
    with pytest.raises(InputError, match="no JointState topic '/other'; it holds /joint_states"):
        read_log(path, JOINTS, topic="/other")


def every(**changes: Any) -> Callable[[Recording], None]:
    def edit(run: Recording) -> None:
        for state in run.states:
            for name, value in changes.items():
                setattr(state, name, value)

    return edit


def spoil_one(run: Recording) -> None:
    run.states[17].position = [0.0, float("nan"), 0.0]


def shorten(run: Recording) -> None:
    del run.states[20:]


BAD: dict[str, tuple[Callable[[Recording], None], list[str]]] = {
    "other joints": (every(name=("a", "b", "c")), ["missing shoulder, elbow", "it holds a, b, c"]),
    "one joint missing": (every(name=("gripper", "elbow", "x")), ["missing shoulder, it holds", "--lock"]),
    "no effort": (every(effort=[]), ["effort is empty", "enable effort"]),
    "zero effort": (every(effort=[0.0, 0.0, 0.0]), ["torque columns are all zero"]),
    "no position": (every(position=[]), ["position is empty"]),
    "lengths differ": (every(effort=[1.0, 2.0]), ["3 names but 2 values of effort"]),
    "nan": (spoil_one, ["q of joint elbow is nan in message 18"]),
    "too short": (shorten, ["20 joint states; expected at least 50"]),
}


@pytest.mark.parametrize("kind", ["ros1", "ros2 sqlite", "mcap"])
@pytest.mark.parametrize("case", BAD)
def test_unusable_bag_is_refused_and_nothing_written(tmp_path: Path, robot: Robot, kind: str, case: str) -> None:
    edit, parts = BAD[case]
    run = recording()
    edit(run)
    path = KINDS[kind](tmp_path, run)
    with pytest.raises(InputError) as error:
        import_log(robot, path, tmp_path / "out.parquet")
    text = str(error.value)
    assert "\n" not in text
    for part in [str(path), *parts]:
        assert part in text
    assert not list(tmp_path.glob("*out*"))


def write_strings(folder: Path, kind: str) -> Path:
    """A bag that holds a topic of another type only."""
    if kind == "mcap":
        path = folder / "talk.mcap"
        with open(path, "wb") as stream:
            writer = McapRos2Writer(stream)
            schema = writer.register_msgdef("std_msgs/msg/String", "string data")
            writer.write_message("/chatter", schema, {"data": "hello"}, log_time=START)
            writer.finish()
        return path
    store = get_typestore(Stores.ROS1_NOETIC)
    path = folder / "talk.bag"
    with Bag1Writer(path) as writer1:
        link = writer1.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        message = store.types["std_msgs/msg/String"](data="hello")
        writer1.write(link, START, store.serialize_ros1(message, "std_msgs/msg/String"))
    return path


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_bag_without_joint_states(tmp_path: Path, kind: str) -> None:
    with pytest.raises(InputError, match=r"no topic of type sensor_msgs/JointState; it holds /chatter \(std_msgs"):
        read_log(write_strings(tmp_path, kind), JOINTS)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.7, 0.95, 0.999])
@pytest.mark.parametrize("kind", KINDS)
def test_truncated_bag(tmp_path: Path, kind: str, share: float) -> None:
    path = KINDS[kind](tmp_path, recording())
    storage = path if path.is_file() else next(p for p in path.iterdir() if p.name != "metadata.yaml")
    content = storage.read_bytes()
    storage.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError) as error:
        read_log(path, JOINTS)
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)


def test_missing_bag_and_folder_without_metadata(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_log(tmp_path / "none.bag", JOINTS)
    with pytest.raises(InputError, match=r"without metadata\.yaml"):
        read_log(tmp_path, JOINTS)


def command(*words: str) -> int:
    parser = argparse.ArgumentParser()
    import_logs.add_parser(parser.add_subparsers())
    args = parser.parse_args(["import", *words])
    return int(args.run(args))


def test_import_command(tmp_path: Path, robot: Robot, capsys: pytest.CaptureFixture[str]) -> None:
    run, out = recording(), tmp_path / "out.parquet"
    bag = write_mcap(tmp_path, run)
    assert command("--robot", str(tmp_path / "robot.urdf"), "--data", str(bag), "--out", str(out)) == 0
    assert "200 samples, 1.990 s, 2 joints (shoulder, elbow), signals q, dq, tau" in capsys.readouterr().out
    table = pq.read_table(out)
    assert table.column_names == ["time", "q1", "q2", "dq1", "dq2", "tau1", "tau2"]
    np.testing.assert_allclose(table["q1"], [q[0] for q in run.q])
    first = out.read_bytes()
    command("--robot", str(tmp_path / "robot.urdf"), "--data", str(bag), "--out", str(out), "--force")
    assert out.read_bytes() == first
    np.testing.assert_allclose(read_log(out, JOINTS)["q"], np.array(run.q))
    short = tmp_path / "out.pq"
    assert command("--robot", str(tmp_path / "robot.urdf"), "--data", str(bag), "--out", str(short)) == 0
    assert short.read_bytes() == first


def test_import_command_with_a_locked_joint(tmp_path: Path, robot: Robot) -> None:
    bag, out = write_mcap(tmp_path, recording(names=("elbow",))), tmp_path / "out.parquet"
    words = ("--robot", str(tmp_path / "robot.urdf"), "--data", str(bag), "--out", str(out))
    with pytest.raises(InputError, match="missing shoulder"):
        command(*words)
    assert command(*words, "--lock", "shoulder") == 0
    assert pq.read_table(out).column_names == ["time", "q1", "dq1", "tau1"]


def test_import_never_destroys_a_file(tmp_path: Path, robot: Robot) -> None:
    bag = write_mcap(tmp_path, recording())
    import_log(robot, bag, tmp_path / "log.parquet")
    before = (tmp_path / "log.parquet").read_bytes()
    with pytest.raises(InputError, match="is an input and would be overwritten"):
        import_log(robot, tmp_path / "log.parquet", tmp_path / "log.parquet")
    with pytest.raises(InputError, match=r"ends in \.parquet"):
        import_log(robot, bag, tmp_path / "log.csv")
    bad = recording()
    every(effort=[])(bad)
    with pytest.raises(HybridDynamicsError):
        import_log(robot, write_bag1(tmp_path, bad), tmp_path / "log.parquet")
    assert (tmp_path / "log.parquet").read_bytes() == before
