"""Errors of the derivatives of noisy positions against the truth, beside the best that tuning could do."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from hybrid_dynamics.differentiate.chain import derivatives, joined
from hybrid_dynamics.differentiate.choice import minimise
from hybrid_dynamics.differentiate.edges import transient_samples
from hybrid_dynamics.differentiate.method import DerivativeMethod
from hybrid_dynamics.differentiate.registry import DIFFERENTIATORS, get_differentiator
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

SIGNALS = ("dq", "ddq", "dddq")
#: Values tried in the first pass of the tuning on the truth.
TRIED = 14


def derivative_errors(
    truth: Trajectory, noisy: Trajectory, methods: Iterable[str] | None = None, tuned: bool = True, workers: int = 1
) -> list[dict[str, Any]]:
    """Relative RMSE of dq, ddq and dddq against truth, per method (default: all), signal and joint.

    ``truth`` holds ``dq ddq dddq``, ``noisy`` the measured ``q``, at the same instants. Rows are dictionaries:
    ``method``, ``signal``, ``joint`` (from 1; "all" = root mean square over the joints), ``relative_rmse`` =
    rms(error) / std(truth) with the automatic choice, ``parameter`` (its value; None for "all"); with ``tuned`` also
    ``best_relative_rmse`` (parameters tuned on the truth for that very joint and derivative), ``best_parameter`` and
    ``ratio``. Edges (two periods of the motion's bandwidth, the same rows for every method) do not count. With several
    ``workers`` joints are tuned side by side.
    """
    if len(truth.time) != len(noisy.time) or not np.allclose(truth.time, noisy.time, atol=noisy.dt * 1e-3, rtol=0):
        raise InputError(f"trajectory {noisy.name}: truth and noisy run are not sampled at the same instants")
    names = list(DIFFERENTIATORS) if methods is None else list(methods)
    x, dt = noisy["q"], noisy.dt
    rows: list[dict[str, Any]] = []
    for name in names:
        method = get_differentiator(name)
        # Joint by joint: what one costs is the choice of its parameter, and joints know nothing of each other.
        chains = Parallel(workers)(delayed(derivatives)(x[:, [j]], dt, method, len(SIGNALS)) for j in range(x.shape[1]))
        chain = joined(chains)
        edge = min(transient_samples(float(np.min(chain.bandwidth)), dt), len(x) // 4)
        inner = slice(edge, len(x) - edge)
        best = Parallel(workers)(
            delayed(_tuned)(method, x[:, j], dt, [truth[s][:, j] for s in SIGNALS], inner) for j in _joints(x, tuned)
        )
        for k, signal in enumerate(SIGNALS):
            own = []
            for j in range(x.shape[1]):
                row: dict[str, Any] = {"method": name, "signal": signal, "joint": j + 1}
                row["relative_rmse"] = _error(chain.values[k + 1][:, j], truth[signal][:, j], inner)
                row["parameter"] = float(chain.parameters[k][j])
                if tuned:
                    row["best_relative_rmse"], row["best_parameter"] = best[j][k]
                    row["ratio"] = row["relative_rmse"] / row["best_relative_rmse"]
                own.append(row)
            rows.extend(own)
            rows.append(_all_joints(own))
    return rows


def _joints(x: Array, tuned: bool) -> range:
    return range(x.shape[1] if tuned else 0)


def _error(estimate: Array, truth: Array, inner: slice) -> float:
    return float(np.sqrt(np.mean((estimate[inner] - truth[inner]) ** 2)) / np.std(truth[inner]))


def _all_joints(rows: list[dict[str, Any]]) -> dict[str, Any]:
    out = {"method": rows[0]["method"], "signal": rows[0]["signal"], "joint": "all", "parameter": None}
    for key in ("relative_rmse", "best_relative_rmse"):
        if key in rows[0]:
            out[key] = float(np.sqrt(np.mean([row[key] ** 2 for row in rows])))
    if "best_relative_rmse" in out:
        out["best_parameter"] = None
        out["ratio"] = out["relative_rmse"] / out["best_relative_rmse"]
    return out


def _tuned(
    method: DerivativeMethod, x: Array, dt: float, truth: list[Array], inner: slice
) -> list[tuple[float, float]]:
    """Smallest error and its parameter for each derivative of ``x`` (T,).

    Each derivative is tuned on what the earlier steps, tuned themselves, gave; and again on what they give when they
    smooth clearly less, since the best velocity is not always the best start for the acceleration.
    """
    results: list[tuple[float, float]] = []
    tuned_input, weak_input = x, x
    for wanted in truth:
        trials = []
        for given in (tuned_input,) if tuned_input is weak_input else (tuned_input, weak_input):
            all_candidates = method.candidates(given, dt)
            step = max(len(all_candidates) // TRIED, 1)

            def loss(value: float, given: Array = given, wanted: Array = wanted) -> float:
                return _error(method.column(given, dt, value)[1], wanted, inner)

            value = minimise(loss, all_candidates[::step], rounds=5)
            trials.append((loss(value), value))
        results.append(min(trials))
        value = trials[0][1]
        tried = method.candidates(weak_input, dt)
        weak_input = method.column(weak_input, dt, float(np.clip(value * method.weaker, tried.min(), tried.max())))[1]
        tuned_input = method.column(tuned_input, dt, value)[1]
    return results
