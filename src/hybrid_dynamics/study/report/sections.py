"""Sections that other parts of the study hand over as files: least squares, derivative accuracy, the closed loop."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from hybrid_dynamics.loop_report.html import Cell, details, escape, table
from hybrid_dynamics.study.report.pieces import frame_table
from hybrid_dynamics.study.results import Section, read_csv

#: Inline drawings of one loop section beyond this many bytes are left out, so that the page stays light.
DRAWINGS_LIMIT = 2_000_000
#: Added torque, in noise floors, from which on a planted effect must be found.
BLIND_SIZE = 3.0
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
#: Parameters of an effect that the summary shows (an inertia has ten; the loop's own page lists all).
SHOWN_PARAMETERS = 4
VERDICTS = {
    "explained": "what the rigid-body model lacked was found and added; held-out error is down to the noise",
    "partly_explained": "part of what the rigid-body model lacks was found and added; something remains",
    "unexplained": "something is missing that no effect of the catalogue explains",
    "nothing_missing": "the rigid-body model lacks nothing that can be seen in this data",
}


def study_sections(datasets: Sequence[str], data: Path = Path("data")) -> tuple[Section, ...]:
    """The sections found among the result files of ``datasets``: closed loop, least squares, differentiation."""
    found: list[Section | None] = []
    for name in datasets:
        folder = data / name
        found.append(loop_section(name, folder / "models" / "loop"))
        for question in sorted((folder / "questions").glob("*/diagnosis.json")):
            asked = question.parent.name
            title = f"What changed? Asked of the calibrated model: {asked.replace('_', ' ')}"
            found.append(loop_section(name, question.parent, title, f"question-{asked}"))
        found.append(least_squares_section(name, folder / "models" / "least_squares" / "model.json"))
        found.append(differentiate_section(name, folder / "differentiate.json"))
    return tuple(section for section in found if section is not None)


def least_squares_section(dataset: str, path: Path) -> Section | None:
    """Parameters, standard errors, conditioning and base-parameter grouping of the yardstick's ``model.json``."""
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
    return Section("least-squares", "Least squares: the classical yardstick", html, dataset)


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


def blind_section(path: Path) -> Section | None:
    """Undeclared effects planted in simulation and found again: shares, parameter errors and every miss.

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
    cases["planted"] = cases["hidden"].str.split().str.len()
    counted = cases[(cases["planted"] == 0) | (cases["size_over_floor"] >= BLIND_SIZE)]
    body: list[list[Cell | str]] = []
    for (robot, planted), own in counted.groupby(["robot", "planted"]):
        errors = own["parameter_error"].dropna()
        body.append(
            [
                Cell(escape(str(robot)), "text"),
                str(planted) if planted else "nothing",
                f"{int(own['right'].sum())} of {len(own)}",
                f"{100 * own['right'].mean():.1f} %",
                f"{100 * errors.median():.2g} %" if len(errors) else "–",
                f"{100 * errors.quantile(0.9):.2g} %" if len(errors) else "–",
                f"{own['after'].median():.3f}",
                f"{own['after'].max():.3f}",
            ]
        )
    heads = ["Robot", "Effects planted", "Right, nothing else", "Share", "Parameter error, median", "90th percentile"]
    heads += ["Error after / true model, median", "worst"]
    misses = counted.loc[~counted["right"], ["case", "robot", "hidden", "hidden_joints", "named", "named_joints"]]
    html = (
        f"<p>Effects planted in simulation, unknown to the loop, from {BLIND_SIZE:g} noise floors of added torque "
        f"on ({len(cases) - len(counted)} smaller cases are not counted). The true model's error is on the same "
        "processed data.</p>" + table(heads, body)
    )
    if len(misses):
        html += details(f"The {len(misses)} cases that were not named right", frame_table(misses.fillna("")))
    return Section("blind", "Undeclared effects in simulation", html)


def _truth(column: pd.Series) -> pd.Series:
    return column.astype(str).str.lower() == "true"


def loop_section(
    dataset: str, folder: Path, title: str = "The closed loop: what the rigid-body model lacks", name: str = "loop"
) -> Section | None:
    """Verdict and named effects of ``diagnosis.json`` in ``folder``, and the loop's own page, folded away."""
    diagnosis, page = folder / "diagnosis.json", folder / "report.html"
    if not diagnosis.exists():
        return None
    html = _named(json.loads(diagnosis.read_text("utf-8")))
    if page.exists():
        body = re.sub(r"(?s)^.*?<body[^>]*>|</body>.*$", "", page.read_text("utf-8"))
        body = re.sub(r"(?s)<(h1|style|script)\b.*?</\1>", "", body)
        body = re.sub(r"<(/?)h([23])\b", lambda found: f"<{found[1]}h{int(found[2]) + 2}", body)
        summary = "Residuals before and after each effect, ranked candidates, what is left"
        html += details(summary, f"<div class='loop'>{_limited(body)}</div>")
    return Section(name, title, html, dataset)


def _named(diagnosis: Mapping[str, Any]) -> str:
    """The verdict in a sentence and one row per effect that was added."""
    rows: list[list[Cell | str]] = []
    for step, effect in enumerate(diagnosis["effects"], 1):
        shown = [_parameter(parameter) for parameter in effect["parameters"][:SHOWN_PARAMETERS]]
        more = len(effect["parameters"]) - len(shown)
        values = ", ".join([*shown, f"and {more} more"] if more else shown)
        alike = "; ".join(
            " + ".join(e["effect"] for e in alternative["effects"]) for alternative in effect["indistinguishable_from"]
        )
        texts = (effect["effect"], ", ".join(effect["joints"]) or "whole robot", values, alike or "–")
        rows.append([str(step), *(Cell(escape(text), "text") for text in texts)])
    before, after = (diagnosis["error"]["test"][key]["relative_error"] for key in ("before", "after"))
    heads = ["Step", "Effect", "Where", "Parameters ± standard error", "Cannot be told from"]
    verdict = diagnosis["verdict"]
    return (
        f"<p><b>{escape(verdict.replace('_', ' ')).capitalize()}</b>: {VERDICTS[verdict]}. Pooled error on held-out "
        f"runs, at the loop's own bandwidth: {100 * before:.3g} % before, {100 * after:.3g} % after.</p>"
        + (table(heads, rows) if rows else "<p>No effect was named.</p>")
    )


def _parameter(parameter: Mapping[str, Any]) -> str:
    error = _number(parameter["std_error"], 2)
    return f"{parameter['name']} {_number(parameter['value'])} ± {error} {parameter['unit']}"


def _limited(body: str) -> str:
    """``body`` with the drawings that fit into :data:`DRAWINGS_LIMIT`; the others are named as left out."""
    used = 0

    def keep(found: re.Match[str]) -> str:
        nonlocal used
        used += len(found[0])
        if used <= DRAWINGS_LIMIT:
            return found[0]
        return "<p class='note'>(this drawing is in the loop's own report)</p>"

    return re.sub(r"(?s)<svg\b.*?</svg>", keep, body)
