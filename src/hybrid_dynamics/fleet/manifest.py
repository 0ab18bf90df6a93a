"""The manifest of a fleet: one row a loop, CSV or Parquet.

Columns: ``name`` (becomes a folder), ``robot`` (URDF), ``train`` (logs: a list, or text with ``;`` between them), and
where wanted ``test``, ``model`` (start from this model.json), ``lock`` (joints) and ``time`` (a number or a date: what
trends are over; the order of the rows where it is missing). Paths are relative to the manifest's own folder.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from hybrid_dynamics.errors import InputError

NEEDED = ("name", "robot", "train")
OPTIONAL = ("test", "model", "lock", "time")
#: Suffixes of a manifest.
SUFFIXES = (".csv", ".parquet", ".pq")
_DAY = 86_400.0


@dataclass(frozen=True)
class Entry:
    """One row of a manifest, paths made absolute. ``time`` is in days where the manifest has dates."""

    name: str
    robot: Path
    train: tuple[Path, ...]
    test: tuple[Path, ...] = ()
    model: Path | None = None
    lock: tuple[str, ...] = ()
    time: float = 0.0


def read_manifest(path: str | os.PathLike[str]) -> list[Entry]:
    """All rows, checked: :class:`InputError` names the row and the column of the first fault."""
    file = Path(path)
    table = _load(file)
    unknown = [str(c) for c in table.columns if c not in (*NEEDED, *OPTIONAL)]
    missing = [c for c in NEEDED if c not in table.columns]
    if missing or unknown:
        what = f"column {missing[0]!r} is missing" if missing else f"column {unknown[0]!r} is unknown"
        raise InputError(f"{file}: {what}; expected {', '.join(NEEDED)} and, where wanted, {', '.join(OPTIONAL)}")
    if table.empty:
        raise InputError(f"{file}: holds no rows; expected one a loop")
    times = _times(table["time"] if "time" in table.columns else None, len(table), file)
    entries = [_entry(row, file, k, times[k]) for k, row in enumerate(table.to_dict("records"))]
    seen: dict[str, int] = {}
    for k, entry in enumerate(entries, 1):
        if entry.name.casefold() in seen:
            raise InputError(f"{file}: row {k}: name {entry.name!r} stands also in row {seen[entry.name.casefold()]}")
        seen[entry.name.casefold()] = k
    return entries


def _load(file: Path) -> pd.DataFrame:
    if not file.is_file():
        raise InputError(f"{file}: no such file; give a manifest (CSV or Parquet)")
    if file.suffix.lower() not in SUFFIXES:
        raise InputError(f"{file}: expected a manifest that ends in {', '.join(SUFFIXES)}")
    try:
        if file.suffix.lower() == ".csv":
            return pd.read_csv(file, dtype=str, keep_default_na=False, encoding="utf-8-sig")
        return pd.read_parquet(file)
    except (ValueError, OSError) as error:
        raise InputError(f"{file}: not a readable manifest ({str(error).splitlines()[0]})") from None


def _entry(row: dict[Any, Any], file: Path, number: int, time: float) -> Entry:
    where = f"{file}: row {number + 1}"
    name = str(row["name"]).strip()
    if not re.fullmatch(r"[\w][\w .+-]{0,99}", name) or name != name.rstrip("."):
        raise InputError(f"{where}: name is {name!r}; expected letters, digits, '-', '_', '.' (it becomes a folder)")

    def paths(column: str) -> tuple[Path, ...]:
        found = tuple(file.parent / word for word in _words(row.get(column), ";"))
        for path in found:
            if not path.exists():
                raise InputError(f"{where}: {column} names {path}, which is not there; paths start at the manifest")
        return found

    robot, train, model = paths("robot"), paths("train"), paths("model")
    if len(robot) != 1 or len(model) > 1:
        raise InputError(f"{where}: expected one robot and at most one model; found {len(robot)} and {len(model)}")
    if not train:
        raise InputError(f"{where}: train is empty; expected at least one log")
    lock = tuple(_words(row.get("lock"), ";"))
    return Entry(name, robot[0], train, paths("test"), model[0] if model else None, lock, time)


def _words(value: Any, separator: str) -> list[str]:
    """A list, or text with separators, as words; what is empty or missing gives none."""
    if value is None or (isinstance(value, float) and np.isnan(value)):
        return []
    if isinstance(value, str):
        return [word.strip() for word in value.split(separator) if word.strip()]
    if isinstance(value, Iterable):
        return [str(word) for word in value if str(word)]
    return [str(value)]


def _times(column: pd.Series | None, rows: int, file: Path) -> list[float]:
    if column is None:
        return [float(k) for k in range(rows)]
    out = []
    for k, value in enumerate(column, 1):
        try:
            number = value.timestamp() / _DAY if isinstance(value, datetime) else float(value)
        except (TypeError, ValueError):
            try:
                number = datetime.fromisoformat(str(value)).timestamp() / _DAY
            except ValueError:
                raise InputError(
                    f"{file}: row {k}: time is {str(value)!r}; expected a number or a date such as 2026-05-31"
                ) from None
        if not np.isfinite(number):
            raise InputError(f"{file}: row {k}: time is {value}; expected a number or a date such as 2026-05-31")
        out.append(number)
    return out
