"""The command line ``hybrid-dynamics``: close-loop, predict and import, on a URDF and log files, without DVC."""

from __future__ import annotations

import argparse
import sys

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.loop import cli as loop_cli
from hybrid_dynamics.readers import cli as readers_cli


class _Parser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line."""

    def error(self, message: str) -> None:  # type: ignore[override]
        print(f"error: {message} (see {self.prog} --help)", file=sys.stderr)
        sys.exit(2)


def build_parser() -> argparse.ArgumentParser:
    """The parser of all subcommands; each sets ``run``, a function of the parsed arguments."""
    parser = _Parser(prog="hybrid-dynamics", description=__doc__)
    subparsers = parser.add_subparsers(dest="command", required=True, parser_class=_Parser)
    loop_cli.add_parsers(subparsers)
    readers_cli.add_parser(subparsers)
    return parser


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the ``hybrid-dynamics`` program."""
    parsed = build_parser().parse_args(arguments)
    run_main(lambda: parsed.run(parsed))
