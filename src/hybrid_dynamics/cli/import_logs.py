"""``hybrid-dynamics import``: a recording of any supported kind to a Parquet log."""

from __future__ import annotations

import argparse
from typing import Any

from hybrid_dynamics.readers.log import import_log
from hybrid_dynamics.robots import Robot


def add_parser(subparsers: Any) -> None:
    """Add the ``import`` command to ``subparsers`` (of :meth:`argparse.ArgumentParser.add_subparsers`)."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "import",
        help="convert a ROS bag, MCAP or CSV recording to a Parquet log",
        description="Convert a recording (ROS 1 bag, ROS 2 bag folder, MCAP, CSV) to a Parquet log "
        "(time, q, dq, tau); joints are matched by name to the URDF.",
    )
    parser.add_argument("--robot", required=True, metavar="URDF", help="the recorded robot")
    parser.add_argument("--data", required=True, metavar="FILE", help="bag, MCAP, bag folder, CSV or Parquet")
    parser.add_argument("--out", required=True, metavar="FILE", help="the Parquet file to write")
    parser.add_argument("--topic", help="JointState topic, where the recording holds several")
    parser.add_argument(
        "--lock", nargs="+", default=[], metavar="JOINT", help="joints that do not move (fixed at zero)"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the command; raises :class:`~hybrid_dynamics.errors.InputError` for unusable input."""
    robot = Robot.from_urdf(args.robot, tuple(args.lock))
    written = import_log(robot, args.data, args.out, args.topic, notify=print)
    span = float(written.time[-1] - written.time[0])
    print(
        f"{args.out}: {len(written.time)} samples, {span:.3f} s, {robot.n_joints} joints "
        f"({', '.join(robot.joint_names)}), signals {', '.join(written.signals)}"
    )
    return 0
