"""The tables of all recorded arms in one place."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from hybrid_dynamics.files import write_text
from hybrid_dynamics.study.layout import AddedFiles, DatasetFiles
from hybrid_dynamics.study.park.added import COLUMNS as ADDED_COLUMNS
from hybrid_dynamics.study.park.tables import COLUMNS, PARAMETER_COLUMNS, REGIME_COLUMNS
from hybrid_dynamics.trajectory import RECORDED

TABLES = {
    "park": ("joints", COLUMNS),
    "park_regimes": ("regimes", REGIME_COLUMNS),
    "park_parameters": ("parameters", PARAMETER_COLUMNS),
}


def collect_park(arms: Sequence[str], added: Sequence[str], reports: Path, root: Path = Path()) -> list[str]:
    """Write ``park.csv``, ``park_regimes.csv``, ``park_parameters.csv`` and ``added.csv``; returns the arms left out.

    ``arms`` have been through stage park_arm, ``added`` through score_added; tables without an arm hold the header.
    """
    files = {arm: DatasetFiles(arm, root).park for arm in arms}
    found = {arm: json.loads((folder / "summary.json").read_text(encoding="utf-8")) for arm, folder in files.items()}
    present = [arm for arm in arms if found[arm]["provenance"] == RECORDED]
    for report, (table, columns) in TABLES.items():
        parts = [pd.read_csv(files[arm] / f"{table}.csv") for arm in present]
        _write(reports / f"{report}.csv", parts, columns)
    _write(reports / "added.csv", [pd.read_csv(AddedFiles(arm, root).scores) for arm in added], ADDED_COLUMNS)
    return [arm for arm in arms if arm not in present]


def _write(path: Path, parts: Sequence[pd.DataFrame], columns: Sequence[str]) -> None:
    filled = [part for part in parts if len(part)]
    table = pd.concat(filled) if filled else pd.DataFrame(columns=list(columns))
    write_text(path, table.to_csv(index=False))
