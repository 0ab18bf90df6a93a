"""Rauch-Tung-Striebel smoother of a point that moves with constant acceleration but for white jerk.

State (x, v, a); x is measured with white noise of variance r, jerk is white noise of density q. Everything is constant
in time, so are the gains: they come from the Riccati equation, and both passes are first-order filters of their modes.
At the ends the signal is mirrored through its end points for the time the gains would need to settle. Inside, the
response is 1/(1 + (f/fc)^6) with (2 pi fc)^6 = q/(r dt): ``cutoff_hz`` stands for the ratio of the two noises.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_discrete_are
from scipy.signal import lfilter

from hybrid_dynamics.differentiate.edges import chord, transient_samples
from hybrid_dynamics.differentiate.method import DerivativeMethod, cutoff_candidates
from hybrid_dynamics.types import Array


def _gains(w: float) -> tuple[Array, Array, Array]:
    """Transition A, Kalman gain K (3,) and smoother gain G for r = 1, in states (x, v/w, a/w^2), w = 2 pi fc dt."""
    transition = np.array([[1, w, w**2 / 2], [0, 1, w], [0, 0, 1]])
    noise = w**2 * np.array([[w**4 / 20, w**3 / 8, w**2 / 6], [w**3 / 8, w**2 / 3, w / 2], [w**2 / 6, w / 2, 1]])
    measured = np.array([[1.0, 0.0, 0.0]])
    predicted = solve_discrete_are(transition.T, measured.T, noise, np.eye(1))
    gain = predicted[:, 0] / (predicted[0, 0] + 1)
    filtered = predicted - np.outer(gain, predicted[0])
    smoother = np.linalg.solve(predicted, transition @ filtered).T
    return transition, gain, smoother


def _recursion(matrix: Array, inputs: Array) -> Array:
    """z_k = matrix z_{k-1} + inputs_k for (T, 3) ``inputs``, z_{-1} = 0, mode by mode."""
    values, vectors = np.linalg.eig(matrix)
    # einsum, not BLAS: on tall arrays of three columns its threads cost more than they save.
    modes = np.einsum("ti,ji->tj", inputs, np.linalg.inv(vectors).astype(complex))
    for i, value in enumerate(values):
        modes[:, i] = lfilter([1.0], [1.0, -value], modes[:, i])
    return np.asarray(np.einsum("ti,ji->tj", modes, vectors).real)


def _column(x: Array, dt: float, value: float, /) -> tuple[Array, Array]:
    w = 2 * np.pi * value * dt
    transition, gain, smoother = _gains(w)
    pad = min(transient_samples(value, dt), len(x) - 1)
    line = chord(x)
    rest = x - line
    padded = np.concatenate([-rest[pad:0:-1], rest, -rest[-2 : -pad - 2 : -1]])
    forward = np.eye(3) - np.outer(gain, [1.0, 0.0, 0.0])
    filtered = _recursion(forward @ transition, np.outer(padded, gain))
    inputs = np.einsum("ti,ji->tj", filtered, np.eye(3) - smoother @ transition)
    inputs[-1] = filtered[-1]
    smoothed = _recursion(smoother, inputs[::-1])[::-1]
    inner = smoothed[pad : pad + len(x)]
    return inner[:, 0] + line, inner[:, 1] * w / dt + (x[-1] - x[0]) / (dt * (len(x) - 1))


def _response(frequency: Array, dt: float, value: float) -> Array:
    return np.asarray(1 / (1 + (frequency / value) ** 6))


#: ``kalman(x, dt, cutoff_hz=...)``: the response of the smoother is one half at ``cutoff_hz``.
METHOD = DerivativeMethod("kalman", "cutoff_hz", _column, cutoff_candidates, _response)
