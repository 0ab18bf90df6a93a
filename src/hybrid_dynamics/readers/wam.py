"""WAM recordings of github.com/cdsousa/wam7_dyn_ident (plain text): ``rbtlog_traj*.dat``, reference ``traj*.dat``."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.readers.resample import ResampleSettings, resample
from hybrid_dynamics.readers.rows import longest_increasing, row_ranges
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array, Notify

JOINTS = 7
MAX_DROPPED = 0.01


def read_wam(
    path: str | os.PathLike[str], name: str, split: str, dt: float = 0.0, notify: Notify | None = None
) -> Trajectory:
    """A recording (columns time, q1..q7, tau1..tau7; about 1 kHz) as ``q tau`` on a uniform grid.

    Columns are separated by blanks or commas; ``#`` starts a comment. Up to 1 % of the
    rows may have a repeated stamp (reported to ``notify`` and dropped). ``dt`` [s] fixes the grid (0: median step).
    """
    values = _load(Path(path), 1 + 2 * JOINTS, "time, q1..q7, tau1..tau7")
    time = values[:, 0]
    dropped = np.setdiff1d(np.arange(len(time)), longest_increasing(time))
    if len(dropped) > MAX_DROPPED * len(time):
        raise InputError(
            f"{path}: {len(dropped)} of {len(time)} rows have a time stamp that does not exceed the one before (rows "
            f"{row_ranges(dropped + 1)}); expected at most {MAX_DROPPED:.0%}: get an undamaged copy"
        )
    if len(dropped):
        if notify is not None:
            notify(f"{name}: {len(dropped)} rows with a repeated time stamp dropped: rows {row_ranges(dropped + 1)}")
        values = np.delete(values, dropped, axis=0)
        time = values[:, 0]
    torque = values[:, 1 + JOINTS :]
    if not torque.any():
        raise InputError(f"{path}: torque columns are all zero; expected the measured joint torque [N m]")
    trajectory = Trajectory(name, split, time - time[0], {"q": values[:, 1 : 1 + JOINTS], "tau": torque})
    parts = resample(trajectory, ResampleSettings(dt=dt), notify)
    if len(parts) != 1:
        raise InputError(f"{path}: samples are missing for longer than can be interpolated; get an undamaged copy")
    return parts[0]


def read_wam_reference(path: str | os.PathLike[str]) -> Array:
    """Reference positions (T, 7) [rad] at 1 kHz."""
    return _load(Path(path), JOINTS, "q1..q7")


def _load(path: Path, columns: int, what: str) -> Array:
    try:
        text = path.read_text(encoding="ascii", errors="replace")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; run the fetch stage") from None
    lines = text.splitlines()
    if not text.strip():
        raise InputError(f"{path}: empty; expected {columns} columns: {what}")
    try:
        values = np.loadtxt(lines, delimiter="," if "," in text else None, ndmin=2)
        if values.shape[1] == columns and len(values) >= 50 and np.isfinite(values).all():
            return values
    except ValueError:
        values = np.empty((0, 0))
    raise InputError(f"{path}: {_fault(lines, columns, what)}")


def _fault(lines: list[str], columns: int, what: str) -> str:
    """The first row that is not ``columns`` finite numbers, in words."""
    count = 0
    for number, line in enumerate(lines, 1):
        fields = line.split("#")[0].replace(",", " ").split()
        if not fields:
            continue
        if len(fields) != columns:
            cut = " (the last row: the file is truncated)" if number == len(lines) else ""
            return f"row {number} has {len(fields)} columns{cut}; expected {columns}: {what}"
        for position, field in enumerate(fields, 1):
            try:
                finite = bool(np.isfinite(float(field)))
            except ValueError:
                finite = False
            if not finite:
                return f"row {number}, column {position} is {field[:20]!r}; expected a number"
        count += 1
    return f"{count} rows; expected at least 50 of {columns} columns: {what}"
