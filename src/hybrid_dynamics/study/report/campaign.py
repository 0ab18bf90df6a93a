"""Sections over many cases: effects hidden in simulation, benchmarks against peers; the park's are in ``park.py``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import pandas as pd

from hybrid_dynamics.loop_report.html import Cell, details, escape, table
from hybrid_dynamics.loop_report.words import title_of
from hybrid_dynamics.study.intervals import clopper_pearson, counted
from hybrid_dynamics.study.report.park import added_section, park_section
from hybrid_dynamics.study.report.pieces import frame_table
from hybrid_dynamics.study.report.resimulation import resimulation_section
from hybrid_dynamics.study.results import Section, read_csv

#: Added torque, in noise floors, from which on a planted effect must be found.
BLIND_SIZE = 3.0
#: Edges of the sizes over which detection is counted.
SIZES = (0.0, 0.3, 1.0, 3.0, 10.0, math.inf)
BLIND_COLUMNS = (
    "case",
    "robot",
    "hidden",
    "hidden_joints",
    "size_over_floor",
    "named",
    "named_joints",
    "named_right",
    "nothing_wrong_named",
    "parameter_error",
    "rmse_after",
    "rmse_true_model",
)
BENCHMARK_COLUMNS = ("name", "ours", "peer", "ratio", "goal", "met")


def blind_section(path: Path) -> Section | None:
    """Undeclared effects planted in simulation and found again: shares, confusion, detection against size, misses.

    ``path`` is ``blind.csv``. Planted cases count from :data:`BLIND_SIZE` noise floors on; smaller ones are left out.
    """
    if not path.exists():
        return None
    cases = read_csv(path, BLIND_COLUMNS)
    cases = cases.assign(
        hidden=cases["hidden"].fillna("").astype(str),
        named=cases["named"].fillna("").astype(str),
        right=_truth(cases["named_right"]) & _truth(cases["nothing_wrong_named"]),
        after=cases["rmse_after"] / cases["rmse_true_model"],
    )
    cases["planted"] = cases["hidden"].map(lambda names: len(names.split()))
    counted_cases = cases[(cases["planted"] == 0) | (cases["size_over_floor"] >= BLIND_SIZE)]
    misses = counted_cases.loc[
        ~counted_cases["right"], ["case", "robot", "hidden", "hidden_joints", "named", "named_joints"]
    ]
    html = (
        f"<p>Effects planted in simulation, unknown to the loop, from {BLIND_SIZE:g} noise floors of added torque "
        f"on{_left_out(len(cases) - len(counted_cases))}. The true model's error is on the same processed data.</p>"
        + _shares(counted_cases)
        + _detection(cases)
        + _confusion(counted_cases)
    )
    if len(misses):
        html += details(_not_right(len(misses)), frame_table(misses.fillna("")))
    return Section("blind", "Undeclared effects in simulation", html)


def _left_out(smaller: int) -> str:
    return f" ({smaller} smaller case{'s are' if smaller != 1 else ' is'} not counted)" if smaller else ""


def _not_right(count: int) -> str:
    return "The case that was not named right" if count == 1 else f"The {count} cases that were not named right"


def _truth(column: pd.Series) -> pd.Series:
    return column.astype(str).str.lower() == "true"


def _shares(cases: pd.DataFrame) -> str:
    body: list[list[Cell | str]] = []
    for (robot, planted), own in cases.groupby(["robot", "planted"]):
        errors = own["parameter_error"].dropna()
        body.append(
            [
                Cell(escape(str(robot)), "text"),
                str(planted) if planted else "nothing",
                Cell(counted(int(own["right"].sum()), len(own)), "wrap"),
                f"{100 * errors.median():.2g} %" if len(errors) else "–",
                f"{100 * errors.quantile(0.9):.2g} %" if len(errors) else "–",
                f"{own['after'].median():.3f}",
                f"{own['after'].max():.3f}",
            ]
        )
    heads = ["Robot", "Effects planted", "Named right, nothing else", "Parameter error, median", "90th percentile"]
    return table([*heads, "Error after / true model, median", "worst"], body)


def _detection(cases: pd.DataFrame) -> str:
    """Share found against the size of one planted effect, with its interval drawn."""
    single = cases[cases["planted"] == 1]
    rows: list[list[Cell | str]] = []
    for low, high in pairwise(SIZES):
        own = single[(single["size_over_floor"] >= low) & (single["size_over_floor"] < high)]
        if not len(own):
            continue
        hits = int(_truth(own["named_right"]).sum())
        least, most = clopper_pearson(hits, len(own))
        span = f"{low:g} to {high:g}" if math.isfinite(high) else f"above {low:g}"
        drawn = (
            f'<span class="bar after" style="width:{100 * hits / len(own):.1f}%"></span>'
            f'<span class="bar floor" style="left:{100 * least:.1f}%;width:{100 * (most - least):.1f}%"></span>'
        )
        rows.append([span, Cell(drawn, "picture"), counted(hits, len(own))])
    if not rows:
        return ""
    caption = "One planted effect: named right, against its torque in noise floors (frame: the interval)"
    return f'<div class="drawn">{table(["Size [floors]", "Named right", "Cases"], rows, caption)}</div>'


def _confusion(cases: pd.DataFrame) -> str:
    """What was named where one effect or nothing was planted: rows planted, columns named (any number of names)."""
    single = cases[cases["planted"] <= 1]
    if not len(single):
        return ""
    planted = single["hidden"].replace("", "nothing")
    named = single["named"].str.split().apply(lambda own: list(dict.fromkeys(own)) or ["nothing"])
    pairs = pd.DataFrame({"planted": planted, "named": named}).explode("named")
    counts = pd.crosstab(pairs["planted"], pairs["named"])
    heads = [*(name for name in counts.index if name in counts.columns), *counts.columns.difference(counts.index)]
    total = planted.value_counts()
    rows: list[list[Cell | str]] = []
    for name in counts.index:
        cells = [
            Cell(str(counts.loc[name, head]) if counts.loc[name, head] else "·", "best" if head == name else "")
            for head in heads
        ]
        rows.append([Cell(escape(title_of(str(name))), "text"), str(total[name]), *cells])
    caption = "Planted (rows) and named (columns); a case that got two names counts in two columns"
    return table(
        ["Planted", "cases", *(f"<span>{escape(title_of(str(h)))}</span>" for h in heads)],
        rows,
        caption,
        kind="confusion",
    )


def _text(value: object) -> str:
    return "" if value is None or value != value else str(value).replace("_", " ")


def benchmark_section(path: Path) -> Section | None:
    """Ours beside the peer's, with the goal: ``benchmarks.csv`` as ``make bench`` writes it."""
    if not path.exists():
        return None
    rows = read_csv(path, BENCHMARK_COLUMNS)
    marks = {"true": ("met", "✓ met"), "false": ("missed", "✗ not met")}
    body: list[list[Cell | str]] = []
    for row in rows.itertuples():
        kind, text = marks.get(str(row.met).lower(), ("open", "reported"))
        body.append(
            [
                Cell(escape(str(row.name)), "text"),
                *(_measure(value) for value in (row.ours, row.peer, row.ratio)),
                Cell(escape(_text(row.goal)), "text"),
                Cell(f'<span class="{kind}">{text}</span>', "text"),
            ]
        )
    html = "<p>Medians over repetitions on the machine that ran <code>make bench</code>; ratio: peer over ours.</p>"
    return Section("benchmarks", "Benchmarks", html + table(["What", "Ours", "Peer", "Ratio", "Goal", ""], body))


def _measure(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) and value == value else escape(_text(value)) or "–"


def campaign_sections(reports: Path, data: Path = Path("data")) -> tuple[Section, ...]:
    """Those of the sections above whose file is in ``reports``; ``data`` holds where the arms' recordings are from."""
    found: Sequence[Section | None] = (
        park_section(reports, data),
        added_section(reports / "added.csv"),
        resimulation_section(reports / "resimulation.csv", reports / "park.csv"),
        blind_section(reports / "blind.csv"),
        benchmark_section(reports / "benchmarks.csv"),
    )
    return tuple(section for section in found if section is not None)
