"""The score of a diagnosis that never saw what was hidden: one row a blind case."""

from __future__ import annotations

import csv
import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from hybrid_dynamics.effects import Effect, family
from hybrid_dynamics.files import atomic_path
from hybrid_dynamics.loop.describe import SILENT
from hybrid_dynamics.loop.diagnosis import errors_of, moving_rms
from hybrid_dynamics.loop.model import Model, effect_from_json
from hybrid_dynamics.loop.process import ProcessSettings, Run, process
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.alone import alone_sizes
from hybrid_dynamics.study.layout import REFUSED
from hybrid_dynamics.trajectory import Trajectory

#: Column that the report adds: processor seconds of the loop, which no cached stage may hold.
LOOP_SECONDS = "loop_seconds"
#: What became of a hidden effect.
NAMED, LISTED, MISSED = "named", "listed", "missed"
#: Stands in a list for a number that there is not.
NONE = "-"
#: Effect and joints.
Place = tuple[str, tuple[str, ...]]

COLUMNS = (
    "case",
    "robot",
    "engine",
    "hidden",
    "hidden_joints",
    "size_over_floor",
    "named",
    "named_joints",
    "named_right",
    "nothing_wrong_named",
    "verdict",
    "parameter_error",
    "rmse_before",
    "rmse_after",
    "rmse_true_model",
    "noise_floor",
    "joint",
    "rmse_after_all_rows",
    "rmse_true_model_all_rows",
    "floor_over_true_model",
    "noise",
    "seconds",
    "listed",
    "unknown_forms",
    "sizes",
    "outcomes",
    "parameter_errors",
    "checked",
    "within",
    "wrong",
    "stand_ins",
    "other_laws",
    "alternatives",
    "runs",
    "rate",
    "velocity",
    "silent",
)


def true_model(robot: Robot, truth: Mapping[str, Any]) -> Model:
    """The model that the truth describes."""
    return Model(robot, tuple(effect_from_json(e) for e in truth["effects"]))


def score_blind(
    truth: Mapping[str, Any],
    diagnosis: Mapping[str, Any],
    robot: Robot,
    train: Sequence[Trajectory],
    test: Sequence[Trajectory],
    settings: ProcessSettings | None = None,
) -> dict[str, Any]:
    """One row of ``blind.csv``: what was named and confirmed, and the model without what was not.

    Errors are those of the joint whose error after is largest against the true model's.
    The noise floor is compared with the true model's error on the training runs it was estimated from: the worst joint
    counts.

    ``parameter_error`` is the largest relative error of the hidden effects (see :func:`parameter_errors`), None where
    they were not all named. Lists, one entry for each hidden effect, are separated by spaces: ``sizes`` in floors of
    what it alone explains (:mod:`.alone`), ``outcomes``, ``parameter_errors``, how many of its published parameters
    have a standard error (``checked``) and lie within two of it (``within``). What is named and was not
    hidden is ``wrong``, or among the ``stand_ins`` where what was hidden is listed with it as doing as well, or among
    ``other_laws`` where a form that the catalogue does not have is another law of that effect (Stribeck's with
    another exponent); ``nothing_wrong_named`` holds where there is none of the three.
    ``alternatives``: how many other explanations are listed; ``silent``: joints whose torque never changes.
    """
    runs = [process(t, robot, settings or ProcessSettings()) for t in test]
    own = [process(t, robot, settings or ProcessSettings()) for t in train]
    if REFUSED in diagnosis:
        diagnosis = _unanswered(robot, runs)
    confirmed = [e for e in diagnosis["effects"] if e["confirmed"]]
    hidden, named = _pairs(truth["effects"]), _pairs(confirmed)
    # Counted: a joint may have two harmonics.
    right = Counter(hidden) <= Counter(named)
    other = list((Counter(named) - Counter(hidden)).elements())
    unknown = truth.get("unknown_forms", [])
    causes = _causes(unknown)
    other_laws = list((Counter(other) & Counter(causes)).elements())
    rest = list((Counter(other) - Counter(other_laws)).elements())
    stand_ins = [place for place in rest if _stands_in(place, [*hidden, *causes], confirmed)]
    wrong = list((Counter(rest) - Counter(stand_ins)).elements())
    outcomes = outcomes_of(hidden, confirmed)
    model = true_model(robot, truth)
    exact, exact_all = moving_rms(model, runs), np.array(errors_of(model, runs)["rmse"])
    after = np.array(diagnosis["error_moving"]["test"]["after_confirmed"]["rmse"])
    before = np.array(diagnosis["error_moving"]["test"]["before"]["rmse"])
    after_all = np.array(diagnosis["error"]["test"]["after_confirmed"]["rmse"])
    floor = np.array(diagnosis["noise_floor"])
    ratio = floor / np.maximum(moving_rms(model, own), 1e-12)
    noise = np.array(truth.get("true_rmse", 0.0 * exact))
    if unknown:  # no model of ours is the true one: the noise alone is what it would leave
        exact = exact_all = noise
        ratio = floor / np.maximum(exact, 1e-12)
    else:  # what the sensors of the motion leave is noise of the torque, too
        noise = np.maximum(noise, moving_rms(model, own))
    worst = int(np.argmax(after / np.maximum(exact, 1e-12)))
    errors = parameter_errors(truth, diagnosis, robot, runs)
    coverage = coverage_of(truth, diagnosis)
    known = [e for e in errors if e is not None]
    sizes = alone_sizes(robot, model.effects, own, noise)
    return {
        "case": truth["case"],
        "robot": truth["robot"],
        "engine": truth.get("engine", "own"),
        "hidden": " ".join(h[0] for h in hidden),
        "hidden_joints": _joints(hidden),
        "size_over_floor": truth["size_over_floor"],
        "named": " ".join(n[0] for n in named),
        "named_joints": _joints(named),
        "named_right": right,
        "nothing_wrong_named": not other,
        "verdict": diagnosis["verdict"],
        "parameter_error": max(known) if right and known else None,
        "rmse_before": before[worst],
        "rmse_after": after[worst],
        "rmse_true_model": exact[worst],
        "noise_floor": floor[worst],
        "joint": robot.joint_names[worst],
        "rmse_after_all_rows": after_all[worst],
        "rmse_true_model_all_rows": exact_all[worst],
        "floor_over_true_model": float(ratio[np.argmax(np.abs(np.log(np.maximum(ratio, 1e-12))))]),
        "noise": truth.get("noise", "white"),
        "seconds": truth.get("seconds", sum(t.time[-1] - t.time[0] for t in train)),
        "listed": MISSED not in outcomes,
        "unknown_forms": " ".join(u["form"].replace(" ", "_") for u in unknown),
        "sizes": " ".join(f"{size:.3g}" for size in sizes),
        "outcomes": " ".join(outcomes),
        "parameter_errors": " ".join(NONE if e is None else f"{e:.3g}" for e in errors),
        "checked": " ".join(str(n) for n, _ in coverage),
        "within": " ".join(str(n) for _, n in coverage),
        "wrong": _at(wrong),
        "stand_ins": _at(stand_ins),
        "other_laws": _at(other_laws),
        "alternatives": len({_set(a) for e in confirmed for a in e["indistinguishable_from"]}),
        "runs": truth.get("runs", len(train)),
        "rate": truth.get("rate", 1.0 / train[0].dt),
        "velocity": truth.get("velocity", "dq" in train[0]),
        # A diagnosis leaves out what is empty.
        "silent": " ".join(j["joint"] for j in diagnosis.get("not_identifiable", []) if j["why"].startswith(SILENT)),
    }


def _unanswered(robot: Robot, runs: Sequence[Run]) -> dict[str, Any]:
    """What a refusal comes to: nothing named, the errors of the model that there was."""
    moving, plain = moving_rms(Model(robot), runs).tolist(), errors_of(Model(robot), runs)["rmse"]
    return {
        "verdict": REFUSED,
        "effects": [],
        "noise_floor": moving,
        "error": {"test": {"after_confirmed": {"rmse": plain}}},
        "error_moving": {"test": {"before": {"rmse": moving}, "after_confirmed": {"rmse": moving}}},
    }


def outcomes_of(hidden: Sequence[Place], named: Sequence[Mapping[str, Any]]) -> list[str]:
    """What became of every hidden effect: named, listed in the place of a name, or missed.

    A set of effects that is listed counts for those of it that were hidden where the rest of it was hidden or named.
    """
    left = Counter(_pairs(named))
    places = {*hidden, *left}
    listed = [_set(a) for e in named for a in e["indistinguishable_from"]]
    out = []
    for place in hidden:
        if left[place] > 0:
            left[place] -= 1
            out.append(NAMED)
        else:
            out.append(LISTED if any(place in group and group <= places for group in listed) else MISSED)
    return out


def _stands_in(place: Place, hidden: Sequence[Place], named: Sequence[Mapping[str, Any]]) -> bool:
    """Whether ``place``, named, says of itself that what was hidden instead does as well."""
    places = _pairs(named)
    instead = set(hidden) - set(places)
    listed = [
        _set(a) for e, own in zip(named, places, strict=True) if own == place for a in e["indistinguishable_from"]
    ]
    return any(group & instead and group <= {*hidden, *places} for group in listed)


def _causes(unknown: Sequence[Mapping[str, Any]]) -> list[Place]:
    """The effects, with their joints, that forms which the catalogue does not have are other laws of."""
    return [(u["of"], tuple(u["joints"])) for u in unknown if u["of"]]


def _at(places: Sequence[Place]) -> str:
    return " ".join(f"{effect}@{(joints or (NONE,))[0]}" for effect, joints in places)


def _set(alternative: Mapping[str, Any]) -> frozenset[Place]:
    return frozenset(_pairs(alternative["effects"]))


def _joints(places: Sequence[Place]) -> str:
    return " ".join((place[1] or (NONE,))[0] for place in places)


def _pairs(entries: Sequence[Mapping[str, Any]]) -> list[tuple[str, tuple[str, ...]]]:
    """Family and joints of every entry."""
    return [(e["effect"], tuple(e["joints"])) for e in entries]


def _alike(truth: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> list[tuple[Effect, list[Effect]]]:
    """Every hidden effect, and what is named of its family on its joint."""
    named = [effect_from_json(e) for e in diagnosis["effects"] if e["confirmed"]]
    hidden = [effect_from_json(e) for e in truth["effects"]]
    return [(true, [e for e in named if (e.effect, e.joints) == (true.effect, true.joints)]) for true in hidden]


def parameter_errors(
    truth: Mapping[str, Any], diagnosis: Mapping[str, Any], robot: Robot, runs: Sequence[Run]
) -> list[float | None]:
    """Relative error of every hidden effect: the largest of its parameters, see :meth:`Family.parameter_error`.

    None where it is not named, or named with other settings: another form has other parameters.
    """
    motions = [run.motion for run in runs]
    out: list[float | None] = []
    for true, alike in _alike(truth, diagnosis):
        kind = family(true.effect)
        # Of two harmonics of one joint the nearer one is meant.
        errors = [
            max(kind.parameter_error(true, found, robot, motions).values(), default=0.0)
            for found in alike
            if set(found.parameters) == set(true.parameters)
        ]
        out.append(min(errors, default=None))
    return out


def coverage_of(truth: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> list[tuple[int, int]]:
    """Of every hidden effect: how many of its named parameters have a standard error, how many lie within two."""
    out = []
    for true, alike in _alike(truth, diagnosis):
        counts = []
        for found in alike:
            if set(found.parameters) != set(true.parameters):
                continue
            off = [
                abs(_apart(name, found.parameters[name], true.parameters[name])) / error
                for name, error in found.std_errors.items()
                if error and name in true.parameters
            ]
            counts.append((len(off), sum(x <= 2.0 for x in off)))
        out.append(max(counts, key=lambda c: c[1], default=(0, 0)))
    return out


def _apart(name: str, found: float, true: float) -> float:
    """Difference; of angles that repeat, around the circle."""
    return float(np.angle(np.exp(1j * (found - true)))) if name == "phase" else found - true


def write_blind(path: str | os.PathLike[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write ``blind.csv``: numbers with six significant digits, booleans as true/false."""

    def text(value: Any) -> str:
        if value is None:
            return ""
        if isinstance(value, bool | np.bool_):
            return "true" if value else "false"
        return f"{value:.6g}" if isinstance(value, float | np.floating) else str(value)

    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for row in rows:
            writer.writerow([text(row[c]) for c in COLUMNS])


__all__ = [
    "COLUMNS",
    "LISTED",
    "LOOP_SECONDS",
    "MISSED",
    "NAMED",
    "NONE",
    "coverage_of",
    "outcomes_of",
    "parameter_errors",
    "score_blind",
    "true_model",
    "write_blind",
]
