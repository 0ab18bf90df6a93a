"""Zero-phase Butterworth low-pass and central differences."""

from __future__ import annotations

import numpy as np
from scipy import signal

from hybrid_dynamics.differentiate.differences import central_difference
from hybrid_dynamics.differentiate.edges import chord, transient_samples
from hybrid_dynamics.differentiate.method import DerivativeMethod, cutoff_candidates
from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.types import Array

ORDER = 4


def design(cutoff_hz: float, dt: float, order: int = ORDER) -> Array:
    """Second-order sections whose forward-backward response is -3 dB at ``cutoff_hz``."""
    nyquist = 0.5 / dt
    if not 0 < cutoff_hz < nyquist:
        raise ConfigError(f"cutoff_hz is {cutoff_hz}; expected more than 0 and less than {nyquist:g} (half the rate)")
    # Forward-backward gives |H1|^2 = 1/(1 + w^2n) in the bilinear variable w = tan(pi f dt)/tan(pi f1 dt).
    single = np.arctan(np.tan(np.pi * cutoff_hz * dt) / (np.sqrt(2) - 1) ** (1 / (2 * order))) / (np.pi * dt)
    return np.asarray(signal.butter(order, min(single * 2 * dt, 1 - 1e-9), output="sos"))


def response(frequency: Array, cutoff_hz: float, dt: float, order: int = ORDER) -> Array:
    """Response (real, zero phase) of :func:`lowpass` at ``frequency`` [Hz]."""
    ratio = np.tan(np.pi * np.minimum(frequency * dt, 0.5 - 1e-9)) / np.tan(np.pi * cutoff_hz * dt)
    # -3 dB (amplitude 1/sqrt 2) at the cut-off: 1/(1 + c) with c = sqrt 2 - 1.
    return np.asarray(1 / (1 + (np.sqrt(2) - 1) * ratio ** (2 * order)))


def lowpass(x: Array, dt: float, cutoff_hz: float, order: int = ORDER) -> Array:
    """``x`` (T,) or (T, n) without what lies above ``cutoff_hz``; forward and backward, so nothing is delayed."""
    x = np.asarray(x, float)
    pad = min(transient_samples(cutoff_hz, dt), len(x) - 1)
    if pad < 1:
        raise InputError(f"{len(x)} samples cannot be filtered; give a longer run")
    line = chord(x)
    sections = design(cutoff_hz, dt, order)
    return np.asarray(line + signal.sosfiltfilt(sections, x - line, axis=0, padtype="odd", padlen=pad))


def _column(x: Array, dt: float, value: float, /, order: int = ORDER) -> tuple[Array, Array]:
    smooth = lowpass(x, dt, value, order)
    return smooth, central_difference(smooth, dt)


def _response(frequency: Array, dt: float, value: float, order: int = ORDER) -> Array:
    return response(frequency, value, dt, order)


#: ``butterworth(x, dt, cutoff_hz=..., order=...)``: zero-phase low-pass, then seven-point central differences.
METHOD = DerivativeMethod("butterworth", "cutoff_hz", _column, cutoff_candidates, _response, ("order",))
