"""One call for a user's log of any kind, and its conversion to a Parquet log."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.files import check_target
from hybrid_dynamics.readers.bags import BAG_SUFFIXES, read_bag
from hybrid_dynamics.readers.columnar import PARQUET
from hybrid_dynamics.readers.delimited import STANDARD_INPUT
from hybrid_dynamics.readers.described import converted, read_described
from hybrid_dynamics.readers.description import COMPENSATED, LogDescription, load_description
from hybrid_dynamics.readers.glitches import repair, told
from hybrid_dynamics.readers.repeats import as_sampled
from hybrid_dynamics.readers.resample import ResampleSettings, resample, uniform_step
from hybrid_dynamics.readers.table import read_raw_table, too_few, write_log
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory, instant
from hybrid_dynamics.types import Notify


def read_raw(
    path: str | os.PathLike[str],
    robot: Robot | Sequence[str],
    name: str | None = None,
    split: str = "train",
    topic: str | None = None,
    settings: ResampleSettings | None = None,
    notify: Notify | None = None,
    torque: bool = True,
    log: LogDescription | None = None,
) -> Trajectory:
    """A checked log (CSV, Parquet, .npz, .mat, bag, MCAP, bag folder) of ``robot`` (or of joints of these names), with
    its own time stamps. Raises :class:`InputError`.

    Without ``torque`` a log needs none, and none is read. ``log`` says how it is read where it is not
    ``time,q1..qn[,dq1..dqn],tau1..taun`` in SI units (what a ``log.yaml`` holds).
    """
    run = _as_logged(path, _names(robot), name, split, topic, settings or ResampleSettings(), notify, torque, log)
    return with_weight(run, robot, log)


def _as_logged(
    path: str | os.PathLike[str],
    joint_names: Sequence[str],
    name: str | None,
    split: str,
    topic: str | None,
    settings: ResampleSettings,
    notify: Notify | None,
    torque: bool,
    log: LogDescription | None,
) -> Trajectory:
    """:func:`read_raw`, the torque as it was logged."""
    file = Path(path)
    name = name if name is not None else ("stdin" if str(path) == STANDARD_INPUT else file.stem)
    packed = str(path) == STANDARD_INPUT or file.suffix.lower() == ".gz"
    bag = file.suffix.lower() in BAG_SUFFIXES or (file.is_dir() and not (log and log.files))
    if not bag and (packed or log is not None):
        if topic is not None:
            raise InputError(f"{file}: a table has no topics; leave out --topic {topic}, or give a bag")
        tell = notify or (lambda message: None)
        return read_described(path, joint_names, log or LogDescription(), name, split, settings, tell, torque)
    if not file.exists():
        raise InputError(f"{file}: no such file; give the path of a log (CSV, Parquet, .npz, .mat, bag or MCAP)")
    if file.is_dir() or file.suffix.lower() in BAG_SUFFIXES:
        trajectory = read_bag(file, joint_names, name, split, topic, notify, torque)
        if len(trajectory.time) < settings.min_rows:
            raise too_few(file, trajectory.time, settings.min_rows, "joint states")
        return trajectory if log is None else _described_bag(file, trajectory, joint_names, log, settings, notify)
    if topic is not None:
        raise InputError(f"{file}: a table has no topics; leave out --topic {topic}, or give a bag")
    return read_raw_table(file, joint_names, name, split, settings, notify, torque)


def read_pieces(
    path: str | os.PathLike[str],
    robot: Robot | Sequence[str],
    name: str | None = None,
    split: str = "train",
    topic: str | None = None,
    settings: ResampleSettings | None = None,
    notify: Notify | None = None,
    torque: bool = True,
    log: LogDescription | None = None,
) -> list[Trajectory]:
    """A log of ``robot`` as ``q [dq] tau`` on a uniform grid; several parts where a gap is too long to interpolate.

    Without ``torque`` a log needs none, and none is read; ``log`` as in :func:`read_raw`.
    """
    run = read_raw(path, robot, name, split, topic, settings, notify, torque, log)
    return pieces_of(path, run, _names(robot), settings, notify)


def pieces_of(
    path: str | os.PathLike[str],
    run: Trajectory,
    joint_names: Sequence[str],
    settings: ResampleSettings | None = None,
    notify: Notify | None = None,
) -> list[Trajectory]:
    """``run``, as :func:`read_raw` gave it, on a uniform grid; ``path`` names it in errors."""
    run = as_sampled(run, notify)
    if uniform_step(run.time, settings or ResampleSettings()) is None:
        run = _without_glitches(run, joint_names, notify)
    parts = resample(run, settings, notify)
    if not parts:
        raise InputError(
            f"{path}: no stretch of {(settings or ResampleSettings()).min_rows} rows without a gap too long to "
            "interpolate; record without losing samples"
        )
    return parts


def read_log(
    path: str | os.PathLike[str],
    robot: Robot | Sequence[str],
    name: str | None = None,
    split: str = "train",
    topic: str | None = None,
    settings: ResampleSettings | None = None,
    notify: Notify | None = None,
    log: LogDescription | str | os.PathLike[str] | None = None,
) -> Trajectory:
    """One run of ``robot`` (or of joints with these names) as ``q [dq] tau`` on a uniform grid.

    ``log``: a ``log.yaml`` or what it holds, for logs in another form. A run with a gap too long to interpolate is
    refused (:func:`read_pieces` splits it). Raises :class:`InputError` and :class:`ConfigError`.

    >>> from hybrid_dynamics import Robot, read_log
    >>> robot = Robot.from_urdf("robot.urdf")
    >>> run = read_log("train_1.parquet", robot)
    >>> sorted(run.signals), run["q"].shape
    (['q', 'tau'], (3200, 2))
    """
    description = log if log is None or isinstance(log, LogDescription) else load_description(log)
    parts = read_pieces(path, robot, name, split, topic, settings, notify, log=description)
    if len(parts) > 1:
        last, first = instant(parts[0].time[-1]), instant(parts[1].time[0])
        raise InputError(
            f"{path}: samples are missing between t = {last} s and {first} s, too long to "
            "interpolate; split the file there"
        )
    return parts[0]


def _names(robot: Robot | Sequence[str]) -> Sequence[str]:
    return robot.joint_names if isinstance(robot, Robot) else robot


def with_weight(run: Trajectory, robot: Robot | Sequence[str], log: LogDescription | None) -> Trajectory:
    """``run``, as it was logged, with the torque of gravity that the controller added, where ``log`` says so: as the
    model of ``robot`` has it.

    A torque that never changes is none, and stays as it is. Raises :class:`ConfigError` where the robot is not given.
    """
    if log is None or log.gravity != COMPENSATED or "tau" not in run:
        return run
    if not isinstance(robot, Robot):
        raise ConfigError(
            "log.gravity is compensated; expected the robot, whose links' weight is added, not its joints"
        )
    # A position that is a slip of the bus has no weight.
    q = repair(run)[0]["q"]
    weight = robot.inverse_dynamics(q, 0.0 * q, 0.0 * q)
    return run.with_signals(tau=run["tau"] + np.where(np.ptp(run["tau"], axis=0) > 0, weight, 0.0))


def as_logged(log: LogDescription | None) -> LogDescription | None:
    """``log`` of a torque to which nothing is added."""
    return None if log is None else replace(log, gravity="included")


def _without_glitches(run: Trajectory, joint_names: Sequence[str], notify: Notify | None) -> Trajectory:
    """``run`` as it may be interpolated: a spline through a glitch would spread it over its neighbours."""
    clean, found = repair(run)
    for line in told(found, joint_names, len(run.time)):
        (notify or (lambda message: None))(f"{run.name}: {line}")
    return clean


def _described_bag(
    file: Path,
    run: Trajectory,
    joint_names: Sequence[str],
    log: LogDescription,
    settings: ResampleSettings,
    notify: Notify | None,
) -> Trajectory:
    """A bag names its signals and joints itself; units, gear, sign, clock and delays are the description's."""
    for key in ("columns", "files", "joints", "rows"):
        if getattr(log, key):
            raise InputError(f"{file}: a bag has no {key}; leave log.{key} out")
    arrays = {signal: np.array(values) for signal, values in run.signals.items()}
    tell = notify or (lambda message: None)
    return converted(file, log, joint_names, run.name, run.split, run.time, arrays, settings, tell)


def import_log(
    robot: Robot,
    data_path: str | os.PathLike[str],
    out_path: str | os.PathLike[str],
    topic: str | None = None,
    notify: Notify | None = None,
    log: LogDescription | None = None,
) -> Trajectory:
    """Write the log ``data_path`` of ``robot`` to ``out_path`` as Parquet, stamps as recorded; returns its content.

    Nothing is written where the log is unusable (:class:`InputError`).
    """
    out = Path(out_path)
    if out.suffix.lower() not in PARQUET:
        raise InputError(f"{out}: expected a file name that ends in .parquet")
    check_target(out, [data_path])
    trajectory = read_raw(data_path, robot, topic=topic, notify=notify, log=log)
    write_log(out, trajectory, robot.joint_names)
    return trajectory
