"""A diagnosis in words for the terminal: what is missing first, then what is not settled, then the numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

#: Effects whose first parameter alone says too little.
_SHOWN_PARAMETERS = {"gravity_tilt": 2, "stribeck_friction": 3, "torque_ripple": 3, "joint_spring": 2, "drift": 2}
_MOST = 4


def headline(diagnosis: Mapping[str, Any]) -> str:
    """One line: ``missing: payload 1.47 kg; held-out error 22.8 % → 0.62 %``."""
    verdict = diagnosis["verdict"]
    phrases = effect_phrases([e for e in diagnosis["effects"] if e.get("confirmed", True)])
    if len(phrases) > _MOST:
        phrases = [*phrases[:_MOST], f"{len(phrases) - _MOST} more"]
    named = "; ".join(phrases)
    error = _error_change(diagnosis["error"]["test"])
    if verdict == "nothing_missing":
        return f"nothing is missing; {_error_now(diagnosis['error']['test'])}"
    if not named:
        return f"something is missing, but nothing known explains it; {error}"
    if verdict == "explained":
        return f"missing: {named}; {error}"
    return f"missing, and not all: {named}; {error}"


def effect_phrases(effects: Sequence[Mapping[str, Any]]) -> list[str]:
    """``payload 1.47 kg``, ``viscous friction 2 N m s/rad on joint_1``; the same effect on several joints is one."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for entry in effects:
        groups.setdefault(entry["effect"], []).append(entry)
    out = []
    for name, entries in groups.items():
        words = name.replace("_", " ")
        if len(entries) == 1:
            where = f" on {entries[0]['joints'][0]}" if entries[0]["joints"] else ""
            out.append(" ".join(f"{words} {_values(entries[0])}".split()) + where)
            continue
        places = [entry["joints"][0] for entry in entries if entry["joints"]]
        where = f"on {', '.join(places)}" if len(places) <= 3 else f"on {len(places)} joints"
        out.append(f"{words} {_range(entries)}{where}")
    return out


def details(diagnosis: Mapping[str, Any]) -> list[str]:
    """What is not settled, a line each: beyond noise, contradicted, alike, inconsistent between runs, out of reach."""
    out = []
    alarms = diagnosis.get("motion_dependent") or [False] * len(diagnosis["joints"])
    told = {entry["joint"] for entry in diagnosis["unexplained"]}
    doubts = dict(zip(diagnosis["joints"], diagnosis.get("cannot_tell", []), strict=False))
    for entry in diagnosis["unexplained"]:
        share = entry["share_of_residual_variance"]
        looks = f"; it looks like {entry['expression']}" if entry.get("expression", "0") != "0" else ""
        if doubts.get(entry["joint"]):
            out.append(
                f"cannot tell: {entry['joint']}: what is left may be slow noise or an effect that is missing{looks}"
            )
        else:
            out.append(f"not down to noise: {entry['joint']}: {share:.0%} of what is left is no noise{looks}")
    for joint, alarm in zip(diagnosis["joints"], alarms, strict=False):
        if alarm and joint not in told:
            out.append(f"not down to noise: {joint}: what is left depends on the motion")
    for entry in diagnosis["effects"]:
        what = _place(entry)
        if not entry.get("confirmed", True):
            why = f": {entry['why_not']}" if entry.get("why_not") else ""
            out.append(f"contradicted by the test runs: {what}{why}")
        for other in entry.get("indistinguishable_from", []):
            names = " and ".join(_place(e) for e in other["effects"])
            tell = (
                f"; what would tell: {other['motion_that_would_tell']}" if other.get("motion_that_would_tell") else ""
            )
            out.append(f"cannot be told apart: {what} and {names}: {other['why']}{tell}")
        if entry.get("undetermined_parameters"):
            out.append(f"left open by these motions: {', '.join(entry['undetermined_parameters'])} of {what}")
        for inconsistent in entry.get("inconsistent_between_runs", []):
            runs = ", ".join(f"{r['run']} {r['value']:.3g}" for r in inconsistent["runs"])
            out.append(f"differs between runs: {inconsistent['parameter']} of {what} [{inconsistent['unit']}]: {runs}")
    for entry in diagnosis.get("not_identifiable", []):
        out.append(f"out of reach: {entry['joint']}: {entry['why']}")
    return out


def parameter_lines(diagnosis: Mapping[str, Any]) -> list[str]:
    """Every effect with its parameters and standard errors."""
    out = []
    for entry in diagnosis["effects"]:
        values = ", ".join(_with_error(p) for p in entry["parameters"])
        mark = "" if entry.get("confirmed", True) else " (contradicted, not in the model)"
        out.append(f"{_place(entry)}: {values}{mark}" if values else f"{_place(entry)}{mark}")
    return out


def joint_rows(diagnosis: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the table of held-out errors [N m]."""
    test = diagnosis["error"]["test"]
    final = test.get("after_confirmed", test["after"])
    low, high = (diagnosis.get(f"noise_floor_{side}") for side in ("low", "high"))
    rows = []
    for j, name in enumerate(diagnosis["joints"]):
        floor = f"{diagnosis['noise_floor'][j]:.3g}"
        if low and high:
            floor += f" ({low[j]:.3g} to {high[j]:.3g})"
        rows.append([name, f"{test['before']['rmse'][j]:.3g}", f"{final['rmse'][j]:.3g}", floor])
    return ["held-out rmse [N m]", "before", "after", "noise floor"], rows


def _place(entry: Mapping[str, Any]) -> str:
    where = f" on {entry['joints'][0]}" if entry.get("joints") else ""
    return f"{entry['effect'].replace('_', ' ')}{where}"


def _values(entry: Mapping[str, Any]) -> str:
    shown = entry["parameters"][: _SHOWN_PARAMETERS.get(entry["effect"], 1)]
    several = len(shown) > 1
    return ", ".join(
        f"{p['name'].replace('_', ' ') + ' ' if several else ''}{p['value']:.3g} {p['unit']}".rstrip(" -–")
        for p in shown
    )


def _range(entries: Sequence[Mapping[str, Any]]) -> str:
    first = [entry["parameters"][0] for entry in entries if entry["parameters"]]
    if not first:
        return ""
    values = sorted(p["value"] for p in first)
    return f"{values[0]:.3g} to {values[-1]:.3g} {first[0]['unit']} ".replace(" – ", " ")


def _with_error(p: Mapping[str, Any]) -> str:
    error = f" ± {p['std_error']:.2g}" if p.get("std_error") is not None else ""
    return f"{p['name']} {p['value']:.4g}{error} {p['unit']}".rstrip(" –")


def _percent(value: float | None) -> str:
    return "unknown" if value is None else f"{100 * value:.3g} %"


def _error_change(test: Mapping[str, Any]) -> str:
    final = test.get("after_confirmed", test["after"])
    return f"held-out error {_percent(test['before']['relative_error'])} → {_percent(final['relative_error'])}"


def _error_now(test: Mapping[str, Any]) -> str:
    final = test.get("after_confirmed", test["after"])
    return f"held-out error {_percent(final['relative_error'])}"
