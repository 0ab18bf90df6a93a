"""Reading the result files of the stages into one frozen object per dataset; everything after it is pure."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.parquet as pq

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop_report.content import Content
from hybrid_dynamics.robots.urdf import movable_joints, read_urdf
from hybrid_dynamics.study.evaluation import ERROR_COLUMNS
from hybrid_dynamics.study.extrapolation import Extrapolation, extrapolation
from hybrid_dynamics.study.layout import POOL
from hybrid_dynamics.study.methods import in_order
from hybrid_dynamics.trajectory import read_metadata

EXPRESSION_COLUMNS = ("joint", "engine", "expression", "complexity")
FRONT_COLUMNS = ("joint", "round", "complexity", "loss", "expression")
#: A feature that never exceeds this [N m] is identically zero (round-off of the Newton-Euler algorithm is 1e-14).
ZERO_TORQUE = 1e-9


@dataclass(frozen=True)
class Section:
    """A ready piece of HTML for the report: under ``dataset``, or at the end of the study where it is empty.

    ``html`` must be self-contained (data URIs only). ``name`` becomes the anchor. ``loop`` is the content of a closed
    loop, drawn by the loop's own sections after ``html``; ``evidence`` says whether its laws are drawn too.
    """

    name: str
    title: str
    html: str
    dataset: str = ""
    loop: Content | None = None
    evidence: bool = True


@dataclass(frozen=True)
class StudyInputs:
    """What the report is made from.

    ``data`` holds one folder a dataset; ``datasets`` are shown in this order, under their ``titles`` where they have
    one. ``pictures`` maps a dataset to the URDF
    (with meshes) its arm is drawn from. ``sections`` are extra pieces of HTML (the loop, the derivative benchmark, the
    least-squares details); ``tables`` are CSV files shown as they are: title -> path (a missing file is left out).
    ``blind`` is ``blind.csv``, where effects were hidden; ``park`` is ``park.csv``, where recorded arms were judged.
    """

    data: Path
    datasets: tuple[str, ...]
    titles: Mapping[str, str] = field(default_factory=dict)
    pictures: Mapping[str, Path] = field(default_factory=dict)
    sections: tuple[Section, ...] = ()
    tables: Mapping[str, Path] = field(default_factory=dict)
    blind: Path | None = None
    park: Path | None = None


@dataclass(frozen=True)
class Check:
    """One claim with the number that decides it, found on ``n`` cases.

    ``met`` None means that it is reported, not required, or that the cases are too few to decide.
    """

    dataset: str
    claim: str
    measured: str
    met: bool | None
    n: int | None = None


@dataclass(frozen=True)
class DatasetResults:
    """Everything the report shows of one dataset; see docs/architecture.md for the files."""

    name: str
    folder: Path
    provenance: str
    robot: str
    joint_names: tuple[str, ...]
    errors: pd.DataFrame
    predictions: pd.DataFrame
    expressions: pd.DataFrame
    fronts: pd.DataFrame
    timing: pd.DataFrame
    metadata: Mapping[str, Any]
    source: Mapping[str, Any]
    #: As titles and headings show it (``title`` in conf/dataset/).
    display_name: str
    #: Rigid-body torque columns that are identically zero, such as tau_gravity1 of an arm on a level base.
    zero_torques: tuple[str, ...]
    extrapolation: Extrapolation | None

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def methods(self) -> list[str]:
        """Methods that were evaluated, in the report's order."""
        return in_order(self.errors["method"])

    @property
    def title(self) -> str:
        """Name and provenance, as every title made from this dataset must show."""
        return f"{self.name} ({self.provenance})"

    def pooled(self, split: str, measure: str = "relative_rmse") -> pd.DataFrame:
        """``measure`` over all runs of ``split``: joints (rows, from 1) by methods (columns)."""
        return self.run(split, POOL, measure)

    def run(self, split: str, trajectory: str, measure: str = "relative_rmse") -> pd.DataFrame:
        """``measure`` of one run: joints (rows) by methods (columns)."""
        rows = self.errors[(self.errors["split"] == split) & (self.errors["trajectory"] == trajectory)]
        table = rows.pivot(index="joint", columns="method", values=measure)
        return table[in_order(table.columns)]

    def trajectories(self, split: str) -> list[str]:
        """Names of the runs of ``split``, in the order they were evaluated."""
        names = self.errors.loc[self.errors["split"] == split, "trajectory"]
        return [str(name) for name in dict.fromkeys(names) if name != POOL]


def read_study(inputs: StudyInputs) -> list[DatasetResults]:
    """Read every dataset of ``inputs``; raises :class:`InputError` naming the file or column that is missing."""
    if not inputs.datasets:
        raise InputError("the report has no dataset; list at least one under 'datasets' in params.yaml")
    return [read_dataset(inputs.data / name, inputs.titles.get(name, name)) for name in inputs.datasets]


def read_dataset(folder: Path, display_name: str = "") -> DatasetResults:
    """Read the result files of one dataset folder; it is shown under its own name where no other is given."""
    errors = _read_parquet(folder / "errors.parquet", ERROR_COLUMNS)
    if errors.empty:
        raise InputError(f"{folder / 'errors.parquet'}: no rows; run the stage evaluate (dvc repro)")
    predictions_file = folder / "predictions.parquet"
    predictions = _read_parquet(predictions_file, ()) if predictions_file.exists() else pd.DataFrame()
    robot = read_urdf(folder / "robot.urdf")
    joints = tuple(movable_joints(robot))
    methods = in_order(errors["method"])
    source_file = folder / "source" / "source.json"
    return DatasetResults(
        name=folder.name,
        folder=folder,
        provenance=str(errors["provenance"].iloc[0]),
        robot=robot.get("name") or folder.name,
        joint_names=joints,
        errors=errors,
        predictions=predictions,
        expressions=_tables(folder, methods, "expressions.csv", EXPRESSION_COLUMNS),
        fronts=_tables(folder, methods, "front.csv", FRONT_COLUMNS),
        timing=_timing(folder),
        metadata=read_metadata(folder / "trajectories.parquet"),
        source=json.loads(source_file.read_text("utf-8")) if source_file.exists() else {},
        display_name=display_name or folder.name,
        zero_torques=_zero_torques(folder / "features.parquet"),
        extrapolation=extrapolation(folder / "features.parquet"),
    )


def _read_parquet(path: Path, columns: tuple[str, ...]) -> pd.DataFrame:
    if not path.exists():
        raise InputError(f"{path}: no such file; run the stage that writes it (dvc repro)")
    table = pq.read_table(path)
    for column in columns:
        if column not in table.column_names:
            raise InputError(f"{path}: column {column!r} is missing; run the stage evaluate again (dvc repro)")
    frame: pd.DataFrame = table.to_pandas()
    return frame


def _tables(folder: Path, methods: list[str], name: str, columns: tuple[str, ...]) -> pd.DataFrame:
    found = []
    for method in methods:
        path = folder / "models" / method / name
        if path.exists():
            found.append(read_csv(path, columns).assign(method=method))
    out = pd.concat(found, ignore_index=True) if found else pd.DataFrame(columns=[*columns, "method"])
    return out


def read_csv(path: Path, columns: tuple[str, ...] = (), lists: tuple[str, ...] = ()) -> pd.DataFrame:
    """Read a result CSV; an empty field is NaN. Checks that ``columns`` are there; cells of ``lists`` stay as they are
    written (a list of one number is no number)."""
    try:
        table = pd.read_csv(path, dtype=dict.fromkeys(lists, object), keep_default_na=True)
    except pd.errors.EmptyDataError:
        raise InputError(
            f"{path}: the file is empty; expected the columns {', '.join(columns) or 'of a CSV'}"
        ) from None
    for column in columns:
        if column not in table.columns:
            raise InputError(f"{path}: column {column!r} is missing; run the stage that writes it again (dvc repro)")
    return table


def _timing(folder: Path) -> pd.DataFrame:
    rows = []
    for path in sorted((folder / "timing").glob("*.json")):
        value = json.loads(path.read_text("utf-8"))
        rows.append((folder.name, path.stem, value.get("wall_s"), value.get("peak_memory_mb")))
    table = pd.DataFrame(rows, columns=["dataset", "method", "wall_s", "peak_memory_mb"])
    order = {method: place for place, method in enumerate(in_order(table["method"]))}
    return table.sort_values("method", key=lambda column: column.map(order), ignore_index=True)


def _zero_torques(path: Path) -> tuple[str, ...]:
    """Rigid-body torque columns that are zero throughout, from the Parquet statistics (no data is read)."""
    if not path.exists():
        return ()
    file = pq.ParquetFile(path)
    largest: dict[str, float] = {}
    for group in range(file.num_row_groups):
        row_group = file.metadata.row_group(group)
        for index in range(row_group.num_columns):
            column = row_group.column(index)
            name, statistics = column.path_in_schema, column.statistics
            if name.startswith("tau_"):
                size = max(abs(statistics.min), abs(statistics.max)) if statistics is not None else float("inf")
                largest[name] = max(largest.get(name, 0.0), size)
    return tuple(name for name, size in largest.items() if size <= ZERO_TORQUE)
