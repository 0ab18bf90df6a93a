"""Logs as a :class:`~hybrid_dynamics.readers.description.LogDescription` says they are: columns, units, gear, clock.

Order of what happens to the numbers: rows, units, gear (motor to joint side), sign, gain and offset per joint, clock,
delays, decimation.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import firwin, upfirdn

from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.readers.clock import even_stamps, stamps_from_velocity
from hybrid_dynamics.readers.columnar import ARRAYS, PARQUET, read_columns
from hybrid_dynamics.readers.delimited import STANDARD_INPUT, read_delimited
from hybrid_dynamics.readers.description import SIGNALS, STACKED, LogDescription
from hybrid_dynamics.readers.resample import ResampleSettings, uniform_step
from hybrid_dynamics.readers.table import check_plausible, check_time, numbers_of, too_few
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array, Notify

#: Taps of the low-pass before decimation, per kept sample, on each side.
TAPS = 8


def read_described(
    path: str | os.PathLike[str],
    joint_names: Sequence[str],
    description: LogDescription,
    name: str,
    split: str,
    settings: ResampleSettings,
    notify: Notify,
    torque: bool = True,
) -> Trajectory:
    """One run ``q [dq] [tau]`` in SI units, joint side, URDF order; the time stamps as recorded or as repaired.

    Raises :class:`InputError` naming file, column and row for what cannot be read.
    """
    _silent(description, joint_names)
    wanted = _wanted(description, torque)
    tables: dict[str, tuple[pa.Table, int]] = {}
    columns: dict[str, Array] = {}
    for signal in wanted:
        file = _file_of(path, description, signal)
        if file not in tables:
            tables[file] = _table(file, description)
        found = _columns(*tables[file], file, signal, description, joint_names)
        if found is not None:
            columns[signal] = found
    lengths = {signal: len(values) for signal, values in columns.items()}
    if len(set(lengths.values())) > 1:
        counts = ", ".join(f"{count} of {signal}" for signal, count in lengths.items())
        raise InputError(f"{path}: {counts} samples; expected as many of each: give files of the same run")
    if description.rows:
        first, last = description.rows
        if last > lengths["q"]:
            raise InputError(f"{path}: rows {first} to {last} asked for; it holds {lengths['q']} samples")
        columns = {signal: values[first - 1 : last] for signal, values in columns.items()}
    if len(columns["q"]) < settings.min_rows:
        count = np.arange(len(columns["q"]))
        stamps = columns["time"] * description.unit("time") if "time" in columns else count / (description.rate or 1e3)
        raise too_few(path, stamps, settings.min_rows)
    time = columns.pop("time") * description.unit("time") if "time" in columns else None
    arrays = {"tau" if s == "tau_commanded" else s: values for s, values in columns.items()}
    return converted(path, description, joint_names, name, split, time, arrays, settings, notify)


def converted(
    path: str | os.PathLike[str],
    description: LogDescription,
    joint_names: Sequence[str],
    name: str,
    split: str,
    time: Array | None,
    arrays: dict[str, Array],
    settings: ResampleSettings,
    notify: Notify,
) -> Trajectory:
    """The run with ``arrays`` (T, n) (in the log's units, columns in URDF order) brought to SI units and joint side."""
    n = len(joint_names)
    arrays = {signal: values * description.unit(signal) for signal, values in arrays.items()}
    if "tau" in arrays and description.torque_constant:
        arrays["tau"] = arrays["tau"] * _per_joint(description.torque_constant, n, "torque_constant")
    if time is None:
        if not description.rate:
            raise InputError(f"{path}: no column 'time'; give log.columns.time, or log.rate [Hz]")
        time = np.arange(len(arrays["q"])) / description.rate
    silent = _silent(description, joint_names)
    arrays = _joint_side(description, arrays, silent)
    for signal, values in arrays.items():
        sign, gain, offset = (getattr(getattr(description, key), signal) for key in ("sign", "gain", "offset"))
        values *= _per_joint(sign, n, f"sign.{signal}", 1.0) * _per_joint(gain, n, f"gain.{signal}", 1.0)
        values += _per_joint(offset, n, f"offset.{signal}", 0.0)
    if description.clock == "even":
        time = even_stamps(time)
    elif description.clock == "velocity":
        if "dq" not in arrays:
            raise InputError(f"{path}: clock: velocity needs a velocity; give log.columns.dq, or clock: recorded")
        time, rows = stamps_from_velocity(
            name, time, arrays["q"], arrays["dq"], description.tick, description.velocity_delay, notify
        )
        arrays = {signal: values[rows] for signal, values in arrays.items()}
    if "tau" in arrays:
        arrays["tau"][:, silent] = 0.0
    check_time(time, path, 1)
    check_plausible(path, arrays, joint_names, name, notify)
    for signal in description.drop:
        arrays.pop(signal, None)
    run = Trajectory(name, split, time, arrays)
    for signal, delay in (("tau", description.torque_delay), ("dq", description.velocity_delay)):
        if delay and signal in run:
            run = _earlier(run, signal, delay)
    return decimated(run, description.decimate, settings) if description.decimate > 1 else run


def decimated(run: Trajectory, factor: int, settings: ResampleSettings) -> Trajectory:
    """Every ``factor``-th sample of an evenly sampled ``run``, behind a zero-phase FIR low-pass against aliasing.

    Hamming window, -6 dB at 0.8 of the new Nyquist frequency. Raises :class:`InputError` for uneven stamps.
    """
    dt = uniform_step(run.time, settings)
    if dt is None:
        raise InputError(f"{run.name}: time stamps are uneven; decimate needs even ones: clock: even, or decimate: 1")
    half = TAPS * factor
    if len(run.time) <= 2 * half:
        raise InputError(f"{run.name}: {len(run.time)} rows; expected more than {2 * half} to keep every {factor}th")
    taps = firwin(2 * half + 1, 0.8 / factor)

    def low_pass(x: Array) -> Array:
        # Odd reflection at the ends: value and slope go on, where padding by zeros would make a step.
        before, after = 2 * x[:1] - x[half:0:-1], 2 * x[-1:] - x[-2 : -half - 2 : -1]
        padded = np.concatenate([before, x, after])
        count = (len(x) + factor - 1) // factor
        return np.asarray(upfirdn(taps, padded, down=factor, axis=0))[2 * TAPS : 2 * TAPS + count]

    return Trajectory(run.name, run.split, run.time[::factor], {s: low_pass(v) for s, v in run.signals.items()})


def _wanted(description: LogDescription, torque: bool) -> list[str]:
    tau = "tau_commanded" if description.torque == "commanded" else "tau"
    return ["time", "q", "dq", *([tau] if torque else [])]


def _file_of(path: str | os.PathLike[str], description: LogDescription, signal: str) -> str:
    """The file that holds ``signal``."""
    pattern = description.files.get(signal)
    if pattern is None and description.files:
        pattern = description.files.get("tau" if signal == "tau_commanded" else "q")
    if pattern is None:
        return str(path)
    place = Path(path)
    file = place.parent / pattern.replace("{run}", place.name) if "{run}" in pattern else place / pattern
    if not file.is_file():
        raise InputError(f"{file}: no such file (log.files.{signal} for the run {path}); correct the path or log.files")
    return str(file)


def _table(file: str, description: LogDescription) -> tuple[pa.Table, int]:
    if file != STANDARD_INPUT and Path(file).suffix.lower() in (*PARQUET, *ARRAYS):
        return read_columns(Path(file)), 1
    return read_delimited(file, description.delimiter, description.header, description.skip_rows)


def _columns(
    table: pa.Table, first_row: int, file: str, signal: str, description: LogDescription, joint_names: Sequence[str]
) -> Array | None:
    """``signal`` as (T, n), the time as (T,), columns in URDF order; None where it is optional and not there."""
    spec = description.columns.get(signal)
    n = len(joint_names)
    if signal == "time":
        if spec is None and (description.rate or "time" not in table.column_names):
            return None
        names = _names("time" if spec is None else spec, signal, 1, ("",))
        return numbers_of(_pick(table, names[0], file, signal), names[0], file, first_row)
    optional = signal == "dq" and spec is None
    if spec == STACKED:
        values = numbers_of(table.column(0), table.column_names[0], file, first_row)
        if len(values) % n:
            raise InputError(f"{file}: {len(values)} numbers of {signal}; expected a multiple of the {n} joints")
        out = values.reshape(-1, n)
    else:
        order = tuple(description.joints) or tuple(joint_names)
        spec = f"{signal}{{i}}" if spec is None else spec
        none = description.no_torque if signal.startswith("tau") else ()
        # A list may leave them out.
        listed: Sequence[str] = [joint for joint in order if joint not in none] if "{" not in str(spec) else order
        if isinstance(spec, list) and len(spec) == n:
            listed = order
        name_of = dict(zip(listed, _names(spec, signal, len(listed), listed), strict=True))
        if optional and name_of[order[0]] not in table.column_names:
            return None
        out = np.zeros((table.num_rows, n))
        for k, joint in enumerate(order):
            if joint not in none:
                name = name_of[joint]
                out[:, k] = numbers_of(_pick(table, name, file, signal), name, file, first_row)
    return out[:, _order(description.joints, joint_names)]


def _names(spec: object, signal: str, n: int, joints: Sequence[str]) -> list[str]:
    """Column names that ``spec`` stands for, in the order of the log's columns."""
    key = f"log.columns.{signal}"
    if isinstance(spec, list):
        names = [str(entry) for entry in spec]
    elif match := re.fullmatch(r"(\d+)-(\d+)", str(spec)):
        names = [str(k) for k in range(int(match[1]), int(match[2]) + 1)]
    elif any(mark in str(spec) for mark in ("{i}", "{i0}", "{joint}")):
        names = [
            str(spec).replace("{i}", str(k + 1)).replace("{i0}", str(k)).replace("{joint}", joints[k]) for k in range(n)
        ]
    else:
        names = [str(spec)]
    if len(names) != n:
        what = "one column" if signal == "time" else f"{n} columns, one a joint, such as {signal}{{i}}"
        raise ConfigError(f"{key} is {spec!r}: {len(names)} columns; expected {what}")
    return names


def _pick(table: pa.Table, name: str, file: str, signal: str) -> pa.ChunkedArray:
    if name not in table.column_names:
        held = ", ".join(table.column_names[:8]) + (", ..." if len(table.column_names) > 8 else "")
        raise InputError(
            f"{file}: column {name!r} of {signal} is missing; it holds {held}: correct log.columns.{signal}"
        )
    return table.column(name)


def _silent(description: LogDescription, joint_names: Sequence[str]) -> NDArray[np.bool_]:
    """(n,) joints whose torque nobody measured; :class:`ConfigError` for one that the robot does not have."""
    for joint in description.no_torque:
        if joint not in joint_names:
            raise ConfigError(f"log.no_torque holds {joint!r}; expected joints of the robot: {', '.join(joint_names)}")
    return np.array([name in description.no_torque for name in joint_names])


def _order(joints: Sequence[str], joint_names: Sequence[str]) -> list[int]:
    """Where each joint of the robot stands among the log's ``joints``."""
    if not joints:
        return list(range(len(joint_names)))
    if sorted(joints) != sorted(joint_names):
        raise ConfigError(f"log.joints is {', '.join(joints)}; expected the robot's joints {', '.join(joint_names)}")
    return [list(joints).index(name) for name in joint_names]


def _per_joint(values: Sequence[float], n: int, key: str, default: float = 1.0) -> Array:
    if not values:
        return np.full(n, default)
    if len(values) not in (1, n):
        raise ConfigError(
            f"log.{key} has {len(values)} values; expected {n}, one a joint in URDF order, or one for all"
        )
    return np.broadcast_to(np.array(values, float), (n,))


def _joint_side(description: LogDescription, arrays: dict[str, Array], silent: NDArray[np.bool_]) -> dict[str, Array]:
    """Motor = R joint for positions and velocities; equal power on both sides gives tau_joint = R' tau_motor."""
    if not description.motor_side:
        return arrays
    n = len(silent)
    if description.gear_matrix:
        rows = description.gear_matrix
        if len(rows) != n or any(len(row) != n for row in rows):
            raise ConfigError(
                f"log.gear_matrix is {len(rows)} x {len(rows[0])}; expected {n} x {n}, joints in URDF order"
            )
        gear = np.array(rows, float)
    else:
        gear = np.diag(_per_joint(description.gear_ratio, n, "gear_ratio"))
    if np.linalg.cond(gear) > 1e8:
        raise ConfigError("log.gear_matrix cannot be inverted; expected motor = gear_matrix joint")
    if "tau" in description.motor_side and np.any(gear[silent][:, ~silent]):
        raise ConfigError(
            f"log.no_torque holds {', '.join(description.no_torque)}, whose motor turns other joints, too "
            "(log.gear_matrix); expected also these joints, of whose torque a part is missing"
        )
    out = dict(arrays)
    for signal in SIGNALS:
        if signal in description.motor_side and signal in arrays:
            out[signal] = arrays[signal] @ gear if signal == "tau" else np.linalg.solve(gear, arrays[signal].T).T
    return out


def _earlier(run: Trajectory, signal: str, delay: float) -> Trajectory:
    """``run`` with ``signal``, recorded ``delay`` [s] late, at its own time; rows without a partner are left out."""
    later = CubicSpline(run.time, run[signal])(run.time + delay)
    known = (run.time + delay >= run.time[0]) & (run.time + delay <= run.time[-1])
    if known.sum() < 2:
        raise InputError(
            f"{run.name}: lasts {run.time[-1] - run.time[0]:.3g} s; expected more than the delay {delay:g} s"
        )
    return run.with_signals(**{signal: later}).rows(known)
