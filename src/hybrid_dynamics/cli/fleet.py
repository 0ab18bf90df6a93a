"""``hybrid-dynamics fleet``: close-loop for many robots, or for the days of one."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid_dynamics.cli.console import Console
from hybrid_dynamics.cli.options import add_command, add_log_form, add_settings, log_form

if TYPE_CHECKING:
    from hybrid_dynamics.fleet import FleetResult


def add_parser(subparsers: Any) -> None:
    """Add the ``fleet`` command to ``subparsers`` (of :meth:`argparse.ArgumentParser.add_subparsers`)."""
    parser = add_command(
        subparsers,
        "fleet",
        run,
        short="close-loop for many robots or days; resumable; one table of what changed where",
        long="Close the loop for every row of a manifest: CSV or Parquet with the columns name, robot, train and, "
        "where wanted, test, model, lock, time (several logs: a list, or ';' between them; paths start at the "
        "manifest). Each result goes to FOLDER/runs/NAME as a whole; what is done is not done again. "
        "runs.csv says what became of each, changes.csv what changed where, trends.csv how parameters go "
        "over time. Exit code 2 where a row was "
        "refused.",
        example="hybrid-dynamics fleet --manifest runs.parquet --out fleet",
    )
    add_log_form(parser)
    parser.add_argument("--manifest", required=True, type=Path, metavar="FILE", help="one row a loop")
    parser.add_argument("--out", required=True, type=Path, metavar="FOLDER", help="folder for results and tables")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes at once (default 1)")
    parser.add_argument(
        "--engine", default="local", metavar="NAME", help="local (this machine's processes, default) or dask"
    )
    parser.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler, tls://host:port (default: our own)")
    parser.add_argument(
        "--certificates", nargs=3, metavar=("CA", "CERT", "KEY"), help="PEM files for a scheduler on another machine"
    )
    parser.add_argument(
        "--part", default="1/1", metavar="K/M", help="only the K-th of every M rows, without tables (batch systems)"
    )
    add_settings(parser)
    parser.add_argument(
        "--force", action="store_true", help="put the results into --out also where it holds other files"
    )


def run(args: argparse.Namespace) -> int:
    """The ``fleet`` command: 0 where every loop reached a verdict, 2 where one was refused."""
    from hybrid_dynamics.cli.settings import settings_from
    from hybrid_dynamics.engine import engine_of
    from hybrid_dynamics.errors import ConfigError, InputError
    from hybrid_dynamics.fleet import read_manifest, run_fleet

    console = Console.of(args)
    if args.workers < 1:
        raise ConfigError(f"--workers is {args.workers}; expected 1 or more")
    settings = settings_from(args.set)
    entries = read_manifest(args.manifest)
    part = _part(args.part)
    certificates = tuple(args.certificates) if args.certificates else None
    with (
        engine_of(args.engine, args.workers, args.scheduler, certificates) as engine,
        console.progress() as progress,
    ):
        result = run_fleet(
            entries,
            args.out,
            settings,
            engine,
            progress,
            console.note,
            form=log_form(args),
            force=args.force,
            part=part,
        )
    refused = [outcome for outcome in result.outcomes if outcome.state == "refused"]
    value = {
        "status": "partial" if refused else "ok",
        "command": "fleet",
        "runs": len(result.outcomes),
        "done": result.count("done"),
        "kept": result.count("kept"),
        "refused": {outcome.name: outcome.why for outcome in refused},
    }
    if result.tables:
        value |= _tables(console, args.out, result)
    else:
        console.say(f"part {args.part}: {len(result.outcomes)} of {len(entries)} runs; the tables come without --part")
    console.result(value)
    if refused:
        more = f" and {len(refused) - 1} more" if len(refused) > 1 else ""
        line = f"refused: {refused[0].name} ({refused[0].why}){more}; the other runs are done"
        if args.json:
            console.note(line)
            return InputError.exit_code
        raise InputError(line)
    return 0


def _part(text: str) -> tuple[int, int]:
    from hybrid_dynamics.errors import ConfigError

    first, slash, step = text.partition("/")
    if not (slash and first.isdecimal() and step.isdecimal() and 1 <= int(first) <= int(step)):
        raise ConfigError(f"--part is {text!r}; expected K/M such as 3/20, the third of every 20 rows")
    return int(first), int(step)


def _tables(console: Console, out: Path, result: FleetResult) -> dict[str, Any]:
    """Tell what the tables of ``out`` say; the same for ``--json``."""
    import pandas as pd

    runs, trends = (pd.read_csv(out / f"{name}.csv") for name in ("runs", "trends"))
    verdicts = runs["verdict"].dropna().value_counts()
    told = ", ".join(f"{n} {str(v).replace('_', ' ')}" for v, n in verdicts.items())
    refused = int(runs["verdict"].isna().sum())
    told = ", ".join([*([told] if told else []), *([f"{refused} refused"] if refused else [])])
    console.say(f"{len(result.outcomes)} runs: {told}")
    moving = trends[trends["trend"].isin(["rising", "falling"])]
    for row in moving.itertuples():
        where = f" on {row.joint}" if isinstance(row.joint, str) and row.joint else ""
        console.say(
            f"  {row.trend}: {row.parameter} of {row.effect}{where}: {row.first:.4g} → {row.last:.4g} {row.unit} over "
            f"{row.runs} runs"
        )
    console.say(f"tables: {', '.join(str(path) for path in result.tables)}")
    return {
        "verdicts": {str(v): int(n) for v, n in verdicts.items()},
        "trends": json_rows(moving),
        "files": {path.stem: str(path) for path in result.tables},
    }


def json_rows(table: Any) -> list[dict[str, Any]]:
    """Rows of a data frame as JSON values."""
    return [
        {str(k): (None if v != v else v) for k, v in row.items()}  # NaN differs from itself
        for row in table.astype(object).to_dict("records")
    ]
