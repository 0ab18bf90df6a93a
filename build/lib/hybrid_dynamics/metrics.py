"""The three error measures of the project: ``rmse`` [N m], ``relative_rmse``, ``relative_error`` (pooled)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybrid_dynamics.types import Array


@dataclass(frozen=True)
class Errors:
    """Errors of a torque prediction: ``rmse`` (n,) [N m], ``relative_rmse`` (n,), pooled ``relative_error``."""

    rmse: Array
    relative_rmse: Array
    relative_error: float


def torque_errors(tau: Array, tau_hat: Array) -> Errors:
    """Compare measured ``tau`` (T, n) [N m] with predicted ``tau_hat`` (T, n) [N m].

    ``relative_rmse_j = rms(tau_j - tau_hat_j) / std(tau_j)``; NaN for a joint whose torque does not vary.
    ``relative_error = |tau - tau_hat| / |tau|`` over all joints (Sousa and Cortesao, IJRR 2014).
    """
    error = np.asarray(tau, float) - np.asarray(tau_hat, float)
    rmse = np.sqrt(np.mean(error**2, axis=0))
    spread = np.std(tau, axis=0)
    relative = np.divide(rmse, spread, out=np.full_like(rmse, np.nan), where=spread > 0)
    size = float(np.linalg.norm(tau))
    return Errors(rmse, relative, float(np.linalg.norm(error)) / size if size > 0 else float("nan"))
