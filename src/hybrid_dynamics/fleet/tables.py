"""The tables of a fleet: what became of every loop, what changed where, and how parameters go over time."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from hybrid_dynamics.files import write_text
from hybrid_dynamics.fleet.manifest import Entry

#: Written into the folder of the fleet.
TABLES = ("runs.csv", "changes.csv", "trends.csv")
RUN_COLUMNS = ("name", "time", "robot", "verdict", "effects", "error_before", "error_after", "refused")
CHANGE_COLUMNS = (
    "name",
    "time",
    "robot",
    "effect",
    "joint",
    "parameter",
    "value",
    "std_error",
    "unit",
    "confirmed",
    "verdict",
)
TREND_COLUMNS = (
    "robot",
    "effect",
    "joint",
    "parameter",
    "unit",
    "runs",
    "first",
    "last",
    "mean",
    "slope",
    "slope_std_error",
    "trend",
)
#: A slope counts as a trend beyond this many of its standard errors.
SURE = 3.0


def write_tables(out: Path, entries: Sequence[Entry], refused: Mapping[str, str], runs: Path) -> None:
    """Write the three tables, each atomically, from the diagnoses that are there."""
    rows: list[dict[str, Any]] = []
    changes: list[dict[str, Any]] = []
    for entry in entries:
        head = {"name": entry.name, "time": entry.time}
        if entry.name in refused:
            rows.append(head | {"refused": refused[entry.name]})
            continue
        diagnosis = json.loads((runs / entry.name / "diagnosis.json").read_text(encoding="utf-8"))
        test = diagnosis["error"]["test"]
        found = diagnosis["effects"]
        head |= {"robot": diagnosis["robot"], "verdict": diagnosis["verdict"]}
        rows.append(
            head
            | {
                "effects": "; ".join(" ".join([e["effect"], *e["joints"]]) for e in found),
                "error_before": test["before"]["relative_error"],
                "error_after": test.get("after_confirmed", test["after"])["relative_error"],
            }
        )
        changes += [_change(head, effect, parameter) for effect in found for parameter in effect["parameters"]]
    table = pd.DataFrame(changes, columns=list(CHANGE_COLUMNS))
    for name, frame in (
        ("runs.csv", pd.DataFrame(rows, columns=list(RUN_COLUMNS))),
        ("changes.csv", table),
        ("trends.csv", trends(table)),
    ):
        write_text(out / name, frame.to_csv(index=False, float_format="%.9g"))


def _change(head: Mapping[str, Any], effect: Mapping[str, Any], parameter: Mapping[str, Any]) -> dict[str, Any]:
    joint = parameter["joint"] or (effect["joints"][0] if effect["joints"] else "")
    return {
        **head,
        "effect": effect["effect"],
        "joint": joint,
        "parameter": parameter["name"],
        "value": parameter["value"],
        "std_error": parameter["std_error"],
        "unit": parameter["unit"],
        "confirmed": effect.get("confirmed", True),
    }


def trends(changes: pd.DataFrame) -> pd.DataFrame:
    """One row a parameter of a robot: over how many runs it was found, and its slope per unit of time.

    The slope is fitted with the parameters' standard errors as weights; where the values scatter more than those say,
    its own standard error grows with the scatter (the Birge ratio): days that differ are no trend by themselves.
    """
    rows = []
    held = changes[changes["confirmed"].astype(bool)]
    for key, group in held.groupby(["robot", "effect", "joint", "parameter", "unit"], sort=True, dropna=False):
        group = group.sort_values(["time", "name"])
        time, value = group["time"].to_numpy(float), group["value"].to_numpy(float)
        slope, error = _slope(time, value, group["std_error"].to_numpy(float))
        known = np.isfinite(slope) and np.isfinite(error)
        trend = "" if not known else "steady"
        if known and abs(slope) > SURE * error:
            trend = "rising" if slope > 0 else "falling"
        first = dict(zip(("robot", "effect", "joint", "parameter", "unit"), key, strict=True))
        numbers = {"runs": len(group), "first": value[0], "last": value[-1], "mean": value.mean()}
        rows.append({**first, **numbers, "slope": slope, "slope_std_error": error, "trend": trend})
    return pd.DataFrame(rows, columns=list(TREND_COLUMNS))


def _slope(time: np.ndarray, value: np.ndarray, error: np.ndarray) -> tuple[float, float]:
    """Weighted slope and its standard error; NaN below three runs or where time stands still."""
    if len(time) < 3 or np.ptp(time) == 0:
        return float("nan"), float("nan")
    sure = np.isfinite(error) & (error > 0)
    sigma = np.where(sure, error, np.median(error[sure]) if sure.any() else 1.0)
    weight = 1.0 / sigma**2
    middle = np.average(time, weights=weight)
    spread = float(np.sum(weight * (time - middle) ** 2))
    slope = float(np.sum(weight * (time - middle) * value)) / spread
    left = value - np.average(value, weights=weight) - slope * (time - middle)
    ratio = float(np.sqrt(np.sum(weight * left**2) / (len(time) - 2)))
    return slope, max(ratio, 1.0 if sure.any() else 0.0) / float(np.sqrt(spread))
