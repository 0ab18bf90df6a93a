"""Sections over many cases: effects hidden in simulation, the park of recorded arms, benchmarks against peers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import pandas as pd

from hybrid_dynamics.loop_report.html import Cell, details, escape, table
from hybrid_dynamics.loop_report.words import title_of
from hybrid_dynamics.study.intervals import clopper_pearson, counted
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
ERRORS = ("rigid_body", "least_squares", "loop", "black_box", "floor")
PARK_COLUMNS = ("dataset", "joint", *ERRORS, "explained_share", "named")
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
        f"on ({len(cases) - len(counted_cases)} smaller cases are not counted). The true model's error is on the same "
        "processed data.</p>" + _shares(counted_cases) + _detection(cases) + _confusion(counted_cases)
    )
    if len(misses):
        html += details(f"The {len(misses)} cases that were not named right", frame_table(misses.fillna("")))
    return Section("blind", "Undeclared effects in simulation", html)


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
                counted(int(own["right"].sum()), len(own)),
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
        rows.append([Cell(escape(str(name)), "text"), str(total[name]), *cells])
    caption = "Planted (rows) and named (columns); a case that got two names counts in two columns"
    return table(
        ["Planted", "cases", *(f"<span>{escape(str(h))}</span>" for h in heads)], rows, caption, kind="confusion"
    )


def park_section(path: Path) -> Section | None:
    """Recorded arms one after the other: held-out error of every model per joint, and what the loop explains of it."""
    if not path.exists():
        return None
    rows = read_csv(path, PARK_COLUMNS)
    parts = [
        "<p>Held-out RMSE in N m of the rigid body, the classical least squares, the loop, and a black box (boosted "
        "trees) on top of the loop; the noise floor is estimated from the data. Explained share: the part of the "
        "error above the best of floor, least squares and black box that the loop removes, for both ends of the "
        "floor.</p>"
    ]
    if len(rows):
        parts.append(_arms(rows))
    for name, own in rows.groupby("dataset", sort=False):
        parts.append(details(f"{name}, joint by joint", _arm_table(own)))
    return Section("park", "The park: recorded arms", "\n".join(parts))


def _arms(rows: pd.DataFrame) -> str:
    """One line an arm: its joints pooled."""
    body: list[list[Cell | str]] = []
    for name, own in rows.groupby("dataset", sort=False):
        rms = {
            column: float((own[column] ** 2).sum() ** 0.5)
            for column in ("rigid_body", "least_squares", "loop", "black_box", "floor")
        }
        full = max(rms.values()) or 1.0
        drawn = (
            "".join(
                f'<span class="bar {kind}" style="width:{100 * rms[column] / full:.1f}%"></span>'
                for kind, column in (("before", "rigid_body"), ("after", "loop"))
            )
            + f'<span class="bar floor" style="left:0;width:{100 * rms["floor"] / full:.1f}%"></span>'
        )
        shares = own["explained_share"].dropna()
        body.append(
            [
                Cell(escape(str(name)), "text"),
                Cell(drawn, "picture"),
                *(f"{rms[column]:.3g}" for column in ERRORS),
                f"{100 * shares.median():.0f} %" if len(shares) else "–",
            ]
        )
    heads = [
        "Arm",
        "rigid body, loop, floor",
        "rigid body",
        "least squares",
        "loop",
        "black box",
        "floor",
        "explained, median",
    ]
    caption = "Root of the summed squares over the joints [N m], held-out runs"
    return f'<div class="drawn">{table(heads, body, caption)}</div>'


def _arm_table(own: pd.DataFrame) -> str:
    ends = {"explained_share_low", "explained_share_high"} <= set(own.columns)
    body: list[list[Cell | str]] = []
    for row in own.to_dict("records"):
        share = f"{100 * row['explained_share']:.0f} %" if pd.notna(row["explained_share"]) else "–"
        if ends and pd.notna(row["explained_share_low"]) and pd.notna(row["explained_share_high"]):
            share += (
                f"<small>{100 * row['explained_share_low']:.0f} to {100 * row['explained_share_high']:.0f} %</small>"
            )
        values = (row["rigid_body"], row["least_squares"], row["loop"], row["black_box"], row["floor"])
        best = min((v for v in values[:3] if pd.notna(v)), default=math.nan)
        cells = [Cell(f"{v:.3g}" if pd.notna(v) else "–", "best" if v == best else "") for v in values]
        body.append([str(row["joint"]), *cells, share, Cell(escape(_names(row["named"])), "text")])
    return table(["Joint", "rigid body", "least squares", "loop", "black box", "floor", "explained", "named"], body)


def _names(value: object) -> str:
    """Effects as people write them; those in brackets the test runs contradict."""
    names = [] if value is None or value != value else str(value).split()
    contradicted = [name.startswith("(") for name in names]
    return ", ".join(
        title_of(name.strip("()")) + (" (contradicted)" if against else "")
        for name, against in zip(names, contradicted, strict=True)
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


def campaign_sections(reports: Path) -> tuple[Section, ...]:
    """Those of the sections above whose file is in ``reports``."""
    found: Sequence[Section | None] = (
        park_section(reports / "park.csv"),
        resimulation_section(reports / "resimulation.csv"),
        blind_section(reports / "blind.csv"),
        benchmark_section(reports / "benchmarks.csv"),
    )
    return tuple(section for section in found if section is not None)
