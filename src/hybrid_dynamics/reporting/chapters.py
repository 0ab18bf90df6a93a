"""Chapters of the report that belong to one method: the classical yardstick's parameters and the closed loop."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hybrid_dynamics.layout import DatasetFiles
from hybrid_dynamics.reporting.html import Cell, details, escape, table
from hybrid_dynamics.reporting.results import Section

VERDICTS = {
    "explained": "what the rigid-body model lacked was found and added; on held-out runs the error is down to noise",
    "partly_explained": "part of what the rigid-body model lacks was found and added; something remains",
    "unexplained": "something is missing that no effect of the catalogue explains",
    "nothing_missing": "nothing is missing",
}


def study_sections(datasets: Sequence[str], root: Path = Path()) -> tuple[Section, ...]:
    """The chapters of every dataset whose stages have written them."""
    found = []
    for name in datasets:
        files = DatasetFiles(name, root)
        yardstick, loop = files.model("least_squares") / "model.json", files.model("loop")
        if yardstick.is_file():
            html = least_squares_html(_read(yardstick))
            found.append(Section(f"{name}-least-squares", "The classical yardstick", html, name))
        if (loop / "diagnosis.json").is_file():
            page = (loop / "report.html").read_text(encoding="utf-8")
            html = loop_html(_read(loop / "diagnosis.json"), page)
            found.append(Section(f"{name}-loop", "The closed loop", html, name))
    return tuple(found)


def _read(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text(encoding="utf-8")))


def least_squares_html(model: Mapping[str, Any]) -> str:
    """Parameters with standard errors, the grouping into base parameters and the conditioning."""
    rows: list[list[Cell | str]] = [
        [
            Cell(escape(row["parameter"]), "text"),
            Cell(escape(row["unit"]), "text"),
            _number(row["described"]),
            _number(row["value"]),
            _number(row["std_error"], 2),
            _number(row["relative_std_percent"], 2),
            Cell(escape(row["expression"]), "text"),
        ]
        for row in model["parameters"]
    ]
    heads = ("parameter", "unit", "description", "identified", "std. error", "rel. std. [%]", "grouping")
    condition = model["condition_number"]
    return (
        "<p>Base inertial parameters, rotor inertia, viscous and Coulomb friction and offset, identified jointly by "
        "physically consistent least squares. Only base parameters are determined by data; the rest stays at the "
        f"robot's description. {len(rows)} parameters, condition number of the scaled regressor "
        f"{'–' if condition is None else f'{condition:.0f}'}.</p>"
        + details("Parameters, standard errors and grouping", table(heads, rows))
    )


def loop_html(diagnosis: Mapping[str, Any], page: str) -> str:
    """The verdict, what was named with its parameters, and the loop's own page inside."""
    rows: list[list[Cell | str]] = []
    for step, effect in enumerate(diagnosis["effects"], 1):
        values = ", ".join(
            f"{p['name']} {p['value']:.4g} ± {0 if p['std_error'] is None else p['std_error']:.2g} {p['unit']}"
            for p in effect["parameters"]
        )
        alike = "; ".join(
            " + ".join(e["effect"] for e in alternative["effects"]) for alternative in effect["indistinguishable_from"]
        )
        where = ", ".join(effect["joints"]) or "whole robot"
        cells = [Cell(escape(text), "text") for text in (effect["effect"], where, values, alike or "–")]
        rows.append([str(step), *cells])
    before, after = (diagnosis["error"]["test"][key]["relative_error"] for key in ("before", "after"))
    heads = ("step", "effect", "where", "parameters ± standard error", "cannot be told from")
    frame = (
        '<iframe title="closed loop" style="width:100%;height:80vh;border:1px solid #ccc" '
        f'srcdoc="{escape(page)}"></iframe>'
    )
    verdict = diagnosis["verdict"]
    return (
        f"<p><b>{escape(verdict.replace('_', ' '))}</b>: {VERDICTS[verdict]}. Pooled error on held-out runs, at the "
        f"loop's own bandwidth: {before:.2%} before, {after:.2%} after.</p>"
        + (table(heads, rows) if rows else "<p>No effect was named.</p>")
        + details("Residuals before and after each effect, ranked candidates, what is left", frame)
    )


def _number(value: float | None, digits: int = 4) -> str:
    return "–" if value is None else f"{value:.{digits}g}"
