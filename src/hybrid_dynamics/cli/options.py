"""What the commands have in common: their options, their help, the one-line complaint about a wrong argument."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from hybrid_dynamics.readers.description import LogDescription

EXIT_CODES = "Exit codes: 0 a verdict or result, 2 unusable input or settings, 130 interrupted; 1 is a bug: report it."
LOG_HELP = (
    "A LOG is CSV or Parquet with the header time,q1..qn[,dq1..dqn],tau1..taun (SI units; joints in the order of the "
    "URDF; torque is what the drive delivers, positive along the joint axis), the same packed (.csv.gz) or from "
    "standard input (-), arrays of these names from NumPy or MATLAB (.npz, .mat), or a ROS bag or MCAP with "
    "JointState; --log, --columns and --units say how others are read."
)


class Paragraphs(argparse.HelpFormatter):
    """Help in which an empty line ends a paragraph, and an indented line (a command) is not broken."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        fill = super()._fill_text
        parts = text.split("\n\n")
        return "\n\n".join(part if part.startswith("  ") else fill(part, width, indent) for part in parts)


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line."""

    def error(self, message: str) -> NoReturn:
        """One line and exit code 2, as for every other unusable input."""
        print(f"error: {' '.join(message.split())} (see {self.prog} --help)", file=sys.stderr)
        sys.exit(2)


class VersionAction(argparse.Action):
    """``--version``, looked up only when it is asked for."""

    def __init__(self, option_strings: Sequence[str], dest: str, **options: Any) -> None:
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, help="print the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: Any, **__: Any) -> None:
        """Print the version and end."""
        print(f"hybrid-dynamics {version()}")
        parser.exit()


def version() -> str:
    """Version of the installed package."""
    from importlib import metadata

    try:
        return metadata.version("hybrid-dynamics")
    except metadata.PackageNotFoundError:
        return "unknown (not installed)"


def add_command(
    subparsers: Any, name: str, run: Callable[[argparse.Namespace], int], *, short: str, long: str, example: str
) -> argparse.ArgumentParser:
    """A subcommand with the options all have; ``example`` is a command line that works."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        name,
        help=short,
        description=long,
        epilog=f"Example:\n\n  {example}\n\n{EXIT_CODES}",
        formatter_class=Paragraphs,
        allow_abbrev=False,
    )
    parser.set_defaults(run=run)
    group = parser.add_argument_group("output")
    group.add_argument("--json", action="store_true", help="print a summary for programs (one JSON object) to stdout")
    group.add_argument("--quiet", action="store_true", help="print nothing but errors (and --json)")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="YAML file with these options (train: [a.csv, b.csv]); flags win"
    )
    parser.add_argument("--version", action=VersionAction)
    return parser


def add_robot(parser: argparse.ArgumentParser) -> None:
    """``--robot`` and ``--lock``."""
    parser.add_argument("--robot", required=True, type=Path, metavar="URDF", help="URDF of the robot")
    parser.add_argument(
        "--lock", nargs="+", action="extend", default=[], metavar="JOINT", help="joints fixed at zero (not in the logs)"
    )


def add_settings(parser: argparse.ArgumentParser) -> None:
    """``--set``: settings of the loop by name."""
    parser.add_argument(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME=VALUE",
        help="settings, such as sign_widths=[0,0.05] or block=1",
    )


def add_log_form(parser: argparse.ArgumentParser) -> None:
    """``--log``, ``--columns``, ``--units``, ``--torque``: how logs in another form are read."""
    group = parser.add_argument_group("logs in another form (docs/logs.md)")
    group.add_argument("--log", type=Path, metavar="FILE", help="log.yaml that describes the logs")
    group.add_argument(
        "--columns", metavar="LIST", help="columns by name, such as time=stamp,q=actual_q_{i},tau=torque_{i}"
    )
    group.add_argument("--units", metavar="LIST", help="units of the columns, such as ms,deg,Nmm or dq=rpm")
    group.add_argument("--torque", choices=("measured", "commanded"), help="which torque columns are read")


def log_form(args: argparse.Namespace) -> LogDescription | None:
    """What those options say; None where none of them is given."""
    from hybrid_dynamics.readers.description import from_options

    return from_options(args.log, args.columns, args.units, args.torque)


def command_line(args: argparse.Namespace) -> dict[str, Any]:
    """The options of a run as JSON values, for the record: files by name, without what concerns only the terminal.

    Where the files lay is no part of a result: the same files elsewhere give the same bytes.
    """

    def plain(value: Any) -> Any:
        if isinstance(value, list | tuple):
            return [plain(v) for v in value]
        return value.name if isinstance(value, Path) else value

    left_out = ("run", "json", "quiet", "config", "force", "out")
    return {key: plain(value) for key, value in sorted(vars(args).items()) if key not in left_out}
