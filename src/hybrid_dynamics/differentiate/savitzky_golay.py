"""Savitzky-Golay: in each window a polynomial by least squares, its value and slope in the middle."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import signal
from scipy.interpolate import CubicSpline

from hybrid_dynamics.differentiate.method import DerivativeMethod
from hybrid_dynamics.errors import ConfigError
from hybrid_dynamics.types import Array

DEGREE = 4


def _window(value: float, degree: int, rows: int) -> int:
    """The odd number of samples nearest to ``value``."""
    window = 2 * round((value - 1) / 2) + 1
    if not degree < window <= rows:
        raise ConfigError(f"savitzky_golay: window is {value:g} samples; expected {degree + 1} to {rows}")
    return int(window)


def _column(x: Array, dt: float, value: float, /, degree: int = DEGREE) -> tuple[Array, Array]:
    window = _window(value, degree, len(x))
    return (
        signal.savgol_filter(x, window, degree),
        signal.savgol_filter(x, window, degree, deriv=1, delta=dt),
    )


@lru_cache(maxsize=1024)
def _deviation(window: int, degree: int) -> tuple[CubicSpline, float, int]:
    """The deviation of the slope's response from 1, over angle^p; the first angle tabulated [rad]; p.

    Odd weights: the response is 2i sum w_k sin(k angle), over the exact i angle. It is 1 - O(angle^p); the smooth
    factor of angle^p is tabulated, so that slow motion keeps its digits.
    """
    half = window // 2
    length = 8 * (1 << int(np.ceil(np.log2(window))))
    padded = np.zeros(length)
    padded[1 : half + 1] = signal.savgol_coeffs(window, degree, deriv=1, use="dot")[half + 1 :]
    angle = 2 * np.pi * np.arange(1, length // 2 + 1) / length
    power = 2 * ((degree + 1) // 2)
    return CubicSpline(angle, (1 + 2 * np.fft.rfft(padded).imag[1:] / angle) / angle**power), float(angle[0]), power


def _response(frequency: Array, dt: float, value: float, degree: int = DEGREE) -> Array:
    factor, smallest, power = _deviation(_window(value, degree, 10**9), degree)
    angle = 2 * np.pi * frequency * dt
    return np.asarray(1 - factor(np.maximum(angle, smallest)) * angle**power)


def _candidates(x: Array, dt: float) -> Array:
    """Odd windows from a quarter of the run (at most 4 s) down to seven samples, 30 a decade."""
    longest = max(min(len(x) // 4, round(4 / dt)), 9)
    count = max(int(30 * np.log10(longest / 7)), 2)
    return np.unique(2 * np.round((np.geomspace(7, longest, count) - 1) / 2) + 1)[::-1]


def _edge(value: float, dt: float) -> int:
    return int(value // 2)


#: ``savitzky_golay(x, dt, window=..., degree=...)``; ``window`` in samples (odd).
METHOD = DerivativeMethod("savitzky_golay", "window", _column, _candidates, _response, ("degree",), _edge, 0.67)
