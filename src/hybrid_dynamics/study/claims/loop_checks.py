"""What the closed loop set out to show on the UR10e's recordings; on hidden effects: ``blind_checks.py``."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from hybrid_dynamics.study.results import Check, DatasetResults
from hybrid_dynamics.trajectory import RECORDED

#: Held-out run on which the loop is set beside the classical baseline, joints 1 to 4.
UR10E_RUN = "14harm50sec"
#: Mass of the undeclared payload [kg] as the recordings' authors give it; the drive gains limit how well it is found.
UR10E_MASS, MASS_SHARE = 2.805, 0.15
#: Two recordings of one payload: masses agree within this share, or within two standard errors.
AGREEMENT = 0.03
#: Relative RMSE on the held-out part, joints 2 to 6.
LOAD_BOUNDS = {"load_14harm": (0.05, 0.065, 0.15, 0.13, 0.08), "load_15harm": (0.075, 0.08, 0.15, 0.29, 0.36)}


def loop_checks(result: DatasetResults) -> Iterator[Check]:
    """Claims on the recorded UR10e, from its errors and from what the loop answered."""
    if result.name != "ur10e" or result.provenance != RECORDED:
        return
    yield from _beside_baseline(result)
    calibrated = _diagnosis(result, "models/loop")
    if calibrated is not None:
        named = {joint for e in calibrated["effects"] if e["effect"].endswith("friction") for joint in e["joints"]}
        found = f"{len(named)} of {result.n_joints}"
        yield Check(result.title, "Closed loop: friction is named on every joint", found, len(named) == result.n_joints)
    answers = {name: _diagnosis(result, f"questions/{name}") for name in (*LOAD_BOUNDS, "load_both")}
    masses: list[tuple[float, float]] = []
    for name, bounds in LOAD_BOUNDS.items():
        answer = answers[name]
        if answer is None:
            continue
        first = answer["effects"][0]["effect"] if answer["effects"] else "nothing"
        mass = _mass(answer)
        if mass is not None:
            masses.append(mass)
        off = "" if mass is None else f", {mass[0]:.3f} kg ({_sure(*mass)})"
        yield Check(
            result.title,
            f"{name}: the undeclared payload is the first effect named, its mass within {100 * MASS_SHARE:g} % of "
            f"{UR10E_MASS:g} kg",
            first + off,
            first == "payload" and mass is not None and abs(mass[0] / UR10E_MASS - 1) <= MASS_SHARE,
        )
        before, after = (answer["error"]["test"][when]["relative_rmse"][1:6] for when in ("before", "after"))
        yield Check(
            result.title,
            f"{name}: held-out relative RMSE of joints 2-6 at most {_list(bounds)}",
            f"{_list(before)} → {_list(after)}",
            all(value <= bound for value, bound in zip(after, bounds, strict=True)),
        )
    if len(masses) == 2:
        (one, one_error), (two, two_error) = masses
        apart = abs(two - one)
        yield Check(
            result.title,
            f"The payload's mass in both recordings agrees within {100 * AGREEMENT:g} % or two standard errors",
            f"{100 * apart / one:.1f} % apart",
            apart <= max(AGREEMENT * one, 2 * (one_error**2 + two_error**2) ** 0.5),
        )
    both = answers["load_both"]
    if both is not None:
        inconsistent = [d["parameter"] for e in both["effects"] for d in e.get("inconsistent_between_runs", [])]
        yield Check(
            result.title,
            "Both recordings together: the payload's place is said to differ between the runs",
            f"said of {', '.join(inconsistent) or 'nothing'}",
            any(name.startswith("com_") for name in inconsistent),
        )


def _beside_baseline(result: DatasetResults) -> Iterator[Check]:
    if UR10E_RUN not in result.trajectories("test"):
        return
    table = result.run("test", UR10E_RUN)
    if "loop" not in table or "least_squares" not in table:
        return
    loop, other = (list(table[method].iloc[:4]) for method in ("loop", "least_squares"))
    yield Check(
        result.title,
        f"Closed loop on the held-out run {UR10E_RUN}, joints 1-4: relative RMSE at or below least squares",
        f"{_list(loop)} (least squares {_list(other)})",
        all(a <= b for a, b in zip(loop, other, strict=True)),
    )


def _diagnosis(result: DatasetResults, place: str) -> dict[str, Any] | None:
    path = result.folder / place / "diagnosis.json"
    return dict(json.loads(path.read_text("utf-8"))) if path.exists() else None


def _mass(answer: Mapping[str, Any]) -> tuple[float, float] | None:
    """Mass of the payload and its standard error [kg]."""
    for entry in answer["effects"]:
        if entry["effect"] == "payload":
            mass = next(p for p in entry["parameters"] if p["name"] == "mass")
            return float(mass["value"]), float(mass["std_error"])
    return None


def _sure(mass: float, error: float) -> str:
    """What is known of a mass: statistics, and the drive gains, which no statistics of these logs can see."""
    apart = mass - UR10E_MASS
    spread = f", {abs(apart) / error:.0f} standard errors" if error > 0 else ""
    return (
        f"± {error:.3f} kg from statistics alone; a drive gain that is off by 1 % moves it by {mass / 100:.3f} kg; "
        f"{100 * apart / UR10E_MASS:+.1f} % off the declared mass{spread}, so the gains, not the noise, limit it"
    )


def _list(values: Any) -> str:
    return ", ".join(f"{value:.3g}" for value in values)
