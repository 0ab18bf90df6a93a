"""The park of recorded arms: held-out errors per arm and joint, by regime, honesty of errors; effects added to logs."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from hybrid_dynamics.loop_report.html import Cell, badge, details, escape, key, table
from hybrid_dynamics.loop_report.words import plain, title_of
from hybrid_dynamics.study.intervals import counted
from hybrid_dynamics.study.layout import DatasetFiles
from hybrid_dynamics.study.park.tables import AGAINST
from hybrid_dynamics.study.results import Section, read_csv
from hybrid_dynamics.trajectory import RECORDED

MODELS = ("rigid_body", "least_squares", "loop", "black_box")
ERRORS = (*MODELS, "floor")
PARK_COLUMNS = ("dataset", "joint", *ERRORS, "explained_share", "named")
#: What the comparison with least squares says, in the page's words and its colour.
VERDICTS = {
    "better": ("met", "better"),
    "as_good": ("muted", "as good within its uncertainty"),
    "worse": ("missed", "worse beyond its uncertainty"),
}
#: Detection of an added effect, in words of the table.
ADDED_COLUMNS = ("dataset", "hidden", "detected", "named_right", "others", "true", "found", "std_error")
#: Standard errors within which a parameter counts as found.
WITHIN = 2.0
#: Beyond this a single run does not hold the parameter: its standard error there is none.
MOST_SCATTER = 100.0


def park_section(reports: Path, data: Path) -> Section | None:
    """Recorded arms one after the other: held-out error of every model per joint, and what the loop explains of it.

    ``reports`` holds ``park.csv`` and its companions; ``data`` what stage park_arm says of each recording.
    """
    if not (reports / "park.csv").exists():
        return None
    rows = read_csv(reports / "park.csv", PARK_COLUMNS)
    told = {name: _summary(data, str(name)) for name in dict.fromkeys(rows["dataset"])}
    parts = [
        "<p>Held-out RMSE in N m of the rigid body, the classical least squares, the loop, and a black box (boosted "
        "trees) on top of the loop; the noise floor is estimated from the data. Explained share: the part of the "
        "error above the best of floor, least squares and black box that the loop removes, for both ends of the "
        "floor. Rules of the loop were set while these arms were looked at, their held-out runs among them: the "
        "figures are somewhat optimistic.</p>"
    ]
    if AGAINST in rows:
        parts.append(
            "<p>Loop beside least squares: difference of their mean square errors as a share of least squares' "
            "(negative: the loop is better) ± its standard error, from blocks of time of the held-out runs. Better, "
            "and likewise worse, is said where chance alone would say it of at most one joint in twenty.</p>"
        )
    if len(rows):
        parts.append(_arms(rows, told))
    for name, own in rows.groupby("dataset", sort=False):
        parts.append(details(f"{_title(told, name)}, joint by joint", _arm_table(own)))
    for title, file, make in (
        ("Where in the motion the error is: standing, reversing, slow, fast", "park_regimes.csv", _regimes),
        ("Are the standard errors honest? Parameters fitted on each run alone", "park_parameters.csv", _honesty),
    ):
        found = read_csv(reports / file) if (reports / file).exists() else pd.DataFrame()
        if len(found):
            parts.append(details(title, make(found, told)))
    if any(told.values()):
        parts.append(details("Where the recordings are from", _sources(told)))
    return Section("park", "The park: recorded arms", "\n".join(parts))


def _summary(data: Path, arm: str) -> Mapping[str, Any]:
    path = DatasetFiles(arm).park / "summary.json"
    place = data / path.relative_to("data")
    return dict(json.loads(place.read_text("utf-8"))) if place.exists() else {}


def _title(told: Mapping[Any, Mapping[str, Any]], arm: object) -> str:
    title = told.get(arm, {}).get("title")
    return f"{title} ({arm})" if title else str(arm)


def _arms(rows: pd.DataFrame, told: Mapping[Any, Mapping[str, Any]]) -> str:
    """One line an arm: its joints pooled."""
    body: list[list[Cell | str]] = []
    compared = f"arm_{AGAINST}" in rows
    for name, own in rows.groupby("dataset", sort=False):
        rms = {column: float((own[column] ** 2).sum() ** 0.5) for column in ERRORS}
        full = max(rms.values()) or 1.0
        drawn = (
            "".join(
                f'<span class="bar {kind}" style="width:{100 * rms[column] / full:.1f}%"></span>'
                for kind, column in (("before", "rigid_body"), ("after", "loop"))
            )
            + f'<span class="bar floor" style="left:{100 * rms["floor"] / full:.1f}%;width:0"></span>'
        )
        shares = own["explained_share"].dropna()
        body.append(
            [
                Cell(f"{escape(_title(told, name))} {badge(RECORDED)}", "text"),
                Cell(drawn, "picture"),
                *(f"{rms[column]:.3g}" for column in ERRORS),
                _percent(shares.median()) if len(shares) else "–",
                *([_against(own.iloc[0], f"arm_{AGAINST}")] if compared else []),
            ]
        )
    drawn_as = key("before", "rigid body") + key("after", "loop") + key("floor", "floor")
    heads = ["Arm", drawn_as, *map(title_of, ERRORS), "explained, median joint"]
    caption = "Root of the summed squares over the joints [N m], held-out runs"
    return f'<div class="drawn">{table([*heads, *_against_head(compared)], body, caption)}</div>'


def _against_head(compared: bool) -> list[str]:
    return ["loop beside least squares"] if compared else []


def _against(row: Mapping[Any, Any] | pd.Series, column: str) -> Cell:
    """Difference of the mean squares with its standard error, and what it says."""
    verdict = row[f"{column}_verdict"]
    if verdict not in VERDICTS:
        return Cell("–", "text")
    kind, words = VERDICTS[verdict]
    value, error = 100 * float(row[column]), 100 * float(row[f"{column}_error"])
    return Cell(f'<span class="{kind}">{words}</span><small>{value:+.0f} ± {plain(error)} %</small>', "text")


def _percent(share: float) -> str:
    """A share near one keeps what tells it from one."""
    if share >= 0.99995:
        return "100 %"
    return f"{100 * share:.{2 if share > 0.999 else 1 if share > 0.99 else 0}f} %"


def _arm_table(own: pd.DataFrame) -> str:
    ends = {"explained_share_low", "explained_share_high"} <= set(own.columns)
    compared = AGAINST in own
    body: list[list[Cell | str]] = []
    for row in own.to_dict("records"):
        share = _percent(row["explained_share"]) if pd.notna(row["explained_share"]) else "–"
        if ends and pd.notna(row["explained_share_low"]) and pd.notna(row["explained_share_high"]):
            low, high = _percent(row["explained_share_low"]), _percent(row["explained_share_high"])
            share += f"<small>{low} to {high}</small>" if low != high else ""
        values = [row[column] for column in ERRORS]
        best = min((v for v in values[:3] if pd.notna(v)), default=math.nan)
        cells = [
            Cell(f"{v:.3g}" if pd.notna(v) else "–", "best" if v == best and k < 3 else "")
            for k, v in enumerate(values)
        ]
        against = [_against(row, AGAINST)] if compared else []
        body.append([str(row["joint"]), *cells, share, *against, Cell(escape(_names(row["named"])), "text")])
    heads = ["Joint", *map(title_of, ERRORS), "explained", *_against_head(compared), "named"]
    return table(heads, body, "Held-out RMSE [N m]; bold: the least of rigid body, least squares and loop")


def _names(value: object) -> str:
    """Effects as people write them; those in brackets the test runs contradict."""
    names = [] if value is None or value != value else str(value).split()
    contradicted = [name.startswith("(") for name in names]
    return ", ".join(
        title_of(name.strip("()")) + (" (contradicted)" if against else "")
        for name, against in zip(names, contradicted, strict=True)
    )


def _regimes(rows: pd.DataFrame, told: Mapping[Any, Mapping[str, Any]]) -> str:
    """A line an arm and regime, its joints pooled."""
    body: list[list[Cell | str]] = []
    for (name, regime), own in rows.groupby(["dataset", "regime"], sort=False):
        sizes = {model: float(np.sqrt(np.nansum(own[model] ** 2))) for model in MODELS}
        best = min(sizes[model] for model in MODELS[:3])
        cells = [Cell(f"{v:.3g}", "best" if v == best and k < 3 else "") for k, v in enumerate(sizes.values())]
        body.append([Cell(escape(_title(told, name)), "text"), Cell(str(regime), "text"), *cells])
    caption = (
        "Root of the summed squares over the joints [N m] in samples of each kind. Fits leave out joints that stand "
        "still; whoever uses the model does not"
    )
    return table(["Arm", "Motion", *map(title_of, MODELS)], body, caption)


def _honesty(rows: pd.DataFrame, told: Mapping[Any, Mapping[str, Any]]) -> str:
    """A line an arm: how far parameters of single runs are apart, in their standard errors."""
    body: list[list[Cell | str]] = []
    for name, own in rows.groupby("dataset", sort=False):
        scatter = own["scatter"][own["scatter"] > 0].dropna()
        if len(scatter):
            body.append(
                [
                    Cell(escape(_title(told, name)), "text"),
                    str(len(scatter)),
                    f"{scatter.median():.2g}",
                    f"{tail:.2g}"
                    if (tail := float(scatter.quantile(0.9))) < MOST_SCATTER
                    else f"above {MOST_SCATTER:g}",
                    counted(int((scatter <= WITHIN).sum()), len(scatter)),
                ]
            )
    caption = (
        "Scatter between runs in standard errors: 1 where the errors tell how far runs are apart and nothing changes "
        "between them; more where temperature, load or a law that is missing moves a parameter from run to run"
    )
    heads = ["Arm", "Parameters", "Scatter, median", "90th percentile", f"at most {WITHIN:g}"]
    return table(heads, body, caption)


def _sources(told: Mapping[Any, Mapping[str, Any]]) -> str:
    rows: list[list[Cell | str]] = [
        [Cell(escape(str(text)), "text") for text in (_title(told, arm), own["repository"], own["licence"])]
        for arm, own in told.items()
        if own
    ]
    return table(["Arm", "Repository", "Licence"], rows)


def added_section(path: Path) -> Section | None:
    """Known effects added to recorded logs: real noise and misfit, and an answer that is known."""
    rows = read_csv(path, ADDED_COLUMNS) if path.exists() else pd.DataFrame()
    if not len(rows):
        return None
    body: list[list[Cell | str]] = []
    for name, own in rows.groupby("dataset", sort=False):
        planted, control = own[own["hidden"].notna()], own[own["hidden"].isna()]
        known = planted.dropna(subset=["true", "found", "std_error"])
        near = (known["found"] - known["true"]).abs() <= WITHIN * known["std_error"]
        body.append(
            [
                Cell(escape(str(name)), "text"),
                _counted(_true(planted["detected"])),
                _counted(_true(planted["named_right"])),
                _counted(planted["others"] == 0),
                _counted(near),
                _counted(~_true(control["detected"]) & (control["others"] == 0)),
            ]
        )
    heads = [
        "Arm",
        "something named",
        "right name and joint",
        "nothing else new",
        f"parameters within {WITHIN:g} standard errors",
        "control: nothing added, nothing named",
    ]
    html = (
        "<p>An effect of known size is added to the torque of a recorded log and the calibrated model is asked what "
        "changed. Noise and misfit are real, the answer is known. Of several parameters the one farthest off counts."
        "</p>" + table(heads, body) + details("Case by case", _cases(rows))
    )
    return Section("added", "Known effects added to recorded logs", html)


def _true(column: pd.Series) -> pd.Series:
    return column.astype(str).str.lower() == "true"


def _counted(hits: pd.Series) -> Cell:
    return Cell(counted(int(hits.sum()), len(hits)) if len(hits) else "–", "text")


def _cases(rows: pd.DataFrame) -> str:
    body: list[list[Cell | str]] = []
    for row in rows.to_dict("records"):
        known = pd.notna(row["true"]) and pd.notna(row["found"]) and pd.notna(row["std_error"])
        value = f"{row['found']:.3g} ± {row['std_error']:.2g}" if known else "–"
        texts = (_place(row, "hidden"), _place(row, "named"), title_of(str(row.get("parameter", ""))) if known else "–")
        size = row.get("size_over_floor", math.nan)
        body.append(
            [
                *(Cell(escape(text), "text") for text in texts),
                f"{size:.2g}" if pd.notna(size) and size else "–",
                f"{row['true']:.3g}" if known else "–",
                value,
            ]
        )
    return table(["Added", "Named", "Parameter (SI)", "Size [floors]", "True", "Found ± standard error"], body)


def _place(row: Mapping[Any, Any], column: str) -> str:
    name, joints = row[column], row.get(f"{column}_joints")
    if name is None or name != name:
        return "nothing"
    where = f" ({joints})" if isinstance(joints, str) and joints != "-" else ""
    return _names(name) + where
