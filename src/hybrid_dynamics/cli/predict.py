"""``hybrid-dynamics predict``: torque that a completed model predicts along the motion of a log."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from hybrid_dynamics.cli.logs import LOG_HELP, read_logs
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.files import atomic_path, check_target
from hybrid_dynamics.loop.model import load_model
from hybrid_dynamics.loop.process import ProcessSettings, process
from hybrid_dynamics.robots import Robot


def add_parser(subparsers: Any) -> None:
    """Add the ``predict`` command to ``subparsers`` (of :meth:`argparse.ArgumentParser.add_subparsers`)."""
    predict = subparsers.add_parser(
        "predict",
        help="torque that a completed model predicts for a log",
        description="Predict drive torque along the motion of a log (its torque columns are not needed), at the "
        "bandwidth the loop works with. " + LOG_HELP,
    )
    predict.add_argument("--model", required=True, type=Path, help="model.json written by close-loop")
    predict.add_argument("--robot", required=True, type=Path, help="URDF of the robot")
    predict.add_argument("--data", required=True, type=Path, metavar="LOG", help="log with positions")
    predict.add_argument("--out", required=True, type=Path, help="Parquet file to write: time, tau1 ...")
    predict.add_argument("--lock", nargs="+", default=[], metavar="JOINT", help="joints fixed at zero")
    predict.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """The ``predict`` command: time and torque at the instants the processed log keeps."""
    robot = Robot.from_urdf(args.robot, tuple(args.lock))
    if args.out.suffix.lower() not in (".parquet", ".pq"):
        raise InputError(f"{args.out}: expected a file name that ends in .parquet")
    check_target(args.out, [args.data])
    model = load_model(args.model, robot)
    notices: list[str] = []
    columns: dict[str, list[Any]] = {"time": []} | {f"tau{j + 1}": [] for j in range(robot.n_joints)}
    for piece in read_logs([args.data], robot, "test", notices, torque=False):
        # Only the motion is used; `process` passes measured torque through the same filter, so it gets zeros.
        processed = process(piece.with_signals(tau=np.zeros_like(piece["q"])), robot, ProcessSettings())
        motion = processed.motion
        notices += model.outrun(motion.dq)
        tau = processed.smooth(model.predict(motion.q, motion.dq, motion.ddq, motion.time))
        columns["time"].extend(processed.time)
        for j in range(robot.n_joints):
            columns[f"tau{j + 1}"].extend(tau[:, j])
    for notice in notices:
        print(f"note: {notice}", file=sys.stderr)
    fields = [pa.field(k, pa.float64(), metadata={"unit": "s" if k == "time" else "N m"}) for k in columns]
    table = pa.Table.from_arrays([pa.array(v, pa.float64()) for v in columns.values()], schema=pa.schema(fields))
    with atomic_path(args.out) as temporary:
        pq.write_table(table, temporary, compression="zstd")
    print(f"{args.out}: {table.num_rows} rows of predicted torque [N m]")
    return 0
