"""``hybrid-dynamics check``: what is in the logs and whether they fit the robot, before anything is fitted."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid_dynamics.cli.console import Console
from hybrid_dynamics.cli.options import LOG_HELP, add_command, add_log_form, add_robot, log_form

if TYPE_CHECKING:
    from hybrid_dynamics.check import Checked, Finding
    from hybrid_dynamics.loop import Model
    from hybrid_dynamics.readers.description import LogDescription
    from hybrid_dynamics.robots import Robot

SHOWN = {"hard": "WRONG", "warning": "doubtful", "note": "note"}


def add_parser(subparsers: Any) -> None:
    """Add the ``check`` command to ``subparsers`` (of :meth:`argparse.ArgumentParser.add_subparsers`)."""
    parser = add_command(
        subparsers,
        "check",
        run,
        short="say what is in the logs and whether they fit the robot, before any fit",
        long="Rates, gaps and glitches; limits; velocity against position; torque against motion (sign, unit, order of "
        "the joints, mounting, delay); what the motion can show. One line a finding, worst first; exit code 2 where "
        "close-loop would refuse the logs, or predict with --model. What has one clear cure is printed as the log.yaml "
        "that mends it. " + LOG_HELP,
        example="hybrid-dynamics check --robot robot.urdf --data a.csv b.csv",
    )
    add_robot(parser)
    add_log_form(parser)
    parser.add_argument(
        "--data", required=True, nargs="+", action="extend", type=Path, metavar="LOG", help="logs to look at"
    )
    parser.add_argument(
        "--test", nargs="+", action="extend", type=Path, default=[], metavar="LOG", help="logs that are to be held out"
    )
    parser.add_argument(
        "--model",
        type=Path,
        metavar="FILE",
        help="look at every log as predict does (not as close-loop does) against this model.json: what it holds is no "
        "fault of the log",
    )
    parser.add_argument(
        "--apply-suggestion",
        type=Path,
        metavar="FILE",
        help="write a log.yaml that mends what has one clear cure, for --log; what it mends is told",
    )
    parser.add_argument("--force", action="store_true", help="replace the log.yaml where it exists")


def run(args: argparse.Namespace) -> int:
    """The ``check`` command: 0 where the logs can be used, 2 where they cannot."""
    from hybrid_dynamics.check.findings import merged
    from hybrid_dynamics.check.suggestion import combined
    from hybrid_dynamics.cli.suggestion import read_plain, write_description
    from hybrid_dynamics.errors import InputError
    from hybrid_dynamics.files import check_once, check_target
    from hybrid_dynamics.robots import Robot

    console = Console.of(args)
    robot = Robot.from_urdf(args.robot, tuple(args.lock))
    if args.apply_suggestion is not None and args.apply_suggestion.exists() and not args.force:
        raise InputError(f"{args.apply_suggestion}: exists; give another file for the suggestion, or --force")
    if args.model is not None and args.test:
        raise InputError("--test: nothing is held out where a model is given; give all logs to --data")
    if args.apply_suggestion is not None:
        inputs = [*args.data, *args.test, args.robot, *([] if args.model is None else [args.model])]
        check_target(args.apply_suggestion, inputs)
    check_once(args.data, "--data")
    check_once(args.test, "--test")
    model = None
    if args.model is not None:
        from hybrid_dynamics.loop import load_model  # a tenth of a second to import

        model = load_model(args.model, robot)
    findings = look(robot, model, args.data, args.test, log_form(args))
    hard = _tell(console, findings)
    description, told = combined(read_plain(args), findings, robot.joint_names)
    result: dict[str, Any] = {
        "status": "ok" if hard == 0 else "refused",
        "command": "check",
        "robot": robot.name,
        "hard": hard,
        "findings": [f.to_json() for f in findings],
        "suggestion": merged(f.suggestion for f in findings if f.severity != "note"),
        "log": description if told else {},
    }
    if args.apply_suggestion is None:
        _show(console, description, told)
    elif not told:
        console.note("nothing here has one clear cure: no log.yaml is written")
    else:
        form = write_description(args.apply_suggestion, description, told)
        for line in told:
            console.say(f"{args.apply_suggestion}: {line}")
        again = look(robot, model, args.data, args.test, form)
        hard = sum(f.severity == "hard" for f in again)
        for finding in again:
            if finding.severity == "hard":
                console.note(f"still wrong with it: {finding.line}")
        console.say(f"with --log {args.apply_suggestion} " + ("nothing is wrong" if not hard else "logs are refused"))
        result |= {"written": str(args.apply_suggestion), "mended": told, "hard_with_it": hard}
    console.result(result)
    if hard:
        asked = "close-loop" if model is None else "predict"
        print(f"error: {hard} finding{'s' * (hard > 1)} for which {asked} refuses these logs", file=sys.stderr)
    return 2 if hard else 0


def _show(console: Console, description: dict[str, Any], told: list[str]) -> None:
    """Print what has one clear cure as the ``log.yaml`` that mends it."""
    from hybrid_dynamics.cli.suggestion import as_yaml

    if told:
        console.say("what has one clear cure, as a log.yaml (--apply-suggestion FILE writes it, --log FILE reads it):")
        for line in as_yaml(description, told).splitlines():
            console.say(f"    {line}")


def look(
    robot: Robot, model: Model | None, data: list[Path], test: list[Path], form: LogDescription | None
) -> list[Finding]:
    """All findings on the logs, worst first: as close-loop looks at them or, where ``model`` is given, as predict."""
    from hybrid_dynamics.check import checked, checked_log
    from hybrid_dynamics.check.clipped import check_clipped
    from hybrid_dynamics.check.content import check_content
    from hybrid_dynamics.check.excitation import check_excitation
    from hybrid_dynamics.check.findings import Finding, ordered
    from hybrid_dynamics.cli.predict import read_motion_log
    from hybrid_dynamics.readers.log import as_logged, pieces_of, read_raw, with_weight

    found: list[Finding] = []
    runs: dict[str, list[Any]] = {"train": [], "test": []}
    paths = [*data, *test]
    stems = [p.stem for p in paths]
    for k, path in enumerate(paths):
        split = "train" if k < len(data) else "test"
        name = path.stem if stems.count(path.stem) == 1 else str(path)
        notices: list[str] = []
        if model is not None:
            raw = read_motion_log(path, robot, form, notices, name)
            found += check_content(raw, robot.joint_names)
            found += [f if f.run else replace(f, run=name) for f in checked_log(model, raw, refuse=False)[1]]
        else:
            # Steps, plateaus and silence are those of what was logged: a weight on top hides them.
            raw = read_raw(path, robot, name, split, notify=notices.append, log=as_logged(form))
            found += [*check_content(raw, robot.joint_names), *check_clipped(raw, robot)]
            whole = with_weight(raw, robot, form)
            runs[split] += pieces_of(path, whole, robot.joint_names, notify=notices.append)
        found += [Finding("reading", "note", text) for text in notices]
    if model is not None:
        return ordered(found)
    result = checked(robot, runs["train"], runs["test"], refuse=False)
    # What is clipped has been told of the logs as they are, and not as they are resampled.
    found += [f for f in result.findings if f.code != "saturation"]
    if not any(f.severity == "hard" for f in found):
        found += [*check_excitation(robot, result.train), *_motion(robot, result)]
    return ordered(found)


def _motion(robot: Robot, logs: Checked) -> list[Finding]:
    """Findings where ``close-loop`` takes other speeds than the logged ones, and where it refuses the motion that is
    left of ``logs`` at its bandwidth."""
    from hybrid_dynamics.check.findings import Finding
    from hybrid_dynamics.errors import InputError, one_line
    from hybrid_dynamics.loop import LoopSettings
    from hybrid_dynamics.loop.prepare import read_motion
    from hybrid_dynamics.loop.speeds import truer_speeds

    settings = LoopSettings()
    train, test, told = truer_speeds(robot, logs.train, logs.test, settings.process)
    found = [Finding("dq_left_out", "note", line) for line in told]
    try:
        # Nothing is cut off to be held out: which runs are learnt from is not said yet.
        read_motion(robot, train, test or train, settings)
    except InputError as error:
        found.append(Finding("motion", "hard", one_line(error)))
    return found


def _tell(console: Console, findings: list[Finding]) -> int:
    """Print the table; returns the number of hard findings."""
    hard = sum(f.severity == "hard" for f in findings)
    doubtful = sum(f.severity == "warning" for f in findings)
    for f in findings:
        console.say(f"{SHOWN[f.severity]:8s}  {f.code:14s}  {f.line}")
    console.say(f"{hard} wrong, {doubtful} doubtful, {len(findings) - hard - doubtful} notes")
    return hard
