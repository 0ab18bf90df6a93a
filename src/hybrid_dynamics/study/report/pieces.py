"""The study's tables as HTML: errors beside the paper's, Table III, equations, checks."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from hybrid_dynamics.loop_report.html import Cell, details, escape, table
from hybrid_dynamics.study.claims import paper
from hybrid_dynamics.study.claims.coefficients import JointTerms, table_three
from hybrid_dynamics.study.expressions import to_mathml
from hybrid_dynamics.study.methods import REFERENCES, TORQUE_EXPRESSIONS, in_order, label
from hybrid_dynamics.study.report.tables import format_value
from hybrid_dynamics.study.results import Check, DatasetResults

TERM_HEADS = {"tau_inertia": "τ<sub>i</sub>", "tau_coriolis": "τ<sub>c</sub>", "tau_gravity": "τ<sub>g</sub>"}


def check_table(checked: Sequence[Check]) -> str:
    """The claims with the number that decides each."""
    marks = {True: ("met", "✓ met"), False: ("missed", "✗ not met"), None: ("open", "reported")}
    rows: list[list[Cell | str]] = []
    for check in checked:
        kind, text = marks[check.met]
        rows.append(
            [
                Cell(escape(check.dataset), "text"),
                Cell(escape(check.claim), "text"),
                Cell(escape(check.measured), "text"),
                "–" if check.n is None else str(check.n),
                Cell(f'<span class="{kind}">{text}</span>', "text"),
            ]
        )
    return table(["Dataset", "Claim", "Measured", "n", "Verdict"], rows, kind="claims")


def error_table(result: DatasetResults, split: str, caption: str, reference: paper.ErrorTable | None) -> str:
    """Relative RMSE per joint and method, pooled over the runs of ``split``; the paper's value below ours."""
    errors = result.pooled(split)
    pooled = result.pooled(split, "relative_error").iloc[0]
    return _error_rows(errors, pooled, caption, reference)


def run_tables(result: DatasetResults, split: str) -> str:
    """One error table for each run of ``split``, folded away; nothing where there is one run."""
    runs = result.trajectories(split)
    if len(runs) < 2:
        return ""
    parts = [
        _error_rows(
            result.run(split, run), result.run(split, run, "relative_error").iloc[0], f"<b>{escape(run)}</b>", None
        )
        for run in runs
    ]
    kind = "held-out" if split == "test" else "training"
    return details(f"Each {kind} run by itself ({len(runs)} runs)", "\n".join(parts))


def _error_rows(errors: pd.DataFrame, pooled: pd.Series, caption: str, reference: paper.ErrorTable | None) -> str:
    """A row per method, so that no method leaves the page; a column per joint, pooled first."""
    learned = [m for m in errors.columns if m not in REFERENCES]
    least = errors[learned].min(axis=1)
    best = min((float(pooled[m]) for m in learned if math.isfinite(pooled[m])), default=math.nan)
    rows: list[list[Cell | str]] = []
    for method in errors.columns:
        whole = float(pooled[method])
        row = [Cell(escape(label(str(method))), "text"), Cell(format_value(whole), "best" if whole == best else "")]
        for joint in errors.index:
            value = float(errors.loc[joint, method])
            kind = "best" if method in learned and value == least[joint] else "poor" if value > 1 else ""
            text = format_value(value)
            theirs = reference.value(str(method), int(joint)) if reference else None
            if theirs is not None:
                text += f'<small class="paper">paper {theirs:.3f}</small>'
            row.append(Cell(text, kind))
        rows.append([*row])
    return table(["Method", "pooled", *(f"joint {joint}" for joint in errors.index)], rows, caption, kind="errors")


def joint_errors(result: DatasetResults, split: str) -> str:
    """RMSE in N m per joint and method, folded away."""
    errors = result.pooled(split, "rmse")
    rows: list[list[Cell | str]] = [
        [Cell(escape(label(str(method))), "text"), *(Cell(f"{value:.4g}") for value in errors[method])]
        for method in errors.columns
    ]
    kind = "Held-out" if split == "test" else "Training"
    return details(f"{kind} RMSE in N m", table(["Method", *(f"joint {j}" for j in errors.index)], rows))


def best_beside_rigid_body(result: DatasetResults) -> str:
    """Per joint on the held-out runs: the rigid body alone and the best learned model side by side."""
    errors = result.pooled("test")
    if "rigid_body" not in errors or len(errors.columns) < 2:
        return ""
    # A joint whose torque does not vary has no relative error; it has no row here.
    errors = errors.dropna(how="all")
    learned = errors.drop(columns=list(REFERENCES), errors="ignore")
    rows: list[list[Cell | str]] = []
    for joint in errors.index:
        best = str(learned.loc[joint].idxmin())
        before, after = float(errors.loc[joint, "rigid_body"]), float(learned.loc[joint, best])
        rows.append(
            [
                f"{joint} <span class='muted'>{escape(result.joint_names[int(joint) - 1])}</span>",
                format_value(before),
                Cell(format_value(after), "best"),
                Cell(escape(label(best)), "text"),
                _times(before, after),
            ]
        )
    caption = f"<b>{escape(result.title)}</b>: relative RMSE on the held-out runs, before and after"
    return table(["Joint", "Rigid body alone", "Best model", "which", "Better by"], rows, caption)


def _times(before: float, after: float) -> str:
    if not after > 0:
        return "–"
    ratio = before / after
    return f"{ratio:,.0f}×" if ratio >= 100 else f"{ratio:.3g}×"


def table_three_html(result: DatasetResults) -> str:
    """Table III: one table a method, a row a joint, ours above the paper's value in every cell."""
    entries = list(table_three(result))
    parts = []
    for method in in_order(entry.method for entry in entries):
        own = [entry for entry in entries if entry.method == method]
        exact = sum(entry.exact for entry in own)
        summary = f"{label(method)}: exactly the true terms on {exact} of {len(own)} joints"
        parts.append(details(summary, _terms_table(result, method, own)))
    return "\n".join(parts)


def _terms_table(result: DatasetResults, method: str, entries: Sequence[JointTerms]) -> str:
    whole = method in TORQUE_EXPRESSIONS
    counterpart = paper.COUNTERPART.get(method, method)
    # The paper prints only the second layer of r-SINDy-SR: its terms are no counterpart of our summed residual.
    second_layer = counterpart == "r_sindy_sr"
    rows: list[list[Cell | str]] = []
    for entry in entries:
        row: list[Cell | str] = [str(entry.joint)]
        for name in [*TERM_HEADS] if whole else []:
            row.append(_coefficient(entry, f"{name}{entry.joint}", 5, True))
        damping = f"dq{entry.joint}"
        row.append(_coefficient(entry, damping, 5, not second_layer))
        deviation = entry.relative_error(damping)
        true = entry.truth[damping]
        off = "–" if deviation is None else f"{100 * deviation:.3f} %"
        row.append(f"{true:g}<small class='paper'>off by {off}</small>")
        row.append(_others(entry, second_layer))
        row.append(Cell('<span class="met">✓</span>' if entry.exact else '<span class="missed">✗</span>'))
        rows.append(row)
    heads = ["Joint", *(TERM_HEADS.values() if whole else []), "damping on dq<sub>j</sub>", "true D", "other terms"]
    kind = "torque" if whole else "residual"
    note = " The paper prints its second layer only." if second_layer else ""
    caption = f"<b>{escape(label(method))}</b>: coefficients of the {kind}, {escape(result.title)}.{note}"
    return table([*heads, "exactly the true terms"], rows, caption)


def _coefficient(entry: JointTerms, term: str, digits: int, beside: bool) -> Cell:
    if entry.found is None:
        ours = "<span class='muted'>–</span>"
    elif term in entry.found:
        ours = f"{entry.found[term]:.{digits}f}"
    else:
        ours = "<span class='muted'>none</span>" if term not in entry.truth else "<span class='missed'>missing</span>"
    if not beside:
        return Cell(ours)
    theirs = f"{entry.paper[term]:g}" if term in entry.paper else "none"
    return Cell(f'{ours}<small class="paper">paper {theirs}</small>')


def _others(entry: JointTerms, second_layer: bool) -> Cell:
    if entry.found is None:
        ours = f"<span class='missed'>{entry.count} terms</span>"
    elif len(entry.extra) > 4:
        ours = f"<span class='missed'>{len(entry.extra)} more terms</span>"
    else:
        ours = ", ".join(to_mathml(f"{entry.found[term]:.4g}*{term}") for term in entry.extra)
    theirs = {term: value for term, value in entry.paper.items() if second_layer or term not in entry.truth}
    shown = ", ".join(to_mathml(f"{value:g}*{term}") for term, value in theirs.items()) or "none"
    return Cell(f'{ours or "none"}<small class="paper">paper {shown}</small>', "text")


def equations(result: DatasetResults, beside: bool = False) -> str:
    """The expressions of every method, folded by method; ``beside`` adds the paper's WAM equations."""
    parts = []
    for method in in_order(result.expressions["method"]):
        rows: list[list[Cell | str]] = []
        own = result.expressions[result.expressions["method"] == method].sort_values("joint")
        theirs = paper.WAM_EQUATIONS.get(method, {}) if beside else {}
        for row in own.to_dict("records"):
            line: list[Cell | str] = [str(row["joint"]), Cell(to_mathml(str(row["expression"])), "text")]
            if theirs:
                line.append(Cell(to_mathml(theirs[int(row["joint"])]) if int(row["joint"]) in theirs else "", "text"))
            rows.append(line)
        kind = "torque" if method in TORQUE_EXPRESSIONS else "residual"
        heads = ["Joint", f"Ours: {kind} [N m]", *(["The paper's"] if theirs else [])]
        content = table(heads, rows)
        parts.append(f"<h4>{escape(label(method))}</h4>{content}" if theirs else details(label(method), content))
    return "\n".join(parts)


def frame_table(frame: pd.DataFrame, caption: str = "") -> str:
    """A data frame as it is: numbers with four significant digits, everything else as text."""

    def cell(value: object) -> Cell:
        if isinstance(value, bool) or not isinstance(value, int | float):
            return Cell(escape(str(value)), "text")
        if isinstance(value, float):
            return Cell(f"{value:.4g}" if math.isfinite(value) else "–")
        return Cell(str(value))

    rows = [[cell(value) for value in row] for row in frame.astype(object).itertuples(index=False, name=None)]
    return table([escape(str(name)) for name in frame.columns], rows, caption)
