"""``hybrid-dynamics close-loop``: the loop on a URDF and log files, without DVC."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from hybrid_dynamics.cli.logs import LOG_HELP, read_logs
from hybrid_dynamics.cli.settings import settings_from
from hybrid_dynamics.cli.terminal import progress
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.files import check_folder, check_target
from hybrid_dynamics.loop.close import LoopResult, close_loop
from hybrid_dynamics.loop.model import load_model
from hybrid_dynamics.loop_report.output import write_result
from hybrid_dynamics.robots import Robot


def add_parser(subparsers: Any) -> None:
    """Add the ``close-loop`` command to ``subparsers`` (of :meth:`argparse.ArgumentParser.add_subparsers`)."""
    close = subparsers.add_parser(
        "close-loop",
        help="name the physical effects a robot model lacks, add them, report before and after",
        description="Trace what the model lacks on the training logs, add it, prove it on the test logs. " + LOG_HELP,
    )
    close.add_argument("--robot", required=True, type=Path, help="URDF of the robot")
    close.add_argument("--train", required=True, nargs="+", type=Path, metavar="LOG", help="logs to learn from")
    close.add_argument(
        "--test",
        nargs="+",
        type=Path,
        default=[],
        metavar="LOG",
        help="logs held out (default: end of each training log)",
    )
    close.add_argument("--out", required=True, type=Path, help="folder for diagnosis.json, model.json, report.html")
    close.add_argument("--model", type=Path, help="start from this model.json instead of the URDF alone")
    close.add_argument("--lock", nargs="+", default=[], metavar="JOINT", help="joints fixed at zero (not in the logs)")
    close.add_argument(
        "--set", nargs="+", default=[], metavar="NAME=VALUE", help="settings, such as sign_widths=[0,0.05] or block=1"
    )
    close.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """The ``close-loop`` command: 0 whenever a verdict was reached."""
    console = Console(stderr=True)
    settings = settings_from(args.set)
    robot = Robot.from_urdf(args.robot, tuple(args.lock))
    check_folder(args.out)
    if args.model:
        check_target(args.out / "model.json", [args.model])
    for log in args.test:
        if log.exists() and any(other.exists() and log.samefile(other) for other in args.train):
            raise InputError(f"{log}: is given to --train and to --test; held-out logs must not be learnt from")
    start = load_model(args.model, robot) if args.model else None
    notices: list[str] = []
    train = read_logs(args.train, robot, "train", notices)
    test = read_logs(args.test, robot, "test", notices)
    for notice in notices:
        console.print(f"note: {notice}", style="yellow", highlight=False, markup=False, soft_wrap=True)
    with progress(console) as tell:
        result = close_loop(robot, train, test, settings, start, tell)
        tell("writing the report", 1.0)
        write_result(args.out, result)
    _summary(Console(), result, args.out)
    return 0


def _summary(console: Console, result: LoopResult, out: Path) -> None:
    diagnosis = result.diagnosis
    console.print(f"{diagnosis['robot']}: {diagnosis['verdict'].replace('_', ' ')}", style="bold", highlight=False)
    for entry in diagnosis["effects"]:
        values = ", ".join(
            f"{p['name']} {p['value']:.4g} ± {p['std_error']:.2g} {p['unit']}" for p in entry["parameters"][:4]
        )
        where = entry["joints"][0] if entry["joints"] else "whole robot"
        console.print(f"  {entry['effect']} ({where}): {values}", highlight=False, markup=False)
    table = Table("joint", "held-out rmse before [N m]", "after", "noise floor")
    before, after = (diagnosis["error"]["test"][k]["rmse"] for k in ("before", "after"))
    for name, a, b, f in zip(diagnosis["joints"], before, after, diagnosis["noise_floor"], strict=True):
        table.add_row(name, f"{a:.4g}", f"{b:.4g}", f"{f:.4g}")
    console.print(table)
    for note in diagnosis["notes"]:
        console.print(f"note: {note}", highlight=False, markup=False, soft_wrap=True)
    console.print(f"report: {out / 'report.html'}", highlight=False, markup=False, soft_wrap=True)
