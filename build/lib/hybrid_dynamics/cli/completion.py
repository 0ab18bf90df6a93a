"""``hybrid-dynamics completion``: a script that lets a shell complete commands, options and file names."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from hybrid_dynamics.cli.options import add_command

SHELLS = ("bash", "zsh", "tcsh")


def add_parser(subparsers: Any) -> None:
    """Add the ``completion`` command to ``subparsers`` (of :meth:`argparse.ArgumentParser.add_subparsers`)."""
    parser = add_command(
        subparsers,
        "completion",
        run,
        short="print a script for completion in the shell",
        long="Print a script that completes commands, options and file names; put the example into ~/.bashrc.",
        example='eval "$(hybrid-dynamics completion bash)"',
    )
    parser.add_argument("shell", choices=SHELLS, nargs="?", default="bash", help="bash where not given")


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    import shtab

    from hybrid_dynamics.cli import build_parser

    parser = build_parser()
    for group in parser._actions:
        if isinstance(group, argparse._SubParsersAction):
            for command in group.choices.values():
                for action in command._actions:
                    if action.type is Path:
                        action.complete = shtab.FILE
    print(shtab.complete(parser, args.shell))
    return 0
