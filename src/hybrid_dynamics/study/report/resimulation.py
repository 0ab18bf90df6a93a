"""The section on resimulation: driven by the recorded torque, does the exported model move as the robot did?"""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from hybrid_dynamics.loop_report.html import Cell, badge, details, escape, key, table
from hybrid_dynamics.loop_report.words import known, number
from hybrid_dynamics.study.layout import RESIMULATION_COLUMNS
from hybrid_dynamics.study.results import Section, read_csv


def improving(own: pd.DataFrame) -> str:
    """How many joints of an arm, ``own`` rows, move better than before; where nothing moved, all do."""
    if own["position_before"].isna().all():
        return "all: none moved"
    return f"{int((own['position_after'] < own['position_before']).sum())} of {len(own)}"


def without_before(rows: pd.DataFrame) -> str:
    """Why arms of ``rows`` have no number before; empty where all have one."""
    names = dict.fromkeys(str(n) for n in rows["dataset"][rows["position_before"].isna()])
    if not names:
        return ""
    return (
        f"No number before: {', '.join(names)} as its URDF describes it cannot be simulated (a link without inertia, "
        "which any torque turns infinitely fast, say); completed it can."
    )


def resimulation_section(path: Path, park: Path | None = None) -> Section | None:
    """State error before and after on every arm; ``path`` is ``resimulation.csv``. None where there is nothing.

    ``park`` is ``park.csv``: its arms without a row are named as left out.
    """
    if not path.exists():
        return None
    rows = read_csv(path, RESIMULATION_COLUMNS)
    if not len(rows):
        return None
    windows = ", ".join(f"{value:g}" for value in sorted(set(rows["window"])))
    parts = [
        "<p>The model that the loop completed, exported as MJCF, driven in MuJoCo by the recorded torque of held-out "
        f"runs in windows of {windows} s, each begun at the recorded state: the root mean square of what its motion is "
        "off, for the URDF alone (before) and the completed model (after). Another engine, and forward in time: a "
        "check of the whole chain. Without its friction a light wrist runs away within the half second; that is "
        "what the large numbers before are. What MJCF cannot carry (friction with a memory, say) is not in it.</p>",
        _left_out(rows, park),
        f"<p class='note'>{escape(said)}</p>" if (said := without_before(rows)) else "",
        _arms(rows),
    ]
    for name, own in rows.groupby("dataset", sort=False):
        parts.append(details(f"{name}, joint by joint", _joints(own)))
    return Section("resimulation", "Simulated again in MuJoCo", "\n".join(parts))


def _left_out(rows: pd.DataFrame, park: Path | None) -> str:
    arms = dict.fromkeys(read_csv(park, ("dataset",))["dataset"]) if park is not None and park.exists() else {}
    absent = [str(arm) for arm in arms if arm not in set(rows["dataset"])]
    if not absent:
        return ""
    return (
        f"<p class='note'>Left out: {escape(', '.join(absent))}. MuJoCo does not take the model (a link has an "
        "inertia that no body can have, say); the stage <code>resimulate_arm</code> prints why.</p>"
    )


def _arms(rows: pd.DataFrame) -> str:
    body: list[list[Cell | str]] = []
    for name, own in rows.groupby("dataset", sort=False):
        sizes = {
            column: known(own[column].median())
            for column in ("position_before", "position_after", "velocity_before", "velocity_after")
        }
        ends = {kind: sizes[f"position_{kind}"] for kind in ("before", "after")}
        full = max(size or 0.0 for size in ends.values()) or 1.0
        drawn = "".join(
            f'<span class="bar {kind}" style="width:{100 * size / full:.1f}%"></span>'
            for kind, size in ends.items()
            if size is not None
        )
        body.append(
            [
                Cell(f"{escape(str(name))} {badge(str(own['provenance'].iloc[0]))}", "text"),
                Cell(drawn, "picture"),
                f"{number(sizes['position_before'], 3)} → <b>{number(sizes['position_after'], 3)}</b>",
                f"{number(sizes['velocity_before'], 3)} → <b>{number(sizes['velocity_after'], 3)}</b>",
                improving(own),
                str(int(own["windows"].iloc[0])),
            ]
        )
    heads = [
        "Arm",
        key("before", "before") + key("after", "after"),
        "position [rad]",
        "velocity [rad/s]",
        "joints that improve",
        "windows",
    ]
    return f'<div class="drawn">{table(heads, body, "Median joint, before → after")}</div>'


def _joints(own: pd.DataFrame) -> str:
    body: list[list[Cell | str]] = []
    for _, row in own.iterrows():
        ends = {key: known(row[key]) for key in own.columns if key.endswith(("_before", "_after"))}
        cells = [
            Cell(number(ends[f"{what}_{when}"], 3), "best" if _is_best(ends, what, when) else "")
            for what in ("position", "velocity")
            for when in ("before", "after")
        ]
        body.append([Cell(escape(str(row["joint"])), "text"), *cells])
    heads = ["Joint", "position before [rad]", "after", "velocity before [rad/s]", "after"]
    return table(heads, body)


def _is_best(ends: dict[str, float | None], what: str, when: str) -> bool:
    own = ends[f"{what}_{when}"]
    there = [size for size in (ends[f"{what}_before"], ends[f"{what}_after"]) if size is not None]
    return own is not None and own == min(there)
