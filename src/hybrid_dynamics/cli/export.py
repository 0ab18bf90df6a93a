"""``hybrid-dynamics export``: a completed model as a file that a simulator, a controller or an optimiser reads."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from hybrid_dynamics.cli.console import Console
from hybrid_dynamics.cli.options import add_command, add_robot
from hybrid_dynamics.export import FORMATS


def add_parser(subparsers: Any) -> None:
    """Add the ``export`` command to ``subparsers`` (of :meth:`argparse.ArgumentParser.add_subparsers`)."""
    parser = add_command(
        subparsers,
        "export",
        run,
        short="write a completed model as URDF, MJCF, C, Python, CasADi or ONNX",
        long="Write a completed model for use elsewhere. What the format cannot carry is told by name, here and in the "
        "head of the file. onnx is for the networks (model.json of nn or r_nn), the others for what close-loop wrote.",
        example="hybrid-dynamics export --model out/model.json --robot robot.urdf --format mjcf --out robot.xml",
    )
    add_robot(parser)
    parser.add_argument("--model", required=True, type=Path, metavar="FILE", help="model.json written by close-loop")
    parser.add_argument("--format", required=True, choices=list(FORMATS), help="what to write")
    endings = ", ".join(f"{' or '.join(kind.endings)} for {form}" for form, kind in FORMATS.items())
    parser.add_argument(
        "--out", required=True, type=Path, metavar="FILE", help=f"file to write; its name ends in {endings}"
    )
    parser.add_argument("--strict", action="store_true", help="refuse where the format cannot carry all of the model")
    parser.add_argument("--force", action="store_true", help="replace the file where it exists")


def run(args: argparse.Namespace) -> int:
    """The ``export`` command."""
    from hybrid_dynamics.export.writing import export

    console = Console.of(args)
    done = export(args.model, args.robot, args.format, args.out, args.lock, args.strict, args.force)
    for line in done.lost:
        console.note(f"{args.format} cannot carry {line}")
    for line in done.left_out:
        console.note(f"left out, held-out runs contradict it: {line}")
    for line in done.notes:
        console.note(line)
    for path in done.files:
        console.say(f"{path}: written")
    console.result(
        {
            "status": "ok",
            "command": "export",
            "format": args.format,
            "files": [str(path) for path in done.files],
            "lost": list(done.lost),
            "left_out": list(done.left_out),
            "notes": list(done.notes),
        }
    )
    return 0
