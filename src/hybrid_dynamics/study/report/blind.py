"""The section on effects hidden in simulated logs: one small function a table, all from ``blind.csv``."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import pandas as pd

from hybrid_dynamics.loop_report.html import Cell, details, escape, table
from hybrid_dynamics.loop_report.words import title_of
from hybrid_dynamics.study.blind_score import LISTED, LOOP_SECONDS, NAMED
from hybrid_dynamics.study.blind_table import (
    LONG,
    NOTHING,
    SIZE,
    clean,
    effects_of,
    found,
    missing,
    pairs,
    read_cases,
    strange,
    truth,
    words,
)
from hybrid_dynamics.study.intervals import clopper_pearson, counted
from hybrid_dynamics.study.report.pieces import frame_table
from hybrid_dynamics.study.results import Section

#: Edges of the sizes over which detection is counted.
SIZES = (0.0, 1.0, 1.5, 2.0, 3.0, 6.0, 12.0, math.inf)
Row = list[Cell | str]


def blind_section(path: Path) -> Section | None:
    """Undeclared effects hidden in simulation and found again; ``path`` is ``blind.csv``."""
    if not path.exists():
        return None
    cases = read_cases(path)
    effects = effects_of(cases)
    known = cases[~strange(cases)]
    html = (
        "<p>Causes hidden in simulated logs, unknown to the loop: by the study's own engine, and by MuJoCo with forms "
        "that the catalogue may not have. The size of an effect is the torque that it alone explains, in noise floors; "
        f"from {SIZE:g} on it must be found, below {NOTHING:g} nothing is missing. The true model's error is on the "
        "same processed data.</p>"
        + shares(known)
        + detection(effects)
        + families(effects)
        + confusion(cases)
        + model_errors(known)
        + verdicts(cases)
        + cost(cases)
        + misses(cases)
    )
    return Section("blind", "Undeclared effects in simulation", html)


def shares(known: pd.DataFrame) -> str:
    """Cases inside the catalogue by the number of hidden effects: all named, nothing wrong named."""
    planted = known["hidden"].map(lambda names: len(words(names)))
    rows: list[Row] = []
    for (robot, count), own in known.groupby([known["robot"], planted]):
        right = truth(own["named_right"]) & truth(own["nothing_wrong_named"])
        rows.append(
            [
                Cell(escape(str(robot)), "text"),
                str(count) if count else "nothing",
                counted(int(right.sum()), len(own)),
                counted(int(clean(own).sum()), len(own)),
            ]
        )
    heads = ["Robot", "Effects hidden", "All named right, nothing else", "Nothing wrong named"]
    caption = (
        "Cases inside the catalogue; where nothing is hidden, what is named is a false alarm. A name is not wrong "
        "where it lists what was hidden as doing as well"
    )
    return table(heads, rows, caption) if rows else ""


def detection(effects: pd.DataFrame) -> str:
    """Share found against the size of an effect, for logs of :data:`LONG` s or more and for shorter ones."""
    out = ""
    for long in (True, False):
        own = effects[(effects["seconds"] >= LONG) == long]
        rows = [row for low, high in pairwise(SIZES) if (row := _detected(own, low, high))]
        if rows:
            length = f"{LONG:g} s or more" if long else f"less than {LONG:g} s"
            caption = f"Found against size, logs of {length} in total (frame: the 95 % interval)"
            heads = ["Size [floors]", "Named or listed", "Effects", "of these named"]
            out += f'<div class="drawn">{table(heads, rows, caption)}</div>'
    return out


def _detected(effects: pd.DataFrame, low: float, high: float) -> Row | None:
    own = effects[(effects["size"] >= low) & (effects["size"] < high)]
    if not len(own):
        return None
    hits, total = int(found(own).sum()), len(own)
    least, most = clopper_pearson(hits, total)
    drawn = (
        f'<span class="bar after" style="width:{100 * hits / total:.1f}%"></span>'
        f'<span class="bar floor" style="left:{100 * least:.1f}%;width:{100 * (most - least):.1f}%"></span>'
    )
    span = f"{low:g} to {high:g}" if math.isfinite(high) else f"above {low:g}"
    named = int((own["outcome"] == NAMED).sum())
    return [span, Cell(drawn, "picture"), counted(hits, total), str(named)]


def families(effects: pd.DataFrame) -> str:
    """Every family: found above :data:`SIZE` floors; where named in cases inside the catalogue, how right it is."""
    rows: list[Row] = []
    for name, own in effects.groupby("effect"):
        large = own[(own["size"] >= SIZE) & (own["seconds"] >= LONG)]
        inside = own[(~own["strange"].astype(bool)) & (own["size"] >= SIZE)]
        checked, within = int(inside["checked"].sum()), int(inside["within"].sum())
        rows.append(
            [
                Cell(escape(str(name)), "text"),
                counted(int(found(large).sum()), len(large)) if len(large) else "–",
                str(int((large["outcome"] == LISTED).sum())),
                *_quantiles(inside["parameter_error"].dropna().astype(float)),
                counted(within, checked) if checked else "–",
            ]
        )
    if not rows:
        return ""
    heads = ["Family", "Named or listed", "of these listed", "Parameter error, median", "90th percentile"]
    caption = (
        f"Effects of {SIZE:g} floors or more; found in logs of {LONG:g} s or more, parameters where the hidden form is "
        "the catalogue's"
    )
    return table([*heads, "Parameters within two standard errors"], rows, caption)


def _quantiles(errors: pd.Series) -> list[str]:
    if not len(errors):
        return ["–", "–"]
    return [f"{100 * errors.median():.2g} %", f"{100 * errors.quantile(0.9):.2g} %"]


def confusion(cases: pd.DataFrame) -> str:
    """Hidden causes (rows) and what was named in their place (columns)."""
    both = pairs(cases)
    if not len(both):
        return ""
    counts = pd.crosstab(both["hidden"], both["named"])
    heads = [*(name for name in counts.index if name in counts.columns), *counts.columns.difference(counts.index)]
    rows: list[Row] = []
    for name in counts.index:
        cells = [
            Cell(str(counts.loc[name, head]) if counts.loc[name, head] else "·", "best" if head == name else "")
            for head in heads
        ]
        rows.append([Cell(escape(title_of(str(name))), "text"), *cells])
    caption = (
        "Hidden (rows) and named where it sits (columns), all cases and sizes; forms that the catalogue lacks have no "
        "column of their own"
    )
    return table(
        ["Hidden", *(f"<span>{escape(title_of(str(h)))}</span>" for h in heads)], rows, caption, kind="confusion"
    )


def model_errors(known: pd.DataFrame) -> str:
    """Held-out error before and after, over the true model's, on the joint where after is worst."""
    rows: list[Row] = []
    for (engine, lacking), own in known.groupby(["engine", missing(known)]):
        after = own["rmse_after"] / own["rmse_true_model"]
        before = own["rmse_before"] / own["rmse_true_model"]
        rows.append(
            [
                Cell(escape(str(engine)), "text"),
                "something" if lacking else "nothing",
                f"{before.median():.3g}",
                f"{after.median():.3f}",
                f"{after.quantile(0.9):.3f}",
                f"{after.max():.3f}",
                counted(int((after <= 1.15).sum()), len(own)),
            ]
        )
    heads = ["Engine", "Missing", "Before, median", "After, median", "90th percentile", "worst", "at most 1.15"]
    caption = "Held-out error over the true model's, cases inside the catalogue"
    return table(heads, rows, caption) if rows else ""


def verdicts(cases: pd.DataFrame) -> str:
    """What was said of cases in which something, nothing, or a form beyond the catalogue was hidden."""
    beyond, lacking = strange(cases), missing(cases)
    kinds = {"Nothing missing": ~lacking, "Effects of the catalogue": lacking & ~beyond, "A form it lacks": beyond}
    rows: list[Row] = []
    for kind, chosen in kinds.items():
        for verdict, own in cases[chosen].groupby("verdict"):
            wrong = int((~clean(own)).sum())
            total = counted(len(own), int(chosen.sum()))
            laws = int(own["other_laws"].map(lambda names: bool(words(names))).sum())
            rows.append([kind, Cell(escape(str(verdict).replace("_", " ")), "text"), total, str(wrong), str(laws)])
    caption = (
        "Verdicts; a wrong name beside an all-clear is the worst that can be said. Another law: the effect named is "
        "the one hidden, with the law that the catalogue has of it (Stribeck's of another exponent)"
    )
    heads = ["Hidden", "Verdict", "Cases", "with a wrong name", "another law named"]
    return table(heads, rows, caption) if rows else ""


def cost(cases: pd.DataFrame) -> str:
    """How many other explanations are listed, and how long the loop took."""
    text = f"<p>Listed alternatives: {cases['alternatives'].mean():.2f} a case on average"
    if LOOP_SECONDS in cases and cases[LOOP_SECONDS].notna().any():
        took = cases[LOOP_SECONDS].dropna()
        text += (
            f". Processor time of the loop: {took.median():.1f} s (median), {took.quantile(0.9):.1f} s (90th "
            f"percentile), {took.max():.1f} s (longest)"
        )
    return text + ".</p>"


def misses(cases: pd.DataFrame) -> str:
    """The cases in which something large was missed or something wrong named."""

    def missed(case: pd.Series) -> bool:
        both = zip(words(case["sizes"]), words(case["outcomes"]), strict=True)
        return any(float(size) >= SIZE and outcome not in (NAMED, LISTED) for size, outcome in both)

    off = cases.apply(missed, axis=1).astype(bool) | ~clean(cases)
    shown = ["case", "robot", "hidden", "hidden_joints", "unknown_forms", "sizes", "outcomes", "wrong", "stand_ins"]
    own = cases.loc[off, [*shown, "verdict", "seconds", "noise"]]
    if not len(own):
        return ""
    head = "The case that was not right" if len(own) == 1 else f"The {len(own)} cases that were not right"
    return details(head, frame_table(own.astype(object).fillna("")))
