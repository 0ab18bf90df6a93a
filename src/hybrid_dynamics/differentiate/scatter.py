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
    """(n,) level of a density ``power`` (F, n) at ``f`` (F,) [Hz] where next to nothing moves; 0 where a log is so slow
    that it shows none of that."""
    alone = within(f, dt, ALONE)
    return np.asarray(np.median(power[alone], axis=0)) if alone.any() else np.zeros(power.shape[1])


def position_noise(q: Array, dt: float, held: bool = False) -> Array:
    """(n,) one-sided density [rad^2/Hz] of the noise of positions ``q`` (N, n): its level beyond all motion, or what
    their steps round away, whichever is more.

    What is rounded away is white up to half the sampling rate; with ``held`` up to half the rate of changes, below
    which all of it lies where a position is held, or takes several samples to its next step.
    """
    rounded = np.zeros(q.shape[1])
    for j, (step, interval) in enumerate(zip(*steps(q), strict=True)):
        rounded[j] = step**2 / 12 * 2 * dt * (interval if held else 1.0)
    if stretch_rows(len(q), dt) < 2:
        return rounded
    return np.maximum(level(*density(q, dt), dt), rounded)


def steps(signal: Array) -> tuple[Array, Array]:
    """Of a ``signal`` (N, n) that stays on a value while it moves, (n,) the smallest step between values, and (n,) the
    samples from one value to the next: a sensor's. Of any other 0 and 1: the spectrum tells what scatters, and the
    least difference of two values is what a joint turns in a sample."""
    out, interval = np.zeros(signal.shape[1]), np.ones(signal.shape[1])
    same = np.diff(signal, axis=0) == 0.0
    moving = uniform_filter1d((~same).astype(float), 2 * _MOVING + 1, axis=0) > 1e-9
    count = np.maximum(np.sum(moving, axis=0), 1)
    repeats = np.sum(same & moving, axis=0)
    for j in np.flatnonzero(repeats > _REPEATS * count):
        gaps = np.diff(np.unique(signal[:, j]))
        # What differs by rounding is one value.
        gaps = gaps[gaps > 1e-6 * np.ptp(signal[:, j])]
        if gaps.size:
            out[j], interval[j] = gaps.min(), count[j] / max(count[j] - repeats[j], 1)
    return out, interval
