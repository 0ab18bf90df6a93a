"""``hybrid-dynamics export``: a completed model as a file that a simulator, a controller or an optimiser reads."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from hybrid_dynamics.export import FORMATS, export


def add_parser(subparsers: Any) -> None:
    """Add the ``export`` command to ``subparsers`` (of :meth:`argparse.ArgumentParser.add_subparsers`)."""
    parser = subparsers.add_parser(
        "export",
        help="write a completed model as URDF, MJCF, C, Python, CasADi or ONNX",
        description="Write a completed model for use elsewhere. What the format cannot carry is told by name, here and "
        "in the head of the file. onnx is for the networks (model.json of nn or r_nn), the others for what close-loop "
        "wrote.",
        epilog="Example: hybrid-dynamics export --model out/model.json --robot arm.urdf --format mjcf --out arm.xml",
    )
    parser.add_argument("--model", required=True, type=Path, metavar="FILE", help="model.json written by close-loop")
    parser.add_argument("--robot", required=True, type=Path, metavar="FILE", help="URDF of the robot")
    parser.add_argument("--format", required=True, choices=list(FORMATS), help="what to write")
    parser.add_argument("--out", required=True, type=Path, metavar="FILE", help="file to write")
    parser.add_argument("--lock", nargs="+", default=[], metavar="JOINT", help="joints fixed at zero")
    parser.add_argument("--strict", action="store_true", help="refuse where the format cannot carry all of the model")
    parser.add_argument("--force", action="store_true", help="replace the file where it exists")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """The ``export`` command."""
    for line in export(args.model, args.robot, args.format, args.out, args.lock, args.strict, args.force):
        print(line)
    return 0
