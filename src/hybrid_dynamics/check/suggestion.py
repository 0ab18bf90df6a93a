"""Findings with one clear cure as a ``log.yaml``: what an earlier description says stays, cures come on top of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hybrid_dynamics.check.findings import Finding


def combined(
    description: Mapping[str, Any], findings: Sequence[Finding], joint_names: Sequence[str]
) -> tuple[dict[str, Any], list[str]]:
    """``description`` (plain values of a ``log.yaml``) with the cures of ``findings``, and a line for each cure.

    A cure that contradicts one that is already in is left out: then there is not one clear cure.
    """
    out = {key: dict(value) if isinstance(value, Mapping) else value for key, value in description.items()}
    told: list[str] = []
    taken: set[str] = set()
    for finding in findings:
        if finding.severity == "note" or not finding.suggestion:
            continue
        keys = {f"{k}.{s}" if isinstance(v, Mapping) else k for k, v in finding.suggestion.items() for s in _parts(v)}
        if keys & taken:
            continue
        taken |= keys
        # What was added to a signal is turned round with it; then its own offset comes on top.
        for signal, value in finding.suggestion.get("sign", {}).items():
            if (old := out.get("offset", {}).get(signal)) is not None:
                out["offset"][signal] = _product(old, value)
        for key, value in finding.suggestion.items():
            out[key] = _entered(key, out.get(key), value, joint_names)
        told.append(f"mends {finding.code}: {', '.join(sorted(keys))} ({finding.text.split(';')[0]})")
    return out, told


def _parts(value: Any) -> list[str]:
    return [str(k) for k in value] if isinstance(value, Mapping) else [""]


def _entered(key: str, old: Any, new: Any, joints: Sequence[str]) -> Any:
    """The value of ``key`` that does what ``old`` did and then what ``new`` asks for."""
    if key in ("torque_delay", "velocity_delay"):
        return round(float(old or 0.0) + float(new), 6)
    if key == "drop":
        return sorted({*(old or []), *new})
    if isinstance(new, str):
        return new
    both = dict(old or {})
    for signal, value in new.items():
        if key in ("sign", "gain"):
            both[signal] = _product(both.get(signal), value)
        elif key == "offset":
            both[signal] = _sum(both.get(signal), value)
        elif key == "columns":
            both[signal] = _picked(both.get(signal), signal, value, joints)
        else:
            both[signal] = value
    return both


def _product(old: Any, new: Sequence[float]) -> list[float]:
    values = [a * b for a, b in _both(1.0, old, new)]
    return [int(v) if v in (1.0, -1.0) else v for v in values]


def _sum(old: Any, new: Sequence[float]) -> list[float]:
    return [round(a + b, 6) for a, b in _both(0.0, old, new)]


def _both(nothing: float, old: Any, new: Sequence[float]) -> list[tuple[float, float]]:
    """Values of each joint, where one stands for all of them too; ``nothing`` where there was none."""
    given = nothing if old is None else old
    first = [float(v) for v in (given if isinstance(given, Sequence) else [given])]
    count = max(len(first), len(new))
    wide = [list(v) * (count if len(v) == 1 else 1) for v in (first, list(new))]
    return list(zip(*wide, strict=True))


def _picked(old: Any, signal: str, new: Sequence[str], joints: Sequence[str]) -> list[Any]:
    """``new`` names columns as they are read now (``tau2``): the same ones under the names that ``old`` gives them."""
    order = [int(name.removeprefix(signal)) - 1 for name in new]
    if isinstance(old, str) and "{" in old:
        return [old.format(i=k + 1, i0=k, joint=joints[k]) for k in order]
    if isinstance(old, list) and len(old) == len(new):
        return [old[k] for k in order]
    return list(new)
