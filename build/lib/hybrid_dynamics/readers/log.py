"""One call for a user's log of any kind, and its conversion to a Parquet log."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.files import check_target
from hybrid_dynamics.readers.bags import BAG_SUFFIXES, read_bag
from hybrid_dynamics.readers.resample import Notify, ResampleSettings, resample
from hybrid_dynamics.readers.table import read_raw_table, write_log
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory


def read_raw(
    path: str | os.PathLike[str],
    joint_names: Sequence[str],
    name: str | None = None,
    split: str = "train",
    topic: str | None = None,
    settings: ResampleSettings | None = None,
    notify: Notify | None = None,
    torque: bool = True,
) -> Trajectory:
    """A checked log (CSV, Parquet, bag, MCAP, bag folder) with its own time stamps. Raises :class:`InputError`.

    Without ``torque`` a log needs none, and none is read.
    """
    file = Path(path)
    settings = settings or ResampleSettings()
    if not file.exists():
        raise InputError(f"{file}: no such file; give the path of a log (CSV, Parquet, bag or MCAP)")
    if file.is_dir() or file.suffix.lower() in BAG_SUFFIXES:
        trajectory = read_bag(file, joint_names, name, split, topic, notify, torque)
        if len(trajectory.time) < settings.min_rows:
            raise InputError(
                f"{file}: {len(trajectory.time)} joint states; expected at least {settings.min_rows}: "
                "record a longer run"
            )
        return trajectory
    if topic is not None:
        raise InputError(f"{file}: a table has no topics; leave out --topic {topic}, or give a bag")
    return read_raw_table(file, joint_names, name, split, settings, notify, torque)


def read_pieces(
    path: str | os.PathLike[str],
    joint_names: Sequence[str],
    name: str | None = None,
    split: str = "train",
    topic: str | None = None,
    settings: ResampleSettings | None = None,
    notify: Notify | None = None,
    torque: bool = True,
) -> list[Trajectory]:
    """A log as ``q [dq] tau`` on a uniform grid; more than one part where a gap is too long to interpolate.

    Without ``torque`` a log needs none, and none is read.
    """
    parts = resample(read_raw(path, joint_names, name, split, topic, settings, notify, torque), settings, notify)
    if not parts:
        raise InputError(
            f"{path}: no stretch of {(settings or ResampleSettings()).min_rows} rows without a gap too long to "
            "interpolate; record without losing samples"
        )
    return parts


def read_log(
    path: str | os.PathLike[str],
    joint_names: Sequence[str],
    name: str | None = None,
    split: str = "train",
    topic: str | None = None,
    settings: ResampleSettings | None = None,
    notify: Notify | None = None,
) -> Trajectory:
    """Like :func:`read_pieces` for callers that need one run: a run with a long gap is refused.

    >>> from hybrid_dynamics import Robot, read_log
    >>> robot = Robot.from_urdf("robot.urdf")
    >>> run = read_log("train_1.parquet", robot.joint_names)
    >>> sorted(run.signals), run["q"].shape
    (['q', 'tau'], (3200, 2))
    """
    parts = read_pieces(path, joint_names, name, split, topic, settings, notify)
    if len(parts) > 1:
        raise InputError(
            f"{path}: samples are missing between t = {parts[0].time[-1]:.6g} s and {parts[1].time[0]:.6g} s, "
            "too long to interpolate; split the file there"
        )
    return parts[0]


def import_log(
    robot: Robot,
    data_path: str | os.PathLike[str],
    out_path: str | os.PathLike[str],
    topic: str | None = None,
    notify: Notify | None = None,
) -> Trajectory:
    """Write the log ``data_path`` of ``robot`` to ``out_path`` as Parquet, stamps as recorded; returns its content.

    Nothing is written where the log is unusable (:class:`InputError`).
    """
    out = Path(out_path)
    if out.suffix.lower() not in (".parquet", ".pq"):
        raise InputError(f"{out}: expected a file name that ends in .parquet")
    check_target(out, [data_path])
    trajectory = read_raw(data_path, robot.joint_names, topic=topic, notify=notify)
    write_log(out, trajectory, robot.joint_names)
    return trajectory
