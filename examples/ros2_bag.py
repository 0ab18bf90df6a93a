"""ROS 2: joint-state bags in, completed model out. No ROS installation is needed.

    python examples/ros2_bag.py                                           # the demonstration arm
    python examples/ros2_bag.py --robot my.urdf --train run_1 run_2 --test run_3 --out model.json

A bag is a folder as `ros2 bag record /joint_states` leaves it (or an .mcap or .db3 file). Joints are found by name in
any order; effort is taken as the torque that the drive delivers.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import demo_arm
import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from hybrid_dynamics import Model, Robot, close_loop, read_log
from hybrid_dynamics.trajectory import Trajectory


def write_bag(path: Path, run: Trajectory, joints: tuple[str, ...]) -> Path:
    """What `ros2 bag record /joint_states` would have recorded of ``run``."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    joint_state = types.types["sensor_msgs/msg/JointState"]
    header, stamp = types.types["std_msgs/msg/Header"], types.types["builtin_interfaces/msg/Time"]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        topic = bag.add_connection("/joint_states", joint_state.__msgtype__, typestore=types)
        for time, q, tau in zip(run.time, run["q"], run["tau"], strict=True):
            nanoseconds = 1_700_000_000_000_000_000 + round(1e9 * time)
            at = header(stamp(nanoseconds // 10**9, nanoseconds % 10**9), "")
            message = joint_state(at, list(joints), q, np.empty(0), tau)
            bag.write(topic, nanoseconds, types.serialize_cdr(message, joint_state.__msgtype__))
    return path


def complete(urdf: Path, train: list[Path], test: list[Path], out: Path) -> Model:
    """Find what the URDF lacks, and keep it as ``model.json``."""
    robot = Robot.from_urdf(urdf)
    logs = {"train": train, "test": test}
    runs = {split: [read_log(p, robot.joint_names, split=split) for p in paths] for split, paths in logs.items()}
    result = close_loop(robot, runs["train"], runs["test"])
    print(f"{robot.name}: {result.diagnosis.verdict.replace('_', ' ')}")
    for effect in result.model.effects:
        values = ", ".join(f"{name} {value:.3g}" for name, value in effect.parameters.items())
        print(f"  {effect.effect} ({', '.join(effect.joints) or 'whole robot'}): {values}")
    result.model.save(out)
    print(f"{out}: written")
    return result.model


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", type=Path)
    parser.add_argument("--train", type=Path, nargs="+", default=[])
    parser.add_argument("--test", type=Path, nargs="+", default=[])
    parser.add_argument("--out", type=Path, default=Path("model.json"))
    given = parser.parse_args()
    if given.robot:
        complete(given.robot, given.train, given.test, given.out)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        urdf = demo_arm.write_urdf(folder)
        joints = Robot.from_urdf(urdf).joint_names
        train, test = demo_arm.record(Robot.from_urdf(urdf))
        bags = [write_bag(folder / f"run_{k}", run, joints) for k, run in enumerate([*train, *test])]
        complete(urdf, bags[:-1], bags[-1:], given.out)


if __name__ == "__main__":
    main()
