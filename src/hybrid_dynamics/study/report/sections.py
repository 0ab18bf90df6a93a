"""Sections that other parts of the study hand over as files: least squares, derivative accuracy, the closed loop."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from hybrid_dynamics.loop_report.content import CONTENT_FILE, read_content
from hybrid_dynamics.loop_report.html import Cell, details, escape, table
from hybrid_dynamics.study.report.pieces import frame_table
from hybrid_dynamics.study.results import Section, read_csv

#: What the numbers of a loop are over, and what those of a question are on top of.
OWN_BANDWIDTH = (
    "<p class='note'>Errors in this section are over the logs at the loop's own bandwidth; those in the tables of all "
    "methods above are over the study's features. They therefore differ a little.</p>"
)
ON_TOP = (
    "<p class='note'>Asked of the model that the loop calibrated on the arm's other runs, with other logs. Every "
    "number below comes on top of that model: a negative friction means less friction than was calibrated.</p>"
)


def study_sections(datasets: Sequence[str], data: Path = Path("data")) -> tuple[Section, ...]:
    """The sections found among the result files of ``datasets``: closed loop, least squares, differentiation."""
    found: list[Section | None] = []
    for name in datasets:
        folder = data / name
        found.append(loop_section(name, folder / "models" / "loop"))
        for question in sorted((folder / "questions").glob("*/diagnosis.json")):
            asked = question.parent.name
            title = f"What changed? Asked of the calibrated model: {asked.replace('_', ' ')}"
            found.append(loop_section(name, question.parent, title, f"question-{asked}", False, ON_TOP))
        found.append(least_squares_section(name, folder / "models" / "least_squares" / "model.json"))
        found.append(differentiate_section(name, folder / "differentiate.json"))
    return tuple(section for section in found if section is not None)


def least_squares_section(dataset: str, path: Path) -> Section | None:
    """Parameters, standard errors, conditioning and base-parameter grouping of the baseline's ``model.json``."""
    if not path.exists():
        return None
    model = json.loads(path.read_text("utf-8"))
    columns = ("armature", "viscous", "coulomb", "offset", "noise")
    joints: list[list[Cell | str]] = [
        [f"{k + 1} <span class='muted'>{escape(name)}</span>", *(f"{model[key][k]:.4g}" for key in columns)]
        for k, name in enumerate(model["joints"])
    ]
    heads = ["Joint", "armature [kg m²]", "viscous [N m s/rad]", "Coulomb [N m]", "offset [N m]", "residual [N m]"]
    rows = [_parameter_row(row) for row in model["parameters"]]
    parameters = table(
        ["Parameter", "Grouping", "Unit", "Described", "Ordinary", "Physical", "Std error", "%"],
        rows,
        "Standard errors are of the ordinary estimate, by a block jackknife. Described: from the robot's URDF.",
    )
    html = (
        f"<p>Physically consistent least squares on {model['rows']} samples. Condition number of the weighted "
        f"regressor: {_number(model['condition_number'])}; of the inertial columns alone: "
        f"{_number(model['base_condition_number'])}.</p>"
        + table(heads, joints)
        + details(f"All {len(rows)} base and friction parameters", parameters)
    )
    return Section("least-squares", "Least squares: the classical baseline", html, dataset)


def _parameter_row(row: Mapping[str, Any]) -> list[Cell | str]:
    return [
        Cell(f"<code>{escape(row['parameter'])}</code>", "text"),
        Cell(f"<code>{escape(row['expression'])}</code>", "text"),
        Cell(escape(row["unit"]), "text"),
        *(_number(row[key]) for key in ("described", "ordinary", "value", "std_error", "relative_std_percent")),
    ]


def _number(value: float | None, digits: int = 4) -> str:
    return "–" if value is None else f"{value:.{digits}g}"


def derivative_section(path: Path, dataset: str = "") -> Section | None:
    """Accuracy of the differentiators against truth, from a CSV of ``derivative_errors`` rows (joint ``all``)."""
    if not path.exists():
        return None
    rows = read_csv(path, ("method", "signal", "joint", "relative_rmse"))
    rows = rows[rows["joint"].astype(str) == "all"]
    best = "best_relative_rmse" in rows
    signals = list(dict.fromkeys(rows["signal"]))
    least = rows.groupby("signal")["relative_rmse"].min()
    body: list[list[Cell | str]] = []
    for method in dict.fromkeys(rows["method"]):
        own = rows[rows["method"] == method].set_index("signal")
        line: list[Cell | str] = [Cell(escape(str(method)), "text")]
        for signal in signals:
            value = float(own.loc[signal, "relative_rmse"])
            text = f"{value:.3g}"
            if best:
                text += f'<small class="paper">best {float(own.loc[signal, "best_relative_rmse"]):.3g}</small>'
            line.append(Cell(text, "best" if value == least[signal] else ""))
        body.append(line)
    html = (
        "<p>Relative RMSE of the estimated derivatives of a noisy simulated run against the truth, all joints; "
        "parameters chosen from the data alone."
        + (" Small: the best that tuning on the truth achieves.</p>" if best else "</p>")
        + table(["Method", *(escape(str(signal)) for signal in signals)], body)
    )
    return Section("derivatives", "Accuracy of the derivatives", html, dataset)


def differentiate_section(dataset: str, path: Path) -> Section | None:
    """What ``differentiate.json`` reports per run: method, parameters chosen, samples trimmed."""
    if not path.exists():
        return None
    reports = json.loads(path.read_text("utf-8"))
    flat = pd.DataFrame([{key: _short(value) for key, value in report.items()} for report in reports])
    html = details("Method, chosen parameters and trimmed edges of every run", frame_table(flat.fillna("")))
    return Section("differentiate", "How the derivatives were estimated", html, dataset)


def _short(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.4g}")
    if isinstance(value, list):
        return ", ".join(str(_short(item)) for item in value)
    if isinstance(value, dict):
        return "; ".join(f"{key} {_short(item)}" for key, item in value.items())
    return value


def loop_section(
    dataset: str,
    folder: Path,
    title: str = "The closed loop: what the rigid-body model lacks",
    name: str = "loop",
    evidence: bool = True,
    note: str = OWN_BANDWIDTH,
) -> Section | None:
    """The closed loop in ``folder``, from the content its stage left; None where no loop ran there."""
    if not (folder / "diagnosis.json").exists():
        return None
    return Section(name, title, note, dataset, read_content(folder / CONTENT_FILE), evidence)
