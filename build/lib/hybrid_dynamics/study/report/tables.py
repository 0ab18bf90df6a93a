"""The report's tables as files: CSV for people and programs, JSON for ``dvc metrics``, text for the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from hybrid_dynamics.files import write_json, write_text
from hybrid_dynamics.study.methods import in_order, label
from hybrid_dynamics.study.results import Check, DatasetResults

RMSE_COLUMNS = ("dataset", "provenance", "split", "trajectory", "method", "joint", "rmse", "relative_rmse")
POOLED_COLUMNS = ("dataset", "provenance", "split", "trajectory", "method", "relative_error")
EXPRESSION_COLUMNS = ("dataset", "provenance", "method", "joint", "engine", "expression", "complexity")


def rmse_table(results: Sequence[DatasetResults]) -> pd.DataFrame:
    """``rmse`` [N m] and ``relative_rmse`` per dataset, split, trajectory (and ``all``), method and joint."""
    return pd.concat([result.errors for result in results], ignore_index=True)[list(RMSE_COLUMNS)]


def pooled_table(results: Sequence[DatasetResults]) -> pd.DataFrame:
    """``relative_error`` over all joints, per dataset, split, trajectory and method."""
    table = pd.concat([result.errors for result in results], ignore_index=True)[list(POOLED_COLUMNS)]
    return table.drop_duplicates(ignore_index=True)


def expression_table(results: Sequence[DatasetResults]) -> pd.DataFrame:
    """The selected expression per dataset, method and joint (SymPy syntax)."""
    found = [r.expressions.assign(dataset=r.name, provenance=r.provenance) for r in results if len(r.expressions)]
    columns = list(EXPRESSION_COLUMNS)
    return pd.concat(found, ignore_index=True)[columns] if found else pd.DataFrame(columns=columns)


def timing_table(results: Sequence[DatasetResults]) -> pd.DataFrame:
    """Wall time [s] and peak memory [MB] of each training."""
    return pd.concat([result.timing for result in results], ignore_index=True)


def front_table(results: Sequence[DatasetResults]) -> pd.DataFrame:
    """All Pareto fronts: ``dataset method joint round complexity loss``."""
    columns = ["dataset", "method", "joint", "round", "complexity", "loss"]
    found = [r.fronts.assign(dataset=r.name)[columns] for r in results if len(r.fronts)]
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame(columns=columns)


def held_out_table(results: Sequence[DatasetResults]) -> pd.DataFrame:
    """One row per dataset and method for ``dvc plots``: ``model`` (both names), pooled error in percent."""
    rows = []
    for result in results:
        split = "test" if result.trajectories("test") else "train"
        error = result.pooled(split, "relative_error").iloc[0]
        rows += [(f"{result.title}: {label(str(m))}", 100 * float(error[m])) for m in error.index]
    return pd.DataFrame(rows, columns=["model", "relative_error_percent"])


def metrics(results: Sequence[DatasetResults]) -> dict[str, Any]:
    """Nested dataset -> method -> measure on the held-out runs, for ``dvc metrics show`` and ``dvc exp show``.

    ``relative_error`` is pooled over joints; ``worst_relative_rmse`` is that of the worst joint (a joint whose torque
    does not vary has none). Every number becomes a column there, so there are no more than these.
    """
    out: dict[str, Any] = {}
    for result in results:
        split = "test" if result.trajectories("test") else "train"
        pooled, worst = result.pooled(split, "relative_error").iloc[0], result.pooled(split).max()
        out[result.name] = {
            method: {"relative_error": _number(pooled[method]), "worst_relative_rmse": _number(worst[method])}
            for method in result.methods
        }
    return out


def _number(value: float) -> float | None:
    return float(f"{value:.6g}") if math.isfinite(value) else None


def write_tables(results: Sequence[DatasetResults], checked: Sequence[Check], folder: Path) -> None:
    """Write the CSV files, ``metrics.json``, ``plots/*.csv`` and ``tables.txt`` to ``folder``, each atomically."""
    rmse = rmse_table(results)
    write_csv(rmse, folder / "rmse.csv")
    write_csv(pooled_table(results), folder / "pooled.csv")
    write_csv(expression_table(results), folder / "expressions.csv")
    write_csv(timing_table(results), folder / "timing.csv")
    pool = rmse[rmse["trajectory"] == "all"]
    write_csv(pool.drop(columns=["provenance", "trajectory"]), folder / "plots" / "relative_rmse.csv")
    write_csv(front_table(results), folder / "plots" / "fronts.csv")
    write_csv(held_out_table(results), folder / "plots" / "held_out.csv")
    write_json(folder / "metrics.json", metrics(results))
    write_text(folder / "tables.txt", text_tables(results, checked))


def write_csv(table: pd.DataFrame, path: Path) -> None:
    """Write ``table`` without its index; full precision, empty for what is not a number."""
    write_text(path, table.to_csv(index=False, lineterminator="\n"))


def format_value(value: float | None) -> str:
    """A relative error the way the tables print it: three significant digits, never more than seven characters."""
    if value is None or not math.isfinite(value):
        return "–"
    if value != 0 and (abs(value) < 1e-3 or abs(value) >= 1e4):
        mantissa, exponent = f"{value:.1e}".split("e")
        return f"{mantissa}e{int(exponent)}"
    if abs(value) >= 100:
        return f"{value:.0f}"
    return f"{value:.4f}" if abs(value) < 0.1 else f"{value:.3f}" if abs(value) < 10 else f"{value:.1f}"


def text_tables(results: Sequence[DatasetResults], checked: Sequence[Check]) -> str:
    """The tables of relative RMSE and the checks as plain text for the terminal."""
    parts = []
    for result in results:
        for split in ("train", "test"):
            table = result.pooled(split)
            if table.empty:
                continue
            error = result.pooled(split, "relative_error").iloc[0]
            heads = ["joint", *[label(method) for method in table.columns]]
            body = [[str(joint), *[format_value(v) for v in row]] for joint, row in table.iterrows()]
            body.append(["pooled", *[format_value(error[method]) for method in table.columns]])
            parts.append(f"{result.title}: relative RMSE, {split}\n{_align(heads, body)}")
    if checked:
        marks = {True: "met", False: "NOT MET", None: "-"}
        lines = [f"  [{marks[c.met]}] {c.dataset}: {c.claim}: {c.measured}" for c in checked]
        parts.append("Checks\n" + "\n".join(lines))
    return "\n\n".join(parts) + "\n"


def _align(heads: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    widths = [max(len(line[k]) for line in [heads, *body]) for k in range(len(heads))]
    lines = ["  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)) for line in [heads, *body]]
    rule = "-" * len(lines[0])
    return "\n".join([lines[0], rule, *lines[1:-1], rule, lines[-1]])


def method_columns(table: pd.DataFrame) -> list[str]:
    """The method columns of ``table``, in the report's order."""
    return in_order(str(column) for column in table.columns)
