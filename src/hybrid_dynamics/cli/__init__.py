"""The command line ``hybrid-dynamics``, on a URDF and log files, without DVC.

One module a command: ``add_parser`` says what the command takes, ``run`` does it. Loading the libraries takes seconds,
so they are imported when a command runs (inside ``run``): ``--help`` answers at once, and Ctrl-C during the imports is
an interruption like any other.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence

from hybrid_dynamics.cli.config import with_config
from hybrid_dynamics.cli.console import Console, safe_streams
from hybrid_dynamics.cli.options import EXIT_CODES, Parser, VersionAction
from hybrid_dynamics.errors import HybridDynamicsError, one_line, run_main

DESCRIPTION = "Say what a robot's model lacks and add it, on a URDF and log files."
#: Modules of this package, one a command, in the order of the help.
COMMANDS = ("close_loop", "predict", "check", "export", "import_logs", "fleet", "completion")


def build_parser() -> argparse.ArgumentParser:
    """The parser of all subcommands; each sets ``run``, a function of the parsed arguments."""
    parser = Parser(prog="hybrid-dynamics", description=DESCRIPTION, epilog=EXIT_CODES, allow_abbrev=False)
    parser.add_argument("--version", action=VersionAction)
    subparsers = parser.add_subparsers(dest="command", required=True, parser_class=Parser, metavar="COMMAND")
    for name in COMMANDS:
        importlib.import_module(f"hybrid_dynamics.cli.{name}").add_parser(subparsers)
    return parser


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of the ``hybrid-dynamics`` program."""

    def run() -> int:
        parser = build_parser()
        parsed = parser.parse_args(with_config(parser, sys.argv[1:] if arguments is None else list(arguments)))
        try:
            return int(parsed.run(parsed))
        except HybridDynamicsError as error:
            if getattr(parsed, "json", False):
                Console.of(parsed).result({"status": "error", "error": one_line(error), "exit_code": error.exit_code})
            raise
        except KeyboardInterrupt:
            if getattr(parsed, "json", False):
                Console.of(parsed).result({"status": "error", "error": "interrupted", "exit_code": 130})
            raise

    with safe_streams():
        run_main(run)
