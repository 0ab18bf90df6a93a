"""``hybrid-dynamics close-loop``: the loop on a URDF and log files, without DVC."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from hybrid_dynamics.cli.console import Console
from hybrid_dynamics.cli.options import LOG_HELP, add_command, add_log_form, add_robot, command_line, log_form
from hybrid_dynamics.errors import InputError


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
    parser.add_argument("--train", required=True, nargs="+", type=Path, metavar="LOG", help="logs to learn from")
    parser.add_argument(
        "--test",
        nargs="+",
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
        "--set", nargs="+", default=[], metavar="NAME=VALUE", help="settings, such as sign_widths=[0,0.05] or block=1"
    )


def run(args: argparse.Namespace) -> int:
    """The ``close-loop`` command: 0 whenever a verdict was reached."""
    from hybrid_dynamics.cli.logs import read_logs
    from hybrid_dynamics.cli.settings import settings_from
    from hybrid_dynamics.loop.close import close_loop
    from hybrid_dynamics.loop.model import load_model
    from hybrid_dynamics.loop.provenance import provenance_of
    from hybrid_dynamics.loop_report.output import RESULT_FILES, is_result, write_result
    from hybrid_dynamics.result_folder import check_result_folder, result_folder
    from hybrid_dynamics.robots import Robot

    console = Console.of(args)
    settings = settings_from(args.set)
    inputs = [args.robot, *args.train, *args.test, *([args.model] if args.model else [])]
    check_result_folder(args.out, RESULT_FILES, inputs, force=args.force, ours=is_result)
    robot = Robot.from_urdf(args.robot, tuple(args.lock))
    for log in args.test:
        if log.exists() and any(other.exists() and log.samefile(other) for other in args.train):
            raise InputError(f"{log}: is given to --train and to --test; held-out logs must not be learnt from")
    start = load_model(args.model, robot) if args.model else None
    notices: list[str] = []
    form = log_form(args)
    train = read_logs(args.train, robot, "train", notices, log=form)
    test = read_logs(args.test, robot, "test", notices, log=form)
    for notice in notices:
        console.note(notice)
    provenance = provenance_of(
        robot, settings, command=command_line(args), urdf=args.robot, train=args.train, test=args.test, model=args.model
    )
    with console.progress() as tell:
        result = close_loop(robot, train, test, settings, start, tell)
        tell("writing the report", 1.0)
        with result_folder(args.out, RESULT_FILES, force=args.force, ours=is_result) as folder:
            write_result(folder, result, provenance)
    _tell(console, result.diagnosis.to_json(), args.out)
    return 0


def _tell(console: Console, diagnosis: dict[str, Any], out: Path) -> None:
    from hybrid_dynamics.cli.words import details, headline, joint_rows, parameter_lines
    from hybrid_dynamics.loop_report.output import RESULT_FILES

    console.say(f"{diagnosis['robot']}: {diagnosis['verdict'].replace('_', ' ')}")
    console.say(headline(diagnosis))
    for line in details(diagnosis):
        console.say(f"  {line}")
    for line in parameter_lines(diagnosis):
        console.say(f"  {line}")
    console.table(*joint_rows(diagnosis))
    for note in diagnosis.get("notes", []):
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
