"""``diagnosis.json``: what was missing, where, how sure, and how much better the model got."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.files import write_json
from hybrid_dynamics.loop.model import Model, check_schema, effect_from_json, effect_to_json, refuse_newer
from hybrid_dynamics.loop.problem import predict_fine
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.metrics import torque_errors
from hybrid_dynamics.types import Array

#: Significant digits of every number: enough for any use, few enough to be the same on every run.
DIGITS = 9


def rounded(value: Any, digits: int = DIGITS) -> Any:
    """``value`` (nested lists and dicts) with floats rounded to ``digits`` significant digits; NaN becomes None."""
    if isinstance(value, dict):
        return {k: rounded(v, digits) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(v, digits) for v in value]
    if isinstance(value, float | np.floating):
        if not np.isfinite(value):
            return None
        return float(f"{float(value):.{digits - 1}e}")
    return value


@dataclass(frozen=True)
class Errors:
    """The three error measures: ``rmse`` (n,) [N m], ``relative_rmse`` (n,) (None: the joint's torque is constant),
    ``relative_error`` pooled over the joints."""

    rmse: tuple[float, ...]
    relative_rmse: tuple[float | None, ...]
    relative_error: float | None

    @classmethod
    def of(cls, e: Mapping[str, Any]) -> Errors:
        """Of what :func:`errors_of` gives, or ``diagnosis.json`` holds."""
        return cls(tuple(e["rmse"]), tuple(e["relative_rmse"]), e["relative_error"])


@dataclass(frozen=True)
class Change:
    """Errors of the starting model, of the model as found, and without what the test runs contradict."""

    before: Errors
    after: Errors
    after_confirmed: Errors | None = None


@dataclass(frozen=True)
class NamedEffect:
    """One effect that was found: its parameters, what else would explain as much, and what the test runs say of it.

    ``test_change``: relative change of the held-out mean square error that it brings (negative: better) and its
    standard error, of its joint alone where that contradicts it; ``test_rmse_before`` and ``_after`` (n,) [N m] of the
    model without it, in the order of finding.
    ``in_all``: of an effect that the starting model has at the same place, each parameter there and in the result.
    """

    effect: Effect
    indistinguishable_from: tuple[Mapping[str, Any], ...]
    test_rmse_before: tuple[float, ...]
    test_rmse_after: tuple[float, ...]
    confirmed: bool = True
    test_change: tuple[float, float] | None = None
    why_not: str | None = None
    undetermined_parameters: tuple[str, ...] = ()
    inconsistent_between_runs: tuple[Mapping[str, Any], ...] = ()
    in_all: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @classmethod
    def from_json(cls, entry: Mapping[str, Any]) -> NamedEffect:
        """Inverse of :meth:`to_json`."""
        change = entry.get("test_change")
        return cls(
            effect_from_json(entry),
            tuple(entry["indistinguishable_from"]),
            tuple(entry["test_rmse_before"]),
            tuple(entry["test_rmse_after"]),
            entry.get("confirmed", True),
            None if change is None else (change["value"], change["std_error"]),
            entry.get("why_not"),
            tuple(entry.get("undetermined_parameters", ())),
            tuple(entry.get("inconsistent_between_runs", ())),
            dict(entry.get("in_all", {})),
        )

    def to_json(self, slides: Collection[str] = ()) -> dict[str, Any]:
        """The entry of ``diagnosis.json``; ``slides`` are the prismatic joints."""
        out = effect_to_json(self.effect, slides)
        out |= {
            "indistinguishable_from": list(self.indistinguishable_from),
            "confirmed": self.confirmed,
            "test_rmse_before": list(self.test_rmse_before),
            "test_rmse_after": list(self.test_rmse_after),
        }
        if self.test_change is not None:
            out["test_change"] = dict(zip(("value", "std_error"), self.test_change, strict=True))
        if self.why_not is not None:
            out["why_not"] = self.why_not
        for name in ("undetermined_parameters", "inconsistent_between_runs"):
            if getattr(self, name):
                out[name] = list(getattr(self, name))
        if self.in_all:
            out["in_all"] = {name: dict(ends) for name, ends in self.in_all.items()}
        return out


@dataclass(frozen=True)
class Diagnosis:
    """What ``diagnosis.json`` holds (schema 2; schema 1 is read). Per joint (n,) in the robot's order.

    ``noise_floor`` [N m] lies between ``_low`` and ``_high``; ``learnable_share`` of what is left a black box trained
    on other runs still removes; ``motion_dependent``: the alarm; ``cannot_tell``: neither alarm nor all-clear;
    ``unproven_share``: why not, where a black box removes so much on held-out rows, which may be chance (else 0);
    ``worse_on_test``: the test runs leave surely more than the training runs; ``beyond_friction`` (rms) is left while
    the joint stands and more than friction holds (else 0); ``better_with_everything``: a fit of all that arms have at
    once leaves surely and much less of the test runs; ``worse_than_start``: the starting model leaves less of
    them; ``untested``: these say nothing of the joint.
    ``prismatic`` joints slide: [N] and [m] in the place of [N m] and [rad].

    >>> import json
    >>> from hybrid_dynamics import Diagnosis
    >>> found = Diagnosis.from_json(json.load(open("diagnosis.json")))
    >>> found.verdict, [(e.effect.effect, *e.effect.joints) for e in found.effects]
    ('explained', [('viscous_friction', 'shoulder'), ('coulomb_friction', 'elbow')])
    """

    robot: str
    joints: tuple[str, ...]
    verdict: str
    effects: tuple[NamedEffect, ...]
    error: Mapping[str, Change]
    noise_floor: tuple[float, ...]
    unexplained: tuple[Mapping[str, Any], ...]
    error_moving: Mapping[str, Change] = field(default_factory=dict)
    noise_floor_low: tuple[float, ...] = ()
    noise_floor_high: tuple[float, ...] = ()
    learnable_share: tuple[float, ...] = ()
    motion_dependent: tuple[bool, ...] = ()
    cannot_tell: tuple[bool, ...] = ()
    unproven_share: tuple[float, ...] = ()
    worse_on_test: tuple[bool, ...] = ()
    beyond_friction: tuple[float, ...] = ()
    better_with_everything: tuple[bool, ...] = ()
    worse_than_start: tuple[bool, ...] = ()
    untested: tuple[bool, ...] = ()
    autocorrelation: tuple[float, ...] = ()
    extrapolation: tuple[Mapping[str, Any], ...] = ()
    not_identifiable: tuple[Mapping[str, str], ...] = ()
    prismatic: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def confirmed(self) -> tuple[NamedEffect, ...]:
        """The effects that the test runs do not contradict."""
        return tuple(e for e in self.effects if e.confirmed)

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Diagnosis:
        """Check ``value`` against the schema; raises ``jsonschema.ValidationError``."""
        validate_diagnosis(value)
        parts: dict[str, Any] = {
            name: tuple(value.get(name, ()))
            for name in (
                *_SIZES,
                *_FLAGS,
                "joints",
                "unexplained",
                "extrapolation",
                "not_identifiable",
                "prismatic",
                "notes",
            )
        }
        for name in ("error", "error_moving"):
            parts[name] = {split: _change_from(pair) for split, pair in value.get(name, {}).items()}
        effects = tuple(NamedEffect.from_json(e) for e in value["effects"])
        return cls(
            robot=value["robot"],
            verdict=value["verdict"],
            effects=effects,
            provenance=value.get("provenance", {}),
            **parts,
        )

    def to_json(self) -> dict[str, Any]:
        """JSON values, rounded to :data:`DIGITS` digits and checked against the schema."""
        out: dict[str, Any] = {"schema": 2}
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name == "effects":
                out[f.name] = [e.to_json(self.prismatic) for e in value]
            elif f.name in ("error", "error_moving"):
                out[f.name] = {split: _change_to(change) for split, change in value.items()}
            elif value or f.name in ("unexplained", "notes", "noise_floor"):
                out[f.name] = list(value) if isinstance(value, tuple) else value
        if not out["error_moving"]:
            del out["error_moving"]
        out = rounded(out)
        validate_diagnosis(out)
        return out


_SIZES = (
    "noise_floor",
    "noise_floor_low",
    "noise_floor_high",
    "learnable_share",
    "unproven_share",
    "autocorrelation",
    "beyond_friction",
)
_FLAGS = ("motion_dependent", "cannot_tell", "worse_on_test", "better_with_everything", "worse_than_start", "untested")


def _change_from(pair: Mapping[str, Any]) -> Change:
    return Change(**{k: Errors.of(e) for k, e in pair.items()})


def _change_to(change: Change) -> dict[str, Any]:
    return {
        f.name: {
            "rmse": list(e.rmse),
            "relative_rmse": list(e.relative_rmse),
            "relative_error": e.relative_error,
        }
        for f in fields(change)
        if (e := getattr(change, f.name)) is not None
    }


def predict_run(model: Model, run: Run) -> Array:
    """Smoothed prediction (K, n) [N m] at the instants of ``run``; kept, since errors and figures ask for it again."""
    kept = model.predictions.get(id(run))
    if kept is None or kept[0] is not run:
        kept = run, run.smooth(predict_fine(model, run))
        model.predictions[id(run)] = kept
    return kept[1]


def errors_of(model: Model, runs: Sequence[Run], moving: bool = False) -> dict[str, Any]:
    """The three error measures pooled over ``runs``, but for samples where the torque is cut off; with ``moving`` only
    samples where the joint moves."""
    tau = np.concatenate([run.tau for run in runs])
    hat = np.concatenate([predict_run(model, run) for run in runs])
    mask = np.concatenate([run.mask if moving else ~run.cut_off for run in runs])
    if mask.all():
        e = torque_errors(tau, hat)
        return {
            "rmse": [float(v) for v in e.rmse],
            "relative_rmse": [float(v) for v in e.relative_rmse],
            "relative_error": e.relative_error,
        }
    rmse = _rms(tau - hat, mask)
    spread = np.array([tau[mask[:, j], j].std() if mask[:, j].any() else 0.0 for j in range(tau.shape[1])])
    size = float(np.linalg.norm(tau[mask]))
    return {
        "rmse": [float(v) for v in rmse],
        "relative_rmse": [float(a / s) if s > 0 else float("nan") for a, s in zip(rmse, spread, strict=True)],
        "relative_error": float(np.linalg.norm((tau - hat)[mask])) / size if size > 0 else float("nan"),
    }


def moving_rms(model: Model, runs: Sequence[Run]) -> Array:
    """(n,) [N m] rms error over the samples where each joint moves; 0 where it never does."""
    return rms_in_motion([run.tau - predict_run(model, run) for run in runs], runs)


def rms_in_motion(values: Sequence[Array], runs: Sequence[Run]) -> Array:
    """(n,) rms of ``values``, (K, n) of each of ``runs``, over the samples where each joint moves; 0 where it never
    does."""
    return _rms(np.concatenate(values), np.concatenate([run.mask for run in runs]))


def _rms(values: Array, mask: NDArray[np.bool_]) -> Array:
    count = np.maximum(mask.sum(axis=0), 1)
    return np.asarray(np.sqrt((values**2 * mask).sum(axis=0) / count))


def verdict_of(named: bool, explained: NDArray[np.bool_]) -> str:
    """Verdict of the whole robot from whether anything was named and which joints are explained (n,)."""
    if bool(explained.all()):
        return "explained" if named else "nothing_missing"
    return "partly_explained" if named else "unexplained"


def validate_diagnosis(value: Mapping[str, Any]) -> None:
    """Raise ``jsonschema.ValidationError`` where ``value`` breaks the contract."""
    check_schema(value, "diagnosis")


def write_diagnosis(path: str | os.PathLike[str], diagnosis: Diagnosis) -> None:
    """Check against the schema, then write, atomically."""
    write_json(path, diagnosis.to_json())


def read_diagnosis(path: str | os.PathLike[str]) -> Diagnosis:
    """Read ``diagnosis.json`` of schema 1 or 2; :class:`InputError` says what does not fit."""
    try:
        value = json.loads(Path(path).read_text(encoding="utf-8"))
        refuse_newer(value, path)
        return Diagnosis.from_json(value)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give the diagnosis.json that close-loop wrote") from None
    except jsonschema.ValidationError as error:
        where = "/".join(str(p) for p in error.absolute_path) or "top level"
        raise InputError(f"{path}: {where}: {error.message}; give the diagnosis.json that close-loop wrote") from None
