"""What a diagnosis says as metrics, parameters and tags.

Two results are compared key by key, so a key says what and where and nothing that changes from run to run:
``parameter/coulomb_friction/joint3/coulomb_torque`` is the same in every calibration of an arm.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from hybrid_dynamics.effects import family
from hybrid_dynamics.effects.law import FROM_JOINT
from hybrid_dynamics.loop.diagnosis import Change, Diagnosis, NamedEffect
from hybrid_dynamics.loop.model import effect_to_json

#: What stands where an effect acts on no joint in particular.
ROBOT = "robot"
_PER_JOINT = (
    "noise_floor",
    "noise_floor_low",
    "noise_floor_high",
    "learnable_share",
    "motion_dependent",
    "cannot_tell",
    "worse_on_test",
    "worse_than_start",
    "beyond_friction",
    "autocorrelation",
)


@dataclass(frozen=True)
class Identified:
    """``metrics`` are finite; ``params`` name the joints of every kind of effect; ``tags`` hold the verdict."""

    metrics: Mapping[str, float]
    params: Mapping[str, str]
    tags: Mapping[str, str]


def identified(diagnosis: Diagnosis) -> Identified:
    """Everything of ``diagnosis`` by which two results can be compared; SI units as in the catalogue."""
    metrics = {**dict(_parameters(diagnosis)), **dict(_errors(diagnosis)), **dict(_joints(diagnosis))}
    metrics["effects/named"] = float(len(diagnosis.effects))
    metrics["effects/confirmed"] = float(len(diagnosis.confirmed))
    return Identified(
        {key: value for key, value in metrics.items() if math.isfinite(value)},
        {"verdict": diagnosis.verdict, **_places(diagnosis)},
        {"verdict": diagnosis.verdict, "robot": diagnosis.robot, "effects": summary(diagnosis)},
    )


def summary(diagnosis: Diagnosis) -> str:
    """``coulomb_friction (3 joints), payload``: what stands in the model, for a column of a table."""
    joints: dict[str, set[str]] = {}
    for entry in diagnosis.confirmed:
        joints.setdefault(entry.effect.effect, set()).update(entry.effect.joints)
    return ", ".join(
        f"{name} ({len(own)} joint{'s' if len(own) > 1 else ''})" if own else name for name, own in joints.items()
    )


def _parameters(diagnosis: Diagnosis) -> Iterator[tuple[str, float]]:
    seen: Counter[str] = Counter()
    for entry in sorted(diagnosis.effects, key=_rank):
        document = effect_to_json(entry.effect)
        place = f"{document['effect']}/{_place(document, diagnosis.joints)}"
        seen[place] += 1
        # A second ripple of the same joint, say.
        place += f"_{seen[place]}" if seen[place] > 1 else ""
        yield f"confirmed/{place}", float(entry.confirmed)
        if entry.test_change is not None:
            yield f"test_change/{place}", _number(entry.test_change[0])
            yield f"test_change_std_error/{place}", _number(entry.test_change[1])
        own = document["joints"][0] if document["joints"] else None
        for p in document["parameters"]:
            body = "" if p["joint"] in (own, None) else f"{_joint(p['joint'], diagnosis.joints)}/"
            yield f"parameter/{place}/{body}{p['name']}", _number(p["value"])
            yield f"std_error/{place}/{body}{p['name']}", _number(p["std_error"])


def _rank(entry: NamedEffect) -> list[float]:
    """Of effects of one kind at one place, the order that does not depend on when they were found: by harmonic, say."""
    nonlinear = {refined.name for refined in family(entry.effect.effect).nonlinear_settings}
    return [value for key, value in sorted(entry.effect.parameters.items()) if key in nonlinear]


def _place(document: Mapping[str, Any], joints: tuple[str, ...]) -> str:
    where = "_".join(_joint(name, joints) for name in document["joints"]) or ROBOT
    other = document["settings"].get(FROM_JOINT)
    return f"{where}_from_{_joint(str(other), joints)}" if other is not None else where


def _joint(name: str, joints: tuple[str, ...]) -> str:
    """``joint3``, as in every other metric; a name that is no joint's stays as it is."""
    return f"joint{joints.index(name) + 1}" if name in joints else name


def _errors(diagnosis: Diagnosis) -> Iterator[tuple[str, float]]:
    """Under ``loop/``: the loop judges at its own bandwidth, the evaluation of all methods at the features'."""
    for split, change in diagnosis.error.items():
        for when, errors in _ends(change):
            yield f"loop/{split}/{when}/relative_error", _number(errors.relative_error)
            for j, value in enumerate(errors.rmse):
                yield f"loop/{split}/{when}/rmse/joint{j + 1}", _number(value)


def _ends(change: Change) -> Iterator[tuple[str, Any]]:
    for when in ("before", "after", "after_confirmed"):
        errors = getattr(change, when)
        if errors is not None:
            yield when, errors


def _joints(diagnosis: Diagnosis) -> Iterator[tuple[str, float]]:
    for name in _PER_JOINT:
        for j, value in enumerate(getattr(diagnosis, name)):
            yield f"{name}/joint{j + 1}", _number(value)


def _places(diagnosis: Diagnosis) -> dict[str, str]:
    """One parameter a kind of effect: its joints; what the test runs contradict under a name of its own."""
    out: dict[str, list[str]] = {}
    for entry in diagnosis.effects:
        key = f"{'effect' if entry.confirmed else 'contradicted'}.{entry.effect.effect}"
        out.setdefault(key, []).append(", ".join(entry.effect.joints) or ROBOT)
    order = {name: j for j, name in enumerate(diagnosis.joints)}
    return {key: ", ".join(sorted(dict.fromkeys(v), key=lambda n: order.get(n, -1))) for key, v in out.items()}


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)
