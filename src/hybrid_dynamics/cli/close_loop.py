"""``hybrid-dynamics close-loop``: the loop on a URDF and log files, without DVC."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from hybrid_dynamics.cli.console import Console
from hybrid_dynamics.cli.options import (
    LOG_HELP,
    add_command,
    add_log_form,
    add_robot,
    add_settings,
    command_line,
    log_form,
)


def add_parser(subparsers: Any) -> None:
    """Add the ``close-loop`` command to ``subparsers`` (of :meth:`argparse.ArgumentParser.add_subparsers`)."""
    parser = add_command(
        subparsers,
        "close-loop",
        run,
        short="name the physical effects a robot model lacks, add them, report before and after",
        long="Trace what the model lacks on the training logs, add it, prove it on the test logs. " + LOG_HELP,
        example="hybrid-dynamics close-loop --robot robot.urdf --train a.csv b.csv --test c.csv --out out",
    )
    add_robot(parser)
    add_log_form(parser)
    parser.add_argument(
        "--train", required=True, nargs="+", action="extend", type=Path, metavar="LOG", help="logs to learn from"
    )
    parser.add_argument(
        "--test",
        nargs="+",
        action="extend",
        type=Path,
        default=[],
        metavar="LOG",
        help="logs held out (default: end of each training log)",
    )
    parser.add_argument(
        "--out",
        required=True,
        type=Path,
        metavar="FOLDER",
        help="folder for diagnosis.json, model.json, report.html; replaced as a whole",
    )
    parser.add_argument(
        "--force", action="store_true", help="put the results into --out also where it holds other files (they stay)"
    )
    parser.add_argument(
        "--model", type=Path, metavar="FILE", help="start from this model.json, not from the URDF alone"
    )
    parser.add_argument(
        "--ignore-dynamics", action="store_true", help="leave the URDF's <dynamics> out of the starting model"
    )
    add_settings(parser)


def run(args: argparse.Namespace) -> int:
    """The ``close-loop`` command: 0 whenever a verdict was reached."""
    from hybrid_dynamics.cli.settings import settings_from
    from hybrid_dynamics.close_files import LoopFiles, close_files

    console = Console.of(args)
    files = LoopFiles(
        args.robot,
        tuple(args.train),
        args.out,
        tuple(args.test),
        args.model,
        tuple(args.lock),
        settings_from(args.set),
        command_line(args),
        args.force,
        log_form(args),
        args.ignore_dynamics,
    )
    files.check()
    with console.progress() as progress:
        diagnosis = close_files(files, progress, console.note)
    _tell(console, diagnosis, args.out)
    return 0


def _tell(console: Console, diagnosis: dict[str, Any], out: Path) -> None:
    from hybrid_dynamics.cli.words import (
        details,
        headline,
        joint_rows,
        notes,
        parameter_lines,
        second_line,
        verdict_line,
    )
    from hybrid_dynamics.loop_report.output import RESULT_FILES
    from hybrid_dynamics.loop_report.words import told_first

    console.say(verdict_line(diagnosis))
    for note in told_first(diagnosis):
        console.say(note)
    console.say(second_line(diagnosis))
    for line in details(diagnosis):
        console.say(f"  {line}")
    if diagnosis["effects"]:
        console.say("parameters ± standard errors:")
    for line in parameter_lines(diagnosis):
        console.say(f"  {line}")
    console.table(*joint_rows(diagnosis))
    for note in notes(diagnosis):
        console.say(f"note: {note}")
    console.say(f"report: {out / 'report.html'}")
    console.result(
        {
            "status": "ok",
            "command": "close-loop",
            "robot": diagnosis["robot"],
            "verdict": diagnosis["verdict"],
            "headline": headline(diagnosis),
            "effects": diagnosis["effects"],
            "error": diagnosis["error"],
            "noise_floor": diagnosis["noise_floor"],
            "unexplained": diagnosis["unexplained"],
            "notes": diagnosis.get("notes", []),
            "files": {Path(name).stem: str(out / name) for name in RESULT_FILES},
        }
    )
