"""``hybrid-dynamics predict``: torque that a completed model predicts along the motion of a log."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid_dynamics.cli.console import Console
from hybrid_dynamics.cli.options import LOG_HELP, add_command, add_log_form, add_robot, log_form
from hybrid_dynamics.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

    from hybrid_dynamics.loop.prediction import Prediction
    from hybrid_dynamics.readers.description import LogDescription
    from hybrid_dynamics.robots import Robot
    from hybrid_dynamics.trajectory import Trajectory

SUFFIXES = (".parquet", ".pq", ".csv")
#: Share of the largest joint torque below which a joint's own error says nothing of the log.
SMALL = 0.01


def add_parser(subparsers: Any) -> None:
    """Add the ``predict`` command to ``subparsers`` (of :meth:`argparse.ArgumentParser.add_subparsers`)."""
    parser = add_command(
        subparsers,
        "predict",
        run,
        short="torque that a completed model predicts for a log",
        long="Predict drive torque along the motion of a log, a row for every row of it, at the loop's bandwidth; "
        "where the log has torque, the error of the prediction is told and written, and a log whose columns, signs or "
        "units cannot be those of the model's robot is refused. " + LOG_HELP,
        example="hybrid-dynamics predict --model out/model.json --robot robot.urdf --data c.csv --out c.parquet",
    )
    add_robot(parser)
    add_log_form(parser)
    parser.add_argument("--model", required=True, type=Path, metavar="FILE", help="model.json written by close-loop")
    parser.add_argument("--data", required=True, type=Path, metavar="LOG", help="log with positions")
    parser.add_argument(
        "--out",
        required=True,
        type=Path,
        metavar="FILE",
        help="file to write, .parquet or .csv: time, tau1 ..., and error1 ... where the log has torque",
    )
    parser.add_argument(
        "--effects", action="store_true", help="a column for the rigid body and for each effect too; they add up to tau"
    )
    parser.add_argument("--force", action="store_true", help="replace the file also where it is no earlier prediction")
    parser.add_argument(
        "--band",
        action="store_true",
        help="columns tau_std1 ...: standard deviation of measured minus predicted torque",
    )


def run(args: argparse.Namespace) -> int:
    """The ``predict`` command."""
    from hybrid_dynamics.check import checked_log
    from hybrid_dynamics.files import check_target
    from hybrid_dynamics.loop.model import load_model, read_model
    from hybrid_dynamics.loop.prediction import predict
    from hybrid_dynamics.loop.uncertainty import uncertainty_from
    from hybrid_dynamics.robots import Robot

    console = Console.of(args)
    if args.out.suffix.lower() not in SUFFIXES:
        raise InputError(f"{args.out}: expected a file name that ends in .parquet or .csv")
    check_target(args.out, [args.data, args.model, args.robot])
    if args.out.exists() and not args.force and not _is_prediction(args.out):
        raise InputError(
            f"{args.out}: exists and is no earlier prediction; give another name, or --force to replace it"
        )
    robot = Robot.from_urdf(args.robot, tuple(args.lock))
    model = load_model(args.model, robot)
    uncertainty = None
    if args.band:
        block = read_model(args.model).get("uncertainty")
        if block is None:
            raise InputError(f"{args.model}: holds no uncertainty (an earlier version wrote it); run close-loop again")
        uncertainty = uncertainty_from(block)
    notices: list[str] = []
    log = read_motion_log(args.data, robot, log_form(args), notices)
    log, findings = checked_log(model, log)
    notices += [f.line for f in findings]
    prediction = predict(model, log, parts=args.effects, uncertainty=uncertainty, notify=notices.append)
    left_out = int((~prediction.covered).sum())
    if left_out:
        notices.append(f"{left_out} rows stand in stretches too short to filter; they have no prediction")
    if prediction.measured is not None:
        notices += _worse_than_nothing(prediction, robot)
    for notice in dict.fromkeys(notices):
        console.note(notice)
    table = _table(prediction, robot)
    _write(args.out, table)
    console.say(f"{args.out}: {table.num_rows} rows of predicted torque [N m]")
    summary: dict[str, Any] = {
        "status": "ok",
        "command": "predict",
        "rows": table.num_rows,
        "without_prediction": left_out,
        "columns": table.column_names,
        "notes": notices,
        "files": {"prediction": str(args.out)},
    }
    if prediction.measured is not None:
        summary["error"] = _tell_error(console, prediction, robot)
    console.result(summary)
    return 0


def read_motion_log(
    path: Path, robot: Robot, form: LogDescription | None, notices: list[str], name: str | None = None
) -> Trajectory:
    """A log that a model predicts along, with its own stamps: its torque is only compared with, so one without it, or
    with one that is of no use, is read all the same and told among the ``notices``."""
    from hybrid_dynamics.errors import one_line
    from hybrid_dynamics.readers.log import read_raw

    try:
        return read_raw(path, robot, name, "test", notify=notices.append, log=form)
    except InputError as error:
        log = read_raw(path, robot, name, "test", notify=notices.append, torque=False, log=form)
        notices.append(f"no comparison with measured torque ({one_line(error)})")
        return log


def _is_prediction(path: Path) -> bool:
    """Whether ``path`` holds what this command writes (a log has positions too): asked again, it is replaced."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        if path.suffix.lower() == ".csv":
            with path.open("rb") as stream:
                names = stream.readline(1_000_000).decode("utf-8").strip().split(",")
        else:
            names = pq.read_schema(path).names
    except (OSError, UnicodeDecodeError, pa.ArrowException):
        return False
    return names[:2] == ["time", "tau1"] and not any(name.startswith("q") for name in names)


def _worse_than_nothing(prediction: Prediction, robot: Robot) -> list[str]:
    """A note where the model had better be left out: columns exchanged, another robot, or another mounting of it."""
    import numpy as np

    remedy = "is it this robot, and are the columns in order? run hybrid-dynamics check on the log"
    measured = prediction.measured_smooth
    assert measured is not None
    left = prediction.relative_error()
    if left > 1:
        return [f"the model predicts this log worse than no model at all: {left:.0%} of the torque is left; {remedy}"]
    errors, size = prediction.rmse(), np.sqrt(np.mean(measured[prediction.covered] ** 2, axis=0))
    # The same of one joint; not of one whose torque is next to nothing beside the others'.
    own = [j for j in range(len(errors)) if errors[j] > size[j] > SMALL * float(np.max(size))]
    if not own:
        return []
    shown = ", ".join(f"{errors[j] / size[j]:.0%} on {robot.joint_names[j]}" for j in own)
    return [f"the model predicts worse than no model at all on some joints: {shown} of the torque is left; {remedy}"]


def _tell_error(console: Console, prediction: Prediction, robot: Robot) -> dict[str, Any]:
    """Print the error per joint; returns it as JSON values."""
    import numpy as np

    from hybrid_dynamics.effects.units import with_unit

    smooth, raw, relative = prediction.rmse(), prediction.rmse(smooth=False), prediction.relative_rmse()
    rows = [
        [with_unit(name, robot.prismatic), f"{a:.4g}", "-" if np.isnan(r) else f"{100 * r:.3g} %", f"{b:.4g}"]
        for name, a, r, b in zip(robot.joint_names, smooth, relative, raw, strict=True)
    ]
    console.table(["error of the prediction, rmse [N m]", "filtered", "of the spread", "as recorded"], rows)
    total = prediction.relative_error()
    within = prediction.relative_error(ends=False)
    told = "" if np.isnan(within) else f"; {100 * within:.3g} % without the ends, where a filter knows one side only"
    console.say(f"all joints: {100 * total:.3g} % of the filtered torque{told}")
    return {
        "rmse": [float(v) for v in smooth],
        "relative_rmse": [None if np.isnan(v) else float(v) for v in relative],
        "relative_error": None if np.isnan(total) else total,
        "relative_error_without_ends": None if np.isnan(within) else within,
        "rmse_as_recorded": [float(v) for v in raw],
    }


def _table(prediction: Prediction, robot: Robot) -> pa.Table:
    """Columns ``time``, ``tau1 ...``, then what was asked for; a row without a prediction holds nulls."""
    import numpy as np
    import pyarrow as pa

    from hybrid_dynamics.effects.units import unit_at

    joints = robot.joint_names
    columns: dict[str, Any] = {"time": prediction.time}
    notes: dict[str, dict[str, str]] = {"time": {"unit": "s"}}

    def put(name: str, values: Any, j: int, meaning: str) -> None:
        columns[name] = values[:, j]
        notes[name] = {"unit": unit_at("N m", joints[j], robot.prismatic), "joint": joints[j], "meaning": meaning}

    numbers = range(len(joints))
    for j in numbers:
        put(f"tau{j + 1}", prediction.tau, j, "predicted torque")
    if prediction.measured_smooth is not None:
        for j in numbers:
            put(f"error{j + 1}", prediction.measured_smooth - prediction.tau, j, "measured (filtered) minus predicted")
    if prediction.band is not None:
        for j in numbers:
            put(f"tau_std{j + 1}", prediction.band, j, "standard deviation to be expected of the error")
    for part, values in prediction.parts.items():
        for j in numbers:
            # An effect of one joint has no column on the others.
            if part == "rigid_body" or np.nanmax(np.abs(values[:, j]), initial=0.0) > 0:
                put(f"tau{j + 1}_{part}", values, j, "share of the predicted torque")
    fields = [pa.field(name, pa.float64(), metadata=notes[name]) for name in columns]
    arrays = [pa.array(values, pa.float64(), from_pandas=True) for values in columns.values()]
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields))


def _write(path: Path, table: pa.Table) -> None:
    import pyarrow.csv as pacsv
    import pyarrow.parquet as pq

    from hybrid_dynamics.files import atomic_path

    with atomic_path(path) as temporary:
        if path.suffix.lower() == ".csv":
            pacsv.write_csv(table, temporary, pacsv.WriteOptions(quoting_style="none", quoting_header="none"))
        else:
            pq.write_table(table, temporary, compression="zstd")
