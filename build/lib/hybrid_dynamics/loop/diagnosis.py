"""``diagnosis.json``: what was missing, where, how sure, and how much better the model got."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import jsonschema
import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.files import write_json
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.model import Model, load_schema
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.metrics import torque_errors

Array = NDArray[np.float64]

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


def predict_run(model: Model, run: Run) -> Array:
    """Smoothed prediction (K, n) [N m] at the instants of ``run``; kept, since errors and figures ask for it again."""
    kept = model.predictions.get(id(run))
    if kept is None or kept[0] is not run:
        kept = run, run.smooth(Evidence.predict_fine(model, run))
        model.predictions[id(run)] = kept
    return kept[1]


def errors_of(model: Model, runs: Sequence[Run], moving: bool = False) -> dict[str, Any]:
    """The three error measures pooled over ``runs``; with ``moving`` only samples where the joint moves."""
    tau = np.concatenate([run.tau for run in runs])
    hat = np.concatenate([predict_run(model, run) for run in runs])
    if not moving:
        e = torque_errors(tau, hat)
        return {
            "rmse": [float(v) for v in e.rmse],
            "relative_rmse": [float(v) for v in e.relative_rmse],
            "relative_error": e.relative_error,
        }
    mask = np.concatenate([run.mask for run in runs])
    rmse = moving_rms(model, runs)
    spread = np.array([tau[mask[:, j], j].std() if mask[:, j].any() else 0.0 for j in range(tau.shape[1])])
    size = float(np.linalg.norm(tau[mask]))
    return {
        "rmse": [float(v) for v in rmse],
        "relative_rmse": [float(a / s) if s > 0 else float("nan") for a, s in zip(rmse, spread, strict=True)],
        "relative_error": float(np.linalg.norm((tau - hat)[mask])) / size if size > 0 else float("nan"),
    }


def moving_rms(model: Model, runs: Sequence[Run]) -> Array:
    """(n,) [N m] rms error over the samples where each joint moves; 0 where it never does."""
    error = np.concatenate([run.tau - predict_run(model, run) for run in runs])
    mask = np.concatenate([run.mask for run in runs])
    count = np.maximum(mask.sum(axis=0), 1)
    return np.asarray(np.sqrt((error**2 * mask).sum(axis=0) / count))


def verdict_of(named: bool, explained: NDArray[np.bool_]) -> str:
    """Verdict of the whole robot from whether anything was named and which joints are explained (n,)."""
    if bool(explained.all()):
        return "explained" if named else "nothing_missing"
    return "partly_explained" if named else "unexplained"


def validate_diagnosis(value: dict[str, Any]) -> None:
    """Raise ``jsonschema.ValidationError`` where ``value`` breaks the contract."""
    jsonschema.validate(value, load_schema("diagnosis"))


def write_diagnosis(path: str | os.PathLike[str], value: dict[str, Any]) -> None:
    """Check against the schema, then write, atomically."""
    validate_diagnosis(value)
    write_json(path, value)
