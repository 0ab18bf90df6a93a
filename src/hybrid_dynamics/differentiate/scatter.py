"""What samples scatter by, apart from all motion: the level of a spectrum where nothing moves, and a sensor's steps.

What is noise is a median over stretches of two seconds, so that a knock or a glitch, which is in one of them, does not
count.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal import welch

from hybrid_dynamics.types import Array

#: Length [s] of the stretches whose spectra are taken the median of.
STRETCH = 2.0
#: Shares of the sampling rate between which positions and torques scatter alone.
ALONE = (0.35, 0.5)
#: Steps are those of a sensor where so many of the samples in motion repeat the one before.
_REPEATS = 0.1
#: Samples to either side within which a value changes: in motion.
_MOVING = 5


def stretch_rows(rows: int, dt: float) -> int:
    """Samples of a stretch of a run of so many ``rows``, sampled every ``dt`` [s]."""
    return min(round(STRETCH / dt), rows // 2)


def density(signal: Array, dt: float) -> tuple[Array, Array]:
    """Frequencies (F,) [Hz] and the one-sided density (F, n) of ``signal`` (N, n): the median over stretches."""
    f, power = welch(  # type: ignore[call-overload]  # the stubs know no detrend="linear"
        signal, 1.0 / dt, nperseg=stretch_rows(len(signal), dt), detrend="linear", axis=0, average="median"
    )
    return np.asarray(f), np.asarray(power)


def within(f: Array, dt: float, band: tuple[float, float]) -> NDArray[np.bool_]:
    """Which frequencies ``f`` (F,) [Hz] lie between these shares of the sampling rate."""
    return np.asarray((f >= band[0] / dt) & (f <= band[1] / dt))


def level(f: Array, power: Array, dt: float) -> Array:
    """(n,) level of a density ``power`` (F, n) at ``f`` (F,) [Hz] where next to nothing moves."""
    return np.asarray(np.median(power[within(f, dt, ALONE)], axis=0))


def position_noise(q: Array, dt: float) -> Array:
    """(n,) one-sided density [rad^2/Hz] of the noise of positions ``q`` (N, n), which is white: its level beyond all
    motion, or what their steps round away, whichever is more."""
    f, power = density(q, dt)
    return np.maximum(level(f, power, dt), steps(q) ** 2 / 12 * 2 * dt)


def steps(signal: Array) -> Array:
    """(n,) smallest step between values of ``signal`` (N, n) where it stays on a value while it moves: a sensor's, and
    not what a joint turns in a sample; else 0, and the spectrum tells what scatters."""
    out = np.zeros(signal.shape[1])
    same = np.diff(signal, axis=0) == 0.0
    moving = uniform_filter1d((~same).astype(float), 2 * _MOVING + 1, axis=0) > 1e-9
    repeats = np.sum(same & moving, axis=0) > _REPEATS * np.maximum(np.sum(moving, axis=0), 1)
    for j in np.flatnonzero(repeats):
        gaps = np.diff(np.unique(signal[:, j]))
        # What differs by rounding is one value.
        out[j] = np.min(gaps[gaps > 1e-6 * np.ptp(signal[:, j])], initial=np.inf)
    return np.where(np.isfinite(out), out, 0.0)
