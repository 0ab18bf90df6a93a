"""Sections over many cases: benchmarks against peers; the park's are in ``park.py``, blind cases in ``blind.py``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hybrid_dynamics.loop_report.html import Cell, escape, table
from hybrid_dynamics.study.report.blind import blind_section
from hybrid_dynamics.study.report.park import added_section, park_section
from hybrid_dynamics.study.report.resimulation import resimulation_section
from hybrid_dynamics.study.results import Section, read_csv

BENCHMARK_COLUMNS = ("name", "ours", "peer", "ratio", "goal", "met")


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
