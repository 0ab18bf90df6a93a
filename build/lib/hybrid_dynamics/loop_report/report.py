"""``report.html`` of one loop, self-contained: verdict in plain words, what was named, before and after, evidence."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

from hybrid_dynamics.loop.augment import Step
from hybrid_dynamics.loop.close import LoopResult
from hybrid_dynamics.loop_report.figures import effect_figure, torque_figure

VERDICTS = {
    "explained": "What the model lacked has been found and added: on held-out data the error is down to the noise.",
    "partly_explained": "Part of what the model lacks has been found and added; something remains that no effect of "
    "the catalogue explains.",
    "unexplained": "Something is missing that no effect of the catalogue explains; nothing was added.",
    "nothing_missing": "Nothing is missing: the model already predicts the measured torque down to the noise.",
}
STYLE = """
body{font:16px/1.5 system-ui,sans-serif;max-width:68rem;margin:2rem auto;padding:0 1rem;color:#222}
h1{font-size:1.6rem}h2{font-size:1.2rem;margin-top:2rem;border-bottom:1px solid #ddd}
table{border-collapse:collapse;margin:.6rem 0;font-size:.9rem}td,th{padding:.2rem .7rem;border-bottom:1px solid #e5e5e5}
th{text-align:left;background:#f6f6f4}td.n{text-align:right;font-variant-numeric:tabular-nums}
.verdict{background:#eef4f6;border-left:4px solid #1f6f8b;padding:.6rem 1rem}.note{color:#7a5a00}
svg{max-width:100%;height:auto}
details{margin:.4rem 0}summary{cursor:pointer}
"""
MAX_FIGURES = 24


def report_html(result: LoopResult) -> str:
    """The page as one string; the same result gives the same bytes."""
    d = result.diagnosis
    parts = [
        "<!DOCTYPE html><html lang='en'><head><meta charset='utf-8'>",
        f"<title>Closed loop: {escape(d['robot'])}</title><style>{STYLE}</style></head><body>",
        f"<h1>What the model of {escape(d['robot'])} lacks</h1>",
        f"<p class='verdict'><b>{escape(d['verdict'].replace('_', ' '))}.</b> {VERDICTS[d['verdict']]}</p>",
        *(f"<p class='note'>Note: {escape(note)}.</p>" for note in d["notes"]),
        _errors(d),
        _effects(d),
        _unexplained(d),
    ]
    effects = result.model.effects[len(result.stages[0].effects) :]
    if effects:
        parts.append("<h2>Residual on held-out runs, before and after each effect</h2>")
    for k, effect in enumerate(effects[:MAX_FIGURES]):
        where = effect.joints[0] if effect.joints else "whole robot"
        parts.append(f"<h3>{k + 1}. {escape(effect.effect)} ({escape(where)})</h3>")
        parts.append(effect_figure(effect, result.stages[k], result.stages[k + 1], result.test))
    if len(effects) > MAX_FIGURES:
        parts.append(f"<p>{len(effects) - MAX_FIGURES} further figures are left out.</p>")
    parts.append("<h2>Torque of a held-out run</h2>")
    parts.append(torque_figure(result.stages[0], result.model, result.test))
    parts.append(_evidence(result.steps, d["joints"], result))
    parts.append("</body></html>\n")
    return "\n".join(part for part in parts if part)


def _number(value: float | None, digits: int = 4) -> str:
    return "–" if value is None else f"{value:.{digits}g}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def cell(text: str) -> str:
        numeric = text[:1].isdigit() or text[:1] in "-–." or text[:2] == "± "
        return f"<td class='n'>{escape(text)}</td>" if numeric else f"<td>{escape(text)}</td>"

    body = "".join(f"<tr>{''.join(cell(t) for t in row)}</tr>" for row in rows)
    return f"<table><tr>{''.join(f'<th>{escape(h)}</th>' for h in head)}</tr>{body}</table>"


def _errors(d: dict[str, Any]) -> str:
    rows = []
    test, moving = d["error"]["test"], d["error_moving"]["test"]
    for j, name in enumerate(d["joints"]):
        rows.append(
            [
                name,
                *(_number(test[k]["rmse"][j]) for k in ("before", "after")),
                *(_number(test[k]["relative_rmse"][j], 3) for k in ("before", "after")),
                *(_number(moving[k]["rmse"][j]) for k in ("before", "after")),
                _number(d["noise_floor"][j]),
            ]
        )
    head = (
        "joint", "rmse before [N m]", "after", "relative rmse before", "after", "rmse while moving before [N m]",
        "after", "noise floor [N m]",
    )  # fmt: skip
    pooled = " → ".join(_number(test[k]["relative_error"], 3) for k in ("before", "after"))
    return (
        "<h2>Error on held-out runs</h2>"
        + _table(head, rows)
        + f"<p>Pooled relative error: {pooled}. Near standstill the friction torque is not determined by the motion, "
        "so the samples in which a joint stands still are also left out for comparison.</p>"
    )


def _effects(d: dict[str, Any]) -> str:
    if not d["effects"]:
        return ""
    out = ["<h2>Effects, in the order they were added</h2>"]
    rows = []
    for entry in d["effects"]:
        where = entry["joints"][0] if entry["joints"] else "whole robot"
        settings = ", ".join(f"{k} = {v}" for k, v in entry["settings"].items())
        for k, p in enumerate(entry["parameters"]):
            left = [entry["effect"], where, settings] if k == 0 else ["", "", ""]
            open_ = " (left open by the data)" if p["name"] in entry.get("undetermined_parameters", []) else ""
            rows.append([*left, p["name"] + open_, _number(p["value"]), f"± {_number(p['std_error'], 2)}", p["unit"]])
    out.append(_table(("effect", "joint", "settings", "parameter", "value", "standard error", "unit"), rows))
    out.append(
        "<p>A standard error says how well these samples determine the parameter. An error of the torque's calibration "
        "(drive gains) comes on top: it scales masses and friction alike. A negative change lessens an effect that the "
        "starting model has.</p>"
    )
    if any(entry["settings"] for entry in d["effects"]):
        out.append(
            "<p>At a reversal the sign of friction turns over a speed (sign_width [rad/s]), over a travel (sign_travel "
            "[rad]; a joint at rest then keeps the friction of its last motion), or, without a setting, at once.</p>"
        )
    for entry in d["effects"]:
        where = entry["joints"][0] if entry["joints"] else "whole robot"
        for other in entry["indistinguishable_from"]:
            names = " and ".join(f"{e['effect']} ({', '.join(e['joints']) or 'whole robot'})" for e in other["effects"])
            out.append(
                f"<p><b>{escape(entry['effect'])} ({escape(where)})</b> cannot be told from {escape(names)}: "
                f"{escape(other['why'])}. {escape(other['motion_that_would_tell'])}</p>"
            )
        for item in entry.get("inconsistent_between_runs", []):
            values = "; ".join(
                f"{r['run']}: {_number(r['value'])} ± {_number(r['std_error'], 2)} {item['unit']}" for r in item["runs"]
            )
            out.append(
                f"<p class='note'><b>{escape(entry['effect'])} ({escape(where)})</b>: {escape(item['parameter'])} is "
                f"inconsistent between runs: {escape(values)}</p>"
            )
    return "".join(out)


def _unexplained(d: dict[str, Any]) -> str:
    if not d["unexplained"]:
        return ""
    rows = [
        [u["joint"], _number(100 * u["share_of_residual_variance"], 3) + " %", u["expression"]]
        for u in d["unexplained"]
    ]
    head = ("joint", "of what is left, share that is not noise", "expression found for it [N m]")
    return "<h2>What no effect explains</h2>" + _table(head, rows)


def _evidence(steps: Sequence[Step], joints: Sequence[str], result: LoopResult) -> str:
    out = [
        "<h2>Evidence, step by step</h2><p>Score: held-out squared error in squared noise floors, per sample. Of the "
        "candidates within one standard error of the best, the simplest is taken.</p>"
    ]
    for number, step in enumerate(steps, 1):
        what = "" if step.slot is None else f" {step.slot.effect}{_place(step.slot.joint, joints)}"
        rows = [
            [
                c.slot.effect,
                "whole robot" if c.slot.joint is None else joints[c.slot.joint],
                ", ".join(f"{k} = {v}" for k, v in c.slot.settings),
                _number(c.score),
                _number(c.gain),
                f"± {_number(c.gain_error, 2)}",
                c.reason,
            ]
            for c in step.table
        ]
        head = ("effect", "joint", "settings", "score", "gain", "standard error", "judgement")
        table = _table(head, rows) if rows else ""
        out.append(f"<details><summary>Step {number}: {escape(step.action)}{escape(what)}</summary>{table}</details>")
    return "".join(out)


def _place(joint: int | None, joints: Sequence[str]) -> str:
    return "" if joint is None else f" ({joints[joint]})"
