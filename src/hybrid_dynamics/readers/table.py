"""A user's log, CSV, Parquet or arrays: header ``time,q1..qn[,dq1..dqn],tau1..taun``, one run a file, SI units.

Everything that makes a log unusable is refused in one line that names file, column, row (1-based, counted as a text
editor counts lines of a CSV: the header is row 1) and what was expected.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.files import atomic_path
from hybrid_dynamics.readers.columnar import ARRAYS, PARQUET, TIMES, read_columns
from hybrid_dynamics.readers.resample import ResampleSettings
from hybrid_dynamics.trajectory import UNITS, Trajectory
from hybrid_dynamics.types import Array, Notify

LAYOUT = "time,q1..qn[,dq1..dqn],tau1..taun"
#: Suffixes of tables of text.
TEXT = (".csv", ".txt", ".tsv", ".dat")
#: Share of the steps that are none from which on it is the stamps that are coarse.
COARSE_STAMPS = 0.05
MAX_STEP = 0.5
SUSPICIOUS_ANGLE = 30.0
#: Share of a column that holds nothing beyond which it is no slip, but a stream beside faster ones.
JOINED = 0.1
#: A log of few samples is too slow rather than too short below this rate [Hz].
SLOW = 10.0


def read_raw_table(
    path: str | os.PathLike[str],
    joint_names: Sequence[str],
    name: str | None = None,
    split: str = "train",
    settings: ResampleSettings | None = None,
    notify: Notify | None = None,
    torque: bool = True,
) -> Trajectory:
    """Read and check one log of a robot with joints ``joint_names``: ``q [dq] tau``, time stamps as recorded.

    Without ``torque`` its columns are neither needed nor read. Raises :class:`InputError` for whatever makes the log
    unusable; ``notify`` is told what looks odd.
    """
    file = Path(path)
    settings = settings or ResampleSettings()
    tell = notify or (lambda message: None)
    name = name if name is not None else file.stem
    table, first_row = _load(file)
    signals = _signals(table, file, joint_names, torque)
    table, begun = _streams_joined(table, signals, len(joint_names), name, tell)
    first_row += begun
    if table.num_rows < min(settings.min_rows, 2):
        raise too_few(file, np.empty(table.num_rows), settings.min_rows)
    time = _column(table, "time", file, first_row)
    check_time(time, file, first_row)
    if len(time) < settings.min_rows:
        raise too_few(file, time, settings.min_rows)
    numbers = range(1, len(joint_names) + 1)
    arrays = {
        signal: np.column_stack([_column(table, f"{signal}{j}", file, first_row) for j in numbers])
        for signal in signals
    }
    check_plausible(file, arrays, joint_names, name, tell)
    return Trajectory(name, split, time, arrays)


def _with_time(names: Sequence[str]) -> list[str]:
    """``names`` of columns with the only one that others call the time (:data:`TIMES`, in either case) as ``time``."""
    stamps = [name for name in names if name.lower() in TIMES]
    rename = len(stamps) == 1
    return ["time" if rename and name == stamps[0] else name for name in names]


def write_log(path: str | os.PathLike[str], trajectory: Trajectory, joint_names: Sequence[str]) -> None:
    """Write ``trajectory`` (its stamps as they are) as a Parquet log that :func:`read_raw_table` reads.

    Raises :class:`InputError` for a ``path`` that ends in none of :data:`PARQUET`: it would be read as something else.
    """
    if Path(path).suffix.lower() not in PARQUET:
        raise InputError(f"{path}: a log is written as Parquet; give a name that ends in .parquet")
    columns, fields = [pa.array(trajectory.time)], [pa.field("time", pa.float64(), metadata={"unit": "s"})]
    for signal in ("q", "dq", "tau"):
        if signal not in trajectory:
            continue
        for j, joint in enumerate(joint_names):
            columns.append(pa.array(np.ascontiguousarray(trajectory[signal][:, j])))
            metadata = {"unit": UNITS[signal], "joint": joint}
            fields.append(pa.field(f"{signal}{j + 1}", pa.float64(), metadata=metadata))
    with atomic_path(path) as temporary:
        pq.write_table(pa.Table.from_arrays(columns, schema=pa.schema(fields)), temporary, compression="zstd")


def too_few(path: str | os.PathLike[str], time: Array, least: int, what: str = "rows") -> InputError:
    """The complaint about a log of fewer than ``least`` samples at ``time`` [s]: it is too slow, or too short."""
    count = len(time)
    span = float(time[-1] - time[0]) if count > 1 else 0.0
    if np.isfinite(span) and span > 0 and (count - 1) / span < SLOW:
        return InputError(
            f"{path}: {count} {what} in {span:.3g} s ({(count - 1) / span:.3g} Hz); expected at least {least}: log at "
            "a higher rate, better 100 Hz or more"
        )
    return InputError(f"{path}: {count} {what}; expected at least {least}: record a longer run")


def check_plausible(
    file: str | os.PathLike[str], arrays: dict[str, Array], joint_names: Sequence[str], name: str, tell: Notify
) -> None:
    """Refuse torque that is zero throughout; say so where angles look like degrees or one joint has no torque.

    Angles that wrap (a step of almost a full turn) are unwrapped in ``arrays``, in place.
    """
    silent = ~arrays["tau"].any(axis=0) if "tau" in arrays else np.zeros(len(joint_names), bool)
    if silent.all():
        raise InputError(
            f"{file}: torque columns are all zero; expected the measured joint torque [N m]: log effort too"
        )
    for j in np.flatnonzero(silent).tolist():
        tell(f"{name}: tau{j + 1} ({joint_names[j]}) is zero throughout: nothing to learn about that joint")
    # A step of any other size is a glitch, which unwrapping would hide.
    steps = np.abs(np.clip(np.diff(arrays["q"], axis=0), -1e9, 1e9))
    wraps = (np.abs(steps - 2 * np.pi) < 0.1 * np.pi).any(axis=0) & (steps.max(axis=0, initial=0.0) < 2.1 * np.pi)
    for j in np.flatnonzero(wraps).tolist():
        arrays["q"][:, j] = np.unwrap(arrays["q"][:, j])
        tell(f"{name}: q{j + 1} ({joint_names[j]}) jumps by a full turn: unwrapped")
    for j in np.flatnonzero((np.abs(arrays["q"]).max(axis=0) > SUSPICIOUS_ANGLE) & ~wraps).tolist():
        largest = np.abs(arrays["q"][:, j]).max()
        tell(f"{name}: q{j + 1} ({joint_names[j]}) reaches {largest:.4g} rad; is it in degrees? (expected rad)")


def _load(file: Path) -> tuple[pa.Table, int]:
    """The table, and the number of its first data row as the user counts it."""
    suffix = file.suffix.lower()
    if not file.is_file():
        raise InputError(f"{file}: no such file; give the path of a CSV or Parquet log")
    if suffix in (*PARQUET, *ARRAYS):
        table = read_columns(file)
        return table.rename_columns(_with_time(table.column_names)), 1
    if suffix not in TEXT:
        raise InputError(
            f"{file}: unknown suffix {suffix!r}; expected .csv, .parquet, .npz or .mat (a bag: hybrid-dynamics import)"
        )
    return _load_csv(file), 2


def _load_csv(file: Path) -> pa.Table:
    with open(file, "rb") as stream:
        head = stream.readline(1 << 16)
    header = head.decode("utf-8-sig", errors="replace").strip()
    if not header:
        raise InputError(f"{file}: empty; expected a header line {LAYOUT}")
    # A column may well be called so.
    if head.startswith(b"PAR1") and not header.isprintable():
        raise InputError(f"{file}: a Parquet file; give it a name that ends in .parquet")
    mark = next((m for m in (",", ";", "\t") if m in header), None)
    if mark is None:
        raise InputError(f"{file}: row 1: no comma in {header[:40]!r}; expected a comma-separated header {LAYOUT}")
    names = _with_time([field.strip().strip('"') for field in header.split(mark)])
    if "time" not in names:
        raise InputError(
            f"{file}: row 1: column 'time' is missing in {header[:40]!r}; expected {LAYOUT} ({_other_time(names)})"
        )
    twice = sorted({field for field in names if names.count(field) > 1})
    if twice:
        raise InputError(f"{file}: column {twice[0]!r} stands twice in the header; expected {LAYOUT}")
    ragged: list[tuple[int, int]] = []

    def refuse(row: pacsv.InvalidRow) -> str:
        if row.text.strip():
            ragged.append((int(row.number or 0), int(row.actual_columns)))
        return "skip"

    try:
        table = pacsv.read_csv(
            file,
            # One thread, or rows are not numbered; Latin-1, so that any byte is some letter and names its column.
            read_options=pacsv.ReadOptions(use_threads=False, column_names=names, skip_rows=1, encoding="latin1"),
            parse_options=pacsv.ParseOptions(delimiter=mark, invalid_row_handler=refuse, ignore_empty_lines=False),
            convert_options=pacsv.ConvertOptions(column_types=dict.fromkeys(names, pa.string())),
        )
    except pa.ArrowException as error:
        raise InputError(f"{file}: not a readable CSV file ({str(error).splitlines()[0]}); expected {LAYOUT}") from None
    if ragged:
        number, columns = ragged[0]
        last = number == _count_rows(file)
        cut = " (the last row: the file is truncated)" if last else ""
        raise InputError(f"{file}: row {number} has {columns} columns{cut}; expected {len(names)} as in the header")
    return table.slice(0, table.num_rows - _trailing_blanks(table))


def _other_time(names: Sequence[str]) -> str:
    """What to do where none of ``names`` is the time's."""
    other = next((name for name in names if name.lower() in TIMES), None)
    return "or --columns" if other is None else f"or --columns time={other}"


def _trailing_blanks(table: pa.Table) -> int:
    """Number of empty lines at the end of a CSV file (each became a row of empty fields)."""
    count = 0
    for row in reversed(range(table.num_rows)):
        if any(column[row].as_py() for column in table.itercolumns()):
            break
        count += 1
    return count


def _count_rows(file: Path) -> int:
    with open(file, "rb") as stream:
        return sum(1 for line in stream if line.strip())


def _signals(table: pa.Table, file: Path, joint_names: Sequence[str], torque: bool) -> list[str]:
    names, n = set(table.column_names), len(joint_names)
    if "time" not in names:
        raise InputError(f"{file}: column 'time' is missing; expected {LAYOUT} ({_other_time(table.column_names)})")
    velocity = any(re.fullmatch(r"dq\d+", name) for name in names)
    signals = ["q", *(["dq"] if velocity else []), *(["tau"] if torque else [])]
    for signal in signals:
        numbers = sorted(int(name[len(signal) :]) for name in names if re.fullmatch(rf"{signal}\d+", name))
        if numbers == list(range(1, len(numbers) + 1)) and len(numbers) not in (0, n):
            first = len(numbers) + 1
            fault = (
                f"{len(numbers)} columns of {signal} ({signal}1 to {signal}{len(numbers)})"
                if first > n
                else f"column '{signal}{n}' is missing"
                if first == n
                else f"columns '{signal}{first}' to '{signal}{n}' are missing"
            )
            raise InputError(
                f"{file}: {fault}; the robot has {n} joint{'s' * (n > 1)} ({', '.join(joint_names)}): expected "
                f"{signal}1 to {signal}{n} in the URDF's order (--columns: other names; --lock: joints without a log)"
            )
        for j in range(1, n + 1):
            if j not in numbers:
                raise InputError(
                    f"{file}: column '{signal}{j}' is missing; expected {signal}1 to {signal}{n} (or --columns)"
                )
        for number in numbers:
            if not 1 <= number <= n:
                raise InputError(f"{file}: column '{signal}{number}': the robot has {n} joints, numbered from 1")
    for signal in signals:
        for j, joint in enumerate(joint_names, 1):
            noted = (table.schema.field(f"{signal}{j}").metadata or {}).get(b"joint", joint.encode()).decode()
            if noted != joint:
                raise InputError(
                    f"{file}: column '{signal}{j}' was recorded for joint {noted!r}; the robot's joint {j} is "
                    f"{joint!r}: import the log again with this URDF"
                )
    return signals


def _streams_joined(table: pa.Table, signals: Sequence[str], n: int, name: str, tell: Notify) -> tuple[pa.Table, int]:
    """``table`` with the last value where a stream has none beside others, from the row on (the second value) at which
    all have begun; ``tell`` hears of it.

    A stream has none where all columns of a signal are blank together. What is blank otherwise stays, and is refused.
    """
    begun = 0
    for signal in signals if table.num_rows else ():
        columns = [f"{signal}{j}" for j in range(1, n + 1)]
        blank = np.array([_is_blank(table.column(column)) for column in columns])
        empty = np.asarray(blank.all(axis=0))
        if not JOINED < empty.mean() < 1 or np.any(blank != empty):
            continue
        last = pa.array(np.maximum.accumulate(np.where(empty, 0, np.arange(table.num_rows))))
        for column in columns:
            k = table.column_names.index(column)
            table = table.set_column(k, table.schema.field(k), table.column(column).take(last))
        begun = max(begun, int(np.argmin(empty)))
        share = f"{empty.mean():.0%}"
        tell(f"{name}: {signal} is blank in {share} of the rows, as where streams are joined: its last value is taken")
    return table.slice(begun), begun


def _is_blank(column: pa.ChunkedArray) -> NDArray[np.bool_]:
    """(T,) where ``column`` holds nothing."""
    if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
        nothing = pc.fill_null(pc.equal(pc.utf8_trim_whitespace(column), ""), True)
        return np.asarray(nothing)
    return np.asarray(column.is_null(nan_is_null=pa.types.is_floating(column.type)))


def _column(table: pa.Table, name: str, file: Path, first_row: int) -> Array:
    return numbers_of(table.column(name), name, file, first_row)


def numbers_of(column: pa.ChunkedArray, name: str, file: str | os.PathLike[str], first_row: int) -> Array:
    """Column ``name`` as finite numbers; raises :class:`InputError` naming the first value that is none."""
    if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
        try:
            values = np.array(column.cast(pa.float64()).to_numpy(), float)
        except pa.ArrowInvalid:
            values = np.array([_number(text) for text in column.to_pylist()])
    elif pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
        values = np.array(column.cast(pa.float64()).to_numpy(zero_copy_only=False), float)
    else:
        raise InputError(f"{file}: column '{name}' holds {column.type}; expected numbers")
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        found = column[int(bad[0])].as_py()
        text = "nothing" if found is None or found == "" else repr(found) if isinstance(found, str) else str(found)
        more = f" (and {len(bad) - 1} more)" if len(bad) > 1 else ""
        comma = isinstance(found, str) and re.fullmatch(r"\s*[-+]?\d+,\d+\s*", found) is not None
        remedy = "write it with a point in the place of the comma" if comma else "remove the row or repair it"
        if text == "nothing" and len(bad) > JOINED * len(values):
            remedy = (
                "where streams were joined, fill blanks with the last value (ffill); the log is then taken at the "
                "instants of its positions"
            )
        raise InputError(
            f"{file}: column '{name}', row {bad[0] + first_row} holds {text}{more}; expected a finite number: {remedy}"
        )
    return values


def _number(text: str | None) -> float:
    try:
        # Python reads 1_0 as 10; in a table it is a slip.
        return float(text) if text is not None and "_" not in text else float("nan")
    except ValueError:
        return float("nan")


def _cure_of_stamps(steps: Array) -> str:
    """What helps against stamps whose ``steps`` (T - 1,) [s] are not all positive."""
    if (steps < 0).any() or np.mean(steps == 0) < COARSE_STAMPS:
        return "sort the rows and remove duplicates"
    coarse = "the stamps are coarser than the samples: log them finer"
    if np.mean(steps == 0) > 1 - COARSE_STAMPS:
        return f"{coarse} (seconds since the run began; 32 bits hold no seconds since 1970)"
    return f"{coarse}, or say that the samples are even: --log log.yaml with the line clock: even"


def check_time(time: Array, file: str | os.PathLike[str], first_row: int) -> None:
    """Raise :class:`InputError` unless ``time`` (T,) increases, by steps that may be seconds."""
    steps = np.diff(time)
    bad = np.flatnonzero(steps <= 0)
    if len(bad):
        k = int(bad[0])
        fault = "repeats" if steps[k] == 0 else "goes back from"
        more = f" (and {len(bad) - 1} more)" if len(bad) > 1 else ""
        raise InputError(
            f"{file}: column 'time', row {k + 1 + first_row}: {time[k + 1]:.9g} s {fault} {time[k]:.9g} s of the row "
            f"before{more}; expected strictly increasing time stamps: {_cure_of_stamps(steps)}"
        )
    step = float(np.median(steps))
    if step > MAX_STEP:
        raise InputError(
            f"{file}: column 'time': the median step is {step:g} s; expected seconds, at most {MAX_STEP} s a step "
            "(is it in milliseconds or nanoseconds? --units ms or --units ns says so)"
        )
