"""The command line ``hybrid-dynamics``: close-loop, predict and import, on a URDF and log files, without DVC.

The subcommands are imported when the program runs: loading the libraries takes seconds, and Ctrl-C during them is an
interruption like any other.
"""

from __future__ import annotations

import argparse
import sys

from hybrid_dynamics.errors import run_main

DESCRIPTION = "Say what a robot's model lacks and add it, on a URDF and log files."
EXIT_CODES = "Exit codes: 0 done, 1 failed, 2 unusable input or no verdict possible, 130 interrupted."


class _Parser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line."""

    def error(self, message: str) -> None:  # type: ignore[override]
        print(f"error: {message} (see {self.prog} --help)", file=sys.stderr)
        sys.exit(2)


def build_parser() -> argparse.ArgumentParser:
    """The parser of all subcommands; each sets ``run``, a function of the parsed arguments."""
    from hybrid_dynamics.cli import close_loop, import_logs, predict

    parser = _Parser(prog="hybrid-dynamics", description=DESCRIPTION, epilog=EXIT_CODES)
    subparsers = parser.add_subparsers(dest="command", required=True, parser_class=_Parser)
    for command in (close_loop, predict, import_logs):
        command.add_parser(subparsers)
    return parser


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the ``hybrid-dynamics`` program."""

    def run() -> int:
        parsed = build_parser().parse_args(arguments)
        return int(parsed.run(parsed))

    run_main(run)
