"""``hybrid-dynamics import``: a recording of any supported kind to a Parquet log."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from hybrid_dynamics.cli.console import Console
from hybrid_dynamics.cli.options import add_command, add_log_form, add_robot, log_form


def add_parser(subparsers: Any) -> None:
    """Add the ``import`` command to ``subparsers`` (of :meth:`argparse.ArgumentParser.add_subparsers`)."""
    parser = add_command(
        subparsers,
        "import",
        run,
        short="convert a ROS bag, MCAP or CSV recording to a Parquet log",
        long="Convert a recording (ROS 1 bag, ROS 2 bag folder, MCAP, CSV) to a Parquet log "
        "(time, q, dq, tau); joints are matched by name to the URDF.",
        example="hybrid-dynamics import --robot robot.urdf --data a.mcap --out a.parquet",
    )
    add_robot(parser)
    add_log_form(parser)
    parser.add_argument(
        "--data", required=True, type=Path, metavar="FILE", help="bag, MCAP, bag folder, CSV or Parquet"
    )
    parser.add_argument("--out", required=True, type=Path, metavar="FILE", help="the Parquet file to write")
    parser.add_argument("--force", action="store_true", help="replace the file where it exists")
    parser.add_argument("--topic", help="JointState topic, where the recording holds several")


def run(args: argparse.Namespace) -> int:
    """Run the command; raises :class:`~hybrid_dynamics.errors.InputError` for unusable input."""
    from hybrid_dynamics.errors import InputError
    from hybrid_dynamics.files import check_target
    from hybrid_dynamics.readers.log import import_log
    from hybrid_dynamics.robots import Robot

    console = Console.of(args)
    check_target(args.out, [args.data, args.robot])
    if args.out.exists() and not args.force:
        raise InputError(f"{args.out}: exists; give another name, or --force to replace it")
    robot = Robot.from_urdf(args.robot, tuple(args.lock))
    notices: list[str] = []

    def note(line: str) -> None:
        notices.append(line)
        console.note(line)

    written = import_log(robot, args.data, args.out, args.topic, notify=note, log=log_form(args))
    span = float(written.time[-1] - written.time[0])
    console.say(
        f"{args.out}: {len(written.time)} samples, {span:.3f} s, {robot.n_joints} joints "
        f"({', '.join(robot.joint_names)}), signals {', '.join(written.signals)}"
    )
    console.result(
        {
            "status": "ok",
            "command": "import",
            "samples": len(written.time),
            "duration": span,
            "joints": list(robot.joint_names),
            "signals": list(written.signals),
            "notes": notices,
            "files": {"log": str(args.out)},
        }
    )
    return 0
