"""Joint states out of ROS 1 bags, ROS 2 bags (SQLite or MCAP folders) and MCAP files, no ROS needed.

Joints are matched by name. Time is the header stamp (the instant of measurement); where the driver leaves it zero, the
time of recording. Only ``sensor_msgs/JointState`` is decoded, so that other topics of a bag may hold anything.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.errors import InputError, needs_extra
from hybrid_dynamics.readers.table import check_plausible
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array, Notify

JOINT_STATE = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")
BAG_SUFFIXES = (".bag", ".mcap", ".db3")


@dataclass(frozen=True)
class _Message:
    topic: str
    log_time: int
    state: Any


def read_bag(
    path: str | os.PathLike[str],
    joint_names: Sequence[str],
    name: str | None = None,
    split: str = "train",
    topic: str | None = None,
    notify: Notify | None = None,
    torque: bool = True,
) -> Trajectory:
    """The joint states of one bag as ``q [dq] tau`` in the order of ``joint_names``, stamps as recorded, from zero.

    ``topic`` chooses among several JointState topics. Velocity is kept where every message has it. Without ``torque``
    effort is neither needed nor read. Raises :class:`InputError` for a bag that is damaged, has no such topic, lacks a
    joint or has no effort.
    """
    file = Path(path)
    tell = notify or (lambda message: None)
    name = name if name is not None else file.stem
    if not file.exists():
        raise InputError(f"{file}: no such bag; give a bag file or a ROS 2 bag folder")
    if file.is_dir() and not (file / "metadata.yaml").exists():
        raise InputError(
            f"{file}: a folder without metadata.yaml, so no ROS 2 bag; give the .mcap or .db3 file in it, or repair it "
            "(ros2 bag reindex)"
        )
    _decoders()
    with _readable(file):
        topics = _topics(file)
    chosen = _choose(file, topics, topic)
    with _readable(file):
        messages = list(_messages(file, chosen))
    if not messages:
        raise InputError(f"{file}: topic {chosen} holds no message; record while the robot moves")
    states = _states(file, chosen, messages, joint_names, name, tell, torque)
    stamps, order = _order(states.stamps, states.log_times, name, tell)
    signals = {"q": states.q, "dq": states.dq, "tau": states.tau}
    arrays = {signal: values[order] for signal, values in signals.items() if values is not None}
    for signal, values in arrays.items():
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            row, joint = bad[0]
            raise InputError(
                f"{file}: topic {chosen}: {signal} of joint {joint_names[joint]} is {values[row, joint]} in message "
                f"{row + 1}; expected finite numbers: record again or cut that part out"
            )
    check_plausible(file, arrays, joint_names, name, tell)
    return Trajectory(name, split, 1e-9 * (stamps - stamps[0]).astype(float), arrays)


def _decoders() -> Any:
    """The libraries that read bags; :class:`MissingDependencyError` where they are not installed."""
    with needs_extra("bags", "reading ROS bags and MCAP"):
        from hybrid_dynamics.readers import decoders
    return decoders


@contextmanager
def _readable(file: Path) -> Iterator[None]:
    """Turn what the bag libraries raise on damaged files into one :class:`InputError`."""
    try:
        yield
    # What decoders raise on damaged bytes is no closed set: their own errors, SQLite's, zstd's, struct's, ...
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"{file}: not a readable bag, or a damaged or truncated one ({reason[:160]}); copy it again, or repair it "
            "(rosbag reindex, ros2 bag reindex, mcap recover)"
        ) from error


def _topics(file: Path) -> dict[str, str]:
    """Message type of every topic."""
    if file.suffix == ".mcap" and file.is_file():
        with open(file, "rb") as stream:
            summary = _decoders().make_reader(stream, validate_crcs=True).get_summary()
            if summary is None:
                raise ValueError("no summary: the recording was not closed")
            schemas = {key: schema.name for key, schema in summary.schemas.items()}
            return {c.topic: schemas.get(c.schema_id, "") for c in summary.channels.values()}
    with _bag(file) as reader:
        return {connection.topic: connection.msgtype for connection in reader.connections}


def _choose(file: Path, topics: dict[str, str], topic: str | None) -> str:
    states = sorted(name for name, kind in topics.items() if kind in JOINT_STATE)
    if not states:
        held = ", ".join(f"{name} ({kind})" for name, kind in sorted(topics.items())[:6]) or "no topic at all"
        raise InputError(f"{file}: no topic of type sensor_msgs/JointState; it holds {held}: record the joint states")
    if topic is not None:
        if topic not in states:
            raise InputError(f"{file}: no JointState topic {topic!r}; it holds {', '.join(states)}")
        return topic
    if len(states) > 1:
        raise InputError(f"{file}: several JointState topics ({', '.join(states)}); choose one with --topic")
    return states[0]


def _messages(file: Path, topic: str) -> Iterator[_Message]:
    if file.suffix == ".mcap" and file.is_file():
        with open(file, "rb") as stream:
            reader = _decoders().make_reader(
                stream, validate_crcs=True, decoder_factories=[_decoders().Ros1Decoder(), _decoders().Ros2Decoder()]
            )
            for decoded in reader.iter_decoded_messages(topics=[topic]):
                yield _Message(topic, decoded.message.log_time, decoded.decoded_message)
        return
    first = file.suffix == ".bag"
    # JointState is the same in every distribution of ROS 1 and of ROS 2.
    store = _decoders().get_typestore(_decoders().Stores.ROS1_NOETIC if first else _decoders().Stores.ROS2_HUMBLE)
    decode = store.deserialize_ros1 if first else store.deserialize_cdr
    with _bag(file) as reader:
        wanted = [connection for connection in reader.connections if connection.topic == topic]
        for _, log_time, raw in reader.messages(connections=wanted):
            yield _Message(topic, log_time, decode(raw, JOINT_STATE[0]))


def _bag(file: Path) -> Any:
    return _decoders().Bag1(file) if file.suffix == ".bag" else _decoders().Bag2(file)


@dataclass(frozen=True)
class _States:
    stamps: NDArray[np.int64]
    log_times: NDArray[np.int64]
    q: Array
    dq: Array | None
    tau: Array | None


def _states(
    file: Path, topic: str, messages: list[_Message], joint_names: Sequence[str], name: str, tell: Notify, torque: bool
) -> _States:
    """Rows of the messages that hold all joints, columns in the order of ``joint_names``."""
    layouts: dict[tuple[str, ...], list[int] | None] = {}
    rows: list[tuple[_Message, list[int]]] = []
    for message in messages:
        names = tuple(message.state.name)
        if names not in layouts:
            complete = set(joint_names) <= set(names)
            layouts[names] = [names.index(joint) for joint in joint_names] if complete else None
        columns = layouts[names]
        if columns is not None:
            rows.append((message, columns))
    if not rows:
        held = sorted({joint for names in layouts for joint in names})
        lacking = [joint for joint in joint_names if joint not in held] or list(joint_names)
        raise InputError(
            f"{file}: topic {topic}: no message holds all joints of the robot; missing {', '.join(lacking)}, it holds "
            f"{', '.join(held) or 'no names'}: use the URDF of the recorded robot, or --lock joints that do not move"
        )
    if len(rows) < len(messages):
        tell(f"{name}: {len(messages) - len(rows)} of {len(messages)} messages left out (they lack some joints)")

    def gather(field: str) -> Array | None:
        """(T, n) of ``field``; None where a message leaves it empty."""
        values = [getattr(message.state, field) for message, _ in rows]
        if any(len(value) == 0 for value in values):
            return None
        for (message, _), value in zip(rows, values, strict=True):
            if len(value) != len(message.state.name):
                raise InputError(
                    f"{file}: topic {topic}: a message has {len(message.state.name)} names but {len(value)} values of "
                    f"{field}; expected as many: the publisher is faulty"
                )
        return np.array([[value[c] for c in columns] for (_, columns), value in zip(rows, values, strict=True)], float)

    q, dq, tau = gather("position"), gather("velocity"), gather("effort") if torque else None
    if q is None:
        raise InputError(f"{file}: topic {topic}: position is empty; expected the joint positions [rad]")
    if torque and tau is None:
        raise InputError(
            f"{file}: topic {topic}: effort is empty; expected the joint torques [N m]: enable effort in the driver"
        )
    if dq is not None and not (np.isfinite(dq).all() and dq.any()):
        dq = None
        tell(f"{name}: velocity in {topic} is zero or not a number: estimated from position instead")
    stamps = [_nanoseconds(message.state.header.stamp) for message, _ in rows]
    return _States(np.array(stamps, np.int64), np.array([m.log_time for m, _ in rows], np.int64), q, dq, tau)


def _nanoseconds(stamp: Any) -> int:
    """ROS 2 calls the fields sec and nanosec, ROS 1 secs and nsecs; rosbags uses the former for both."""
    if hasattr(stamp, "nanosec"):
        return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    return int(stamp.secs) * 1_000_000_000 + int(stamp.nsecs)


def _order(
    stamps: NDArray[np.int64], log_times: NDArray[np.int64], name: str, tell: Notify
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Strictly increasing stamps [ns] and the rows they belong to."""
    if not stamps.any():
        tell(f"{name}: header stamps are zero: time of recording used")
        stamps = log_times
    order = np.argsort(stamps, kind="stable")
    late = int(np.sum(np.diff(stamps) < 0))
    ordered = stamps[order]
    fresh = np.concatenate([[True], np.diff(ordered) > 0])
    if late:
        tell(f"{name}: {late} messages out of order: sorted by header stamp")
    if not fresh.all():
        tell(f"{name}: {int(np.sum(~fresh))} messages with a repeated header stamp left out")
    return ordered[fresh], order[fresh]
