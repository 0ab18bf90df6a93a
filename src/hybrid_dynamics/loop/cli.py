"""``hybrid-dynamics close-loop`` and ``predict``: the loop on a URDF and log files, without DVC."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from yaml import YAMLError

from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.files import atomic_path, check_folder, check_target
from hybrid_dynamics.loop.close import LoopResult, close_loop
from hybrid_dynamics.loop.model import load_model
from hybrid_dynamics.loop.output import write_result
from hybrid_dynamics.loop.process import ProcessSettings, process
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.readers.log import read_pieces
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory

LOG_HELP = (
    "A LOG is CSV or Parquet with the header time,q1..qn[,dq1..dqn],tau1..taun (SI units; joints in the order of the "
    "URDF; torque is what the drive delivers, positive along the joint axis), or a ROS bag or MCAP with JointState."
)


def add_parsers(subparsers: Any) -> None:
    """Add the two subcommands; each sets ``run``."""
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
    close.set_defaults(run=run_close_loop)

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
    predict.set_defaults(run=run_predict)


def settings_from(pairs: Sequence[str]) -> LoopSettings:
    """Settings from ``name=value`` pairs; :class:`ConfigError` names what is unknown or of the wrong type."""
    values: dict[str, Any] = {}
    for pair in pairs:
        name, sign, text = pair.partition("=")
        if not sign:
            raise ConfigError(f"--set {pair}: expected NAME=VALUE")
        values[name] = _value(name, text)
    if "process" in values:
        raise ConfigError("--set process: is a group; set one value of it, such as process.cutoff=25")
    own = {k: v for k, v in values.items() if not k.startswith("process.")}
    process_values = {k.removeprefix("process."): v for k, v in values.items() if k.startswith("process.")}
    process_settings = _typed(ProcessSettings, process_values)
    return _typed(LoopSettings, {**own, "process": process_settings})


def _value(name: str, text: str) -> Any:
    try:
        value = OmegaConf.to_container(OmegaConf.from_dotlist([f"value={text}"]))
    except (OmegaConfBaseException, YAMLError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"--set {name}={text}: cannot be read ({reason}); expected such as 1 or [0, 1]") from None
    assert isinstance(value, dict)
    return value["value"]


def _typed(cls: type, values: dict[str, Any]) -> Any:
    defaults = cls()
    for name, value in values.items():
        if name not in vars(defaults):
            known = ", ".join(k for k in vars(defaults) if k != "process")
            raise ConfigError(f"setting {name!r} is unknown; known are {known}")
        default = getattr(defaults, name)
        if isinstance(default, tuple):
            if not isinstance(value, list | tuple):
                raise ConfigError(f"{name} is {value!r}; expected a list such as [0, 0.05]")
            values[name] = tuple(value)
            if any(isinstance(v, str) != (name == "effects") for v in value):
                raise ConfigError(
                    f"{name} is {value!r}; expected a list of {'names' if name == 'effects' else 'numbers'}"
                )
        elif isinstance(default, int | float):
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ConfigError(f"{name} is {value!r}; expected a number")
            if isinstance(default, int) and value != int(value):
                raise ConfigError(f"{name} is {value!r}; expected a whole number")
            values[name] = type(default)(value)
    return cls(**values)


def run_close_loop(args: argparse.Namespace) -> int:
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
    train = _read(args.train, robot, "train", notices)
    test = _read(args.test, robot, "test", notices)
    for notice in notices:
        console.print(f"note: {notice}", style="yellow", highlight=False, markup=False, soft_wrap=True)
    with _progress(console) as tell:
        result = close_loop(robot, train, test, settings, start, tell)
        tell("writing the report", 1.0)
        write_result(args.out, result)
    _summary(Console(), result, args.out)
    return 0


def run_predict(args: argparse.Namespace) -> int:
    """The ``predict`` command: time and torque at the instants the processed log keeps."""
    robot = Robot.from_urdf(args.robot, tuple(args.lock))
    if args.out.suffix.lower() not in (".parquet", ".pq"):
        raise InputError(f"{args.out}: expected a file name that ends in .parquet")
    check_target(args.out, [args.data])
    model = load_model(args.model, robot)
    notices: list[str] = []
    columns: dict[str, list[Any]] = {"time": []} | {f"tau{j + 1}": [] for j in range(robot.n_joints)}
    for piece in _read([args.data], robot, "test", notices, torque=False):
        # Only the motion is used; `process` passes measured torque through the same filter, so it gets zeros.
        run = process(piece.with_signals(tau=np.zeros_like(piece["q"])), robot, ProcessSettings())
        motion = run.motion
        notices += model.outrun(motion.dq)
        tau = run.smooth(model.predict(motion.q, motion.dq, motion.ddq, motion.time))
        columns["time"].extend(run.time)
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


def _read(paths: Sequence[Path], robot: Robot, split: str, notices: list[str], torque: bool = True) -> list[Trajectory]:
    """All logs; a log with long gaps gives several runs. Names are file names, made distinct where they repeat."""
    out: list[Trajectory] = []
    stems = [p.stem for p in paths]
    for path in paths:
        name = path.stem if stems.count(path.stem) == 1 else str(path)
        out += read_pieces(path, robot.joint_names, f"{split}:{name}", split, notify=notices.append, torque=torque)
    return out


@contextmanager
def _progress(console: Console) -> Iterator[Callable[[str, float], None]]:
    """Yield ``tell(stage, share)``: a bar on a terminal, a line a stage elsewhere (logs, CI)."""
    if not console.is_terminal:
        said = ""

        def line(stage: str, share: float) -> None:
            nonlocal said
            if stage != said:
                said = stage
                console.print(f"{share:4.0%} {stage}", highlight=False, markup=False, soft_wrap=True)

        yield line
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("reading the logs", total=1.0)
        yield lambda stage, share: bar.update(task, description=stage, completed=share)


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
