"""The data that travels between stages: one robot run, and the Parquet table that holds many of them.

Columns are numbered from 1 in the robot's joint order (``q1 dq1 ddq1 dddq1 tau1 ...``); units stand in the schema
metadata of every field. One row group holds one trajectory, so a reader never needs more than one in memory.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.files import atomic_path
from hybrid_dynamics.types import Array


def instant(seconds: float) -> str:
    """A time stamp [s] as a person finds it in the log, to a millisecond: the clock of many logs counts from 1970, and
    of ten digits the first four say nothing."""
    return f"{round(seconds, 3) + 0.0:.3f}".rstrip("0").rstrip(".")


UNITS: Mapping[str, str] = MappingProxyType(
    {
        "time": "s",
        "q": "rad",
        "dq": "rad/s",
        "ddq": "rad/s^2",
        "dddq": "rad/s^3",
        "tau": "N m",
        "tau_inertia": "N m",
        "tau_coriolis": "N m",
        "tau_gravity": "N m",
        "q_ref": "rad",
        "dq_ref": "rad/s",
    }
)
SIGNALS = tuple(name for name in UNITS if name != "time")
RECORDED = "recorded"
SIMULATED = "simulated"
SIMULATED_TWIN = "simulated twin"
#: Provenance of a dataset without a twin whose recording cannot be had: it is left out.
ABSENT = "absent"


@dataclass(frozen=True)
class Trajectory:
    """One run of a robot with n joints, T samples.

    ``time`` is (T,) [s]; ``signals`` maps ``q dq ddq dddq tau tau_inertia tau_coriolis tau_gravity q_ref dq_ref``
    (those that are known) to (T, n) arrays in SI units. ``split`` is ``train`` or ``test``. ``began`` [s]: the time
    stamp at which the run did of which this is a piece, and ``whole`` the name of that run; None: this is no piece.
    """

    name: str
    split: str
    time: Array
    signals: Mapping[str, Array] = field(default_factory=dict)
    began: float | None = None
    whole: str | None = None

    def __post_init__(self) -> None:
        if self.split not in ("train", "test"):
            raise InputError(f"trajectory {self.name}: split is {self.split!r}; expected 'train' or 'test'")
        shapes = {name: value.shape for name, value in self.signals.items()}
        unknown = sorted(set(shapes) - set(SIGNALS))
        if unknown:
            raise InputError(f"trajectory {self.name}: unknown signal {unknown[0]!r}; known are {', '.join(SIGNALS)}")
        expected = (len(self.time), self.n_joints)
        for name, shape in shapes.items():
            if shape != expected:
                raise InputError(f"trajectory {self.name}: {name} has shape {shape}; expected {expected}")

    @property
    def n_joints(self) -> int:
        """Number of joints; 0 without signals."""
        return next(iter(self.signals.values())).shape[1] if self.signals else 0

    @property
    def dt(self) -> float:
        """Median sampling interval [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def start(self) -> float:
        """Time stamp [s] of the run's beginning, also of a piece of it."""
        if self.began is not None:
            return self.began
        return float(self.time[0]) if len(self.time) else 0.0

    @property
    def duration(self) -> float:
        """[s] from the first sample to the last."""
        return float(self.time[-1] - self.time[0]) if len(self.time) else 0.0

    @property
    def whole_name(self) -> str:
        """Name of the run, also of a piece of it."""
        return self.name if self.whole is None else self.whole

    def __getitem__(self, signal: str) -> Array:
        try:
            return self.signals[signal]
        except KeyError:
            raise InputError(
                f"trajectory {self.name}: no signal {signal!r}; it holds {', '.join(self.signals)}"
            ) from None

    def __contains__(self, signal: object) -> bool:
        return signal in self.signals

    def with_signals(self, **signals: Array) -> Trajectory:
        """A copy in which ``signals`` are added or replaced."""
        return replace(self, signals={**self.signals, **signals})

    def without(self, signal: str) -> Trajectory:
        """A copy without ``signal``, which need not be there."""
        return replace(self, signals={name: own for name, own in self.signals.items() if name != signal})

    def rows(self, index: slice | NDArray[Any]) -> Trajectory:
        """The piece of the run that ``index`` selects."""
        own = {k: v[index] for k, v in self.signals.items()}
        return replace(self, time=self.time[index], signals=own, began=self.start)


class TrajectoryWriter:
    """Write trajectories to one Parquet file, a row group each; nothing appears under ``path`` before the end.

    ``metadata`` (JSON values: dataset, provenance, sampling, ...) is stored in the schema under ``hybrid_dynamics``.
    """

    def __init__(self, path: str | os.PathLike[str], metadata: Mapping[str, Any]) -> None:
        self._target = Path(path)
        self._metadata = dict(metadata)
        self._atomic = atomic_path(path)
        self._writer: pq.ParquetWriter | None = None

    def __enter__(self) -> TrajectoryWriter:
        self._temporary = self._atomic.__enter__()
        return self

    def __exit__(self, kind: Any, error: Any, traceback: Any) -> None:
        if self._writer is not None:
            self._writer.close()
        elif kind is None:
            kind, error = InputError, InputError(f"{self._target}: no trajectory to write")
            self._atomic.__exit__(kind, error, None)
            raise error
        self._atomic.__exit__(kind, error, traceback)

    def write(self, trajectory: Trajectory) -> None:
        """Append one trajectory (all must hold the same signals)."""
        table = _to_table(trajectory, self._metadata)
        if self._writer is None:
            self._writer = pq.ParquetWriter(
                self._temporary,
                table.schema,
                compression="zstd",
                store_schema=True,
                use_dictionary=["trajectory", "split"],
            )
        self._writer.write_table(table, row_group_size=max(table.num_rows, 1))


def write_trajectories(
    path: str | os.PathLike[str], trajectories: Iterable[Trajectory], metadata: Mapping[str, Any]
) -> None:
    """Write ``trajectories`` (consumed one by one) to ``path``."""
    with TrajectoryWriter(path, metadata) as writer:
        for trajectory in trajectories:
            writer.write(trajectory)


def read_metadata(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The ``hybrid_dynamics`` metadata of a trajectory file."""
    raw = (_open(path).schema_arrow.metadata or {}).get(b"hybrid_dynamics", b"{}")
    return dict(json.loads(raw))


def iter_trajectories(
    path: str | os.PathLike[str], split: str | None = None, require: Iterable[str] = ()
) -> Iterator[Trajectory]:
    """Yield the trajectories of ``path`` one by one (one in memory at a time), optionally of one ``split``.

    Raises :class:`InputError` that names the file and the column for a missing column (``require`` lists the
    signals that must be there) and for NaN or infinite values.
    """
    file = _open(path)
    names = set(file.schema_arrow.names)
    for column in ("trajectory", "split", "time"):
        if column not in names:
            raise InputError(f"{path}: column {column!r} is missing; expected trajectory, split, time and q1, ...")
    present = [signal for signal in SIGNALS if f"{signal}1" in names]
    for signal in require:
        if signal not in present:
            raise InputError(f"{path}: column '{signal}1' is missing; re-run the stage that writes it")
    n = max((sum(f"{s}{j}" in names for j in range(1, len(names))) for s in present), default=0)
    for signal in present:
        for j in range(1, n + 1):
            if f"{signal}{j}" not in names:
                raise InputError(f"{path}: column '{signal}{j}' is missing; expected {signal}1 to {signal}{n}")
    for group in range(file.num_row_groups):
        trajectory = _from_table(file.read_row_group(group), present, n, path)
        if split is None or trajectory.split == split:
            yield trajectory


def read_trajectories(
    path: str | os.PathLike[str], split: str | None = None, require: Iterable[str] = ()
) -> list[Trajectory]:
    """All trajectories of ``path`` as a list; see :func:`iter_trajectories`."""
    return list(iter_trajectories(path, split, require))


def _open(path: str | os.PathLike[str]) -> pq.ParquetFile:
    try:
        return pq.ParquetFile(path)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; run the stage that writes it (dvc repro)") from None
    except (pa.ArrowInvalid, OSError) as error:
        raise InputError(f"{path}: not a readable Parquet file ({error})") from None


def _to_table(trajectory: Trajectory, metadata: Mapping[str, Any]) -> pa.Table:
    rows = len(trajectory.time)
    columns: list[pa.Array] = [
        pa.array([trajectory.name] * rows, pa.string()),
        pa.array([trajectory.split] * rows, pa.string()),
        pa.array(trajectory.time, pa.float64()),
    ]
    fields = [
        pa.field("trajectory", pa.string()),
        pa.field("split", pa.string()),
        pa.field("time", pa.float64(), metadata={"unit": UNITS["time"]}),
    ]
    for signal in SIGNALS:
        if signal not in trajectory:
            continue
        for j in range(trajectory.n_joints):
            columns.append(pa.array(np.ascontiguousarray(trajectory[signal][:, j]), pa.float64()))
            fields.append(pa.field(f"{signal}{j + 1}", pa.float64(), metadata={"unit": UNITS[signal]}))
    schema = pa.schema(fields, metadata={"hybrid_dynamics": json.dumps(metadata, sort_keys=True)})
    return pa.Table.from_arrays(columns, schema=schema)


def _from_table(table: pa.Table, signals: list[str], n: int, path: str | os.PathLike[str]) -> Trajectory:
    def column(name: str) -> Array:
        held = table.column(name)
        if not (pa.types.is_floating(held.type) or pa.types.is_integer(held.type)):
            raise InputError(f"{path}: column '{name}' holds {held.type}; expected numbers")
        values = np.asarray(held.to_numpy())
        bad = ~np.isfinite(values)
        if bad.any():
            raise InputError(
                f"{path}: column '{name}' holds {values[bad][0]} in trajectory {table.column('trajectory')[0]}, row "
                f"{int(np.argmax(bad)) + 1}; remove or repair the row"
            )
        return values

    names = table.column("trajectory").unique()
    if len(names) != 1:
        raise InputError(f"{path}: a row group holds {len(names)} trajectories; write one row group a trajectory")
    return Trajectory(
        name=str(table.column("trajectory")[0]),
        split=str(table.column("split")[0]),
        time=column("time"),
        signals={s: np.column_stack([column(f"{s}{j}") for j in range(1, n + 1)]) for s in signals},
    )
