"""What the spectrum of a measured signal says: noise level, bandwidth, and the error a linear smoother would make.

A measured signal is x = s + n: s smooth (its power falls steeply with frequency), n broadband. For a zero-phase
smoother with frequency response H(f), the mean square error of the m-th derivative is

    R(H) = integral (2 pi f)^(2m) [ (1 - H)^2 S_s(f) + H^2 S_n(f) ] df .

With P the periodogram of x and S_n known, S_s = P - S_n is unbiased, so R is too (Mallows' C_p, here in the frequency
domain and for derivatives). Every linear method of this package chooses its parameter as the minimiser of R.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal
from scipy.ndimage import minimum_filter1d

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.types import Array

MIN_SAMPLES = 64


@dataclass(frozen=True)
class Spectrum:
    """One-sided densities of one signal: ``frequency`` (F,) [Hz], ``power``, ``signal``, ``noise`` (F,) [unit^2/Hz].

    ``noise_std`` [unit] is the standard deviation of the broadband noise, ``bandwidth`` [Hz] the knee of the spectrum,
    where the motion sinks into the noise.
    """

    frequency: Array
    power: Array
    signal: Array
    noise: Array
    noise_std: float
    bandwidth: float

    def risk(self, gain: Array, derivative: int) -> float:
        """Estimated mean square error [(unit/s^m)^2] of the m-th derivative behind a smoother with ``gain`` H (F,)."""
        weight = (2 * np.pi * self.frequency) ** (2 * derivative)
        return float(np.sum(weight * ((1 - gain) ** 2 * self.signal + gain**2 * self.noise)) * self.frequency[1])

    def signal_variance(self, derivative: int) -> float:
        """Variance of the m-th derivative of the noise-free signal, up to the bandwidth [(unit/s^m)^2]."""
        keep = self.frequency <= self.bandwidth
        weight = (2 * np.pi * self.frequency[keep]) ** (2 * derivative)
        return float(np.sum(weight * np.clip(self.signal[keep], 0, None)) * self.frequency[1])


def estimate_spectrum(x: Array, dt: float) -> Spectrum:
    """Spectrum, noise and bandwidth of ``x`` (T,), sampled every ``dt`` seconds.

    Welch's average of five overlapping stretches of half the length, each without its linear trend and under the
    fourth power of a cosine, whose leakage falls by 30 dB an octave: a run that ends elsewhere than it began would
    otherwise fake high frequencies.
    """
    x = np.asarray(x, float)
    if len(x) < MIN_SAMPLES:
        raise InputError(
            f"{len(x)} samples are too few for a spectrum; expected at least {MIN_SAMPLES}: give a longer run"
        )
    length = len(x) // 2
    window = signal.windows.hann(length, sym=False) ** 2
    frequency, power = signal.welch(  # type: ignore[call-overload]
        x, fs=1 / dt, window=window, nperseg=length, noverlap=length - length // 4, detrend="linear"
    )
    noise, bandwidth = _noise_density(frequency, power)
    # Above the knee power - noise is chance; the signal goes on falling as 1/f^6 from the noise that it met there.
    tail = noise * (bandwidth / np.maximum(frequency, bandwidth)) ** 6
    motion = np.where(frequency < bandwidth, power - noise, tail)
    return Spectrum(frequency, power, motion, noise, float(np.sqrt(np.sum(noise) * frequency[1])), bandwidth)


def _octave_mean(frequency: Array, power: Array) -> Array:
    """Mean power over half an octave around each frequency: bridges the gaps between the lines of a multi-sine."""
    total = np.concatenate([[0.0], np.cumsum(power)])
    index = np.arange(len(power))
    low = np.minimum(np.ceil(index * 2**-0.25).astype(int), index)
    high = np.minimum(np.maximum(np.floor(index * 2**0.25).astype(int), index) + 1, len(power))
    return np.asarray((total[high] - total[low]) / (high - low))


def _noise_density(frequency: Array, power: Array) -> tuple[Array, float]:
    """Density of the broadband noise, and the knee [Hz] where the signal sinks into it.

    Above 1.5 times the knee, clear of the signal, the noise is the spectrum itself, so it may have a colour; below, it
    is taken as constant, at the mean level of the octave above.
    """
    smooth = _octave_mean(frequency, power)
    # A signal that stands still has no power at all.
    held = np.cumsum(power[1:]) / max(float(np.sum(power[1:])), np.finfo(float).tiny)
    first = min(1 + int(np.searchsorted(held, 0.999)), len(power) - 2)
    knee = _knee(frequency, smooth, first)
    noise = smooth.copy()
    above = min(round(1.5 * knee), len(power) - 2)
    noise[:above] = np.mean(power[above : min(3 * knee, len(power)) + 1])
    return np.maximum(noise, np.finfo(float).tiny), float(frequency[knee])


def _knee(frequency: Array, smooth: Array, first: int) -> int:
    """Index of the frequency where the spectrum stops falling faster than 1/f^2, searched from ``first`` up.

    A minimum of g = f^2 P(f) over an octave, after which g rises at least fourfold: motion with kinks falls as 1/f^4 or
    faster, encoder quantisation never faster than 1/f^2; a log that was filtered falls again at the end, which is no
    knee. Minima within a factor of four of the lowest count as equal and the highest frequency wins: just above the
    fastest sine of a reference there often is a dip before the answer of friction.
    """
    last = max(int(0.9 * len(smooth)), first + 2)
    at = np.geomspace(frequency[first], frequency[last - 1], max(int(12 * np.log2(last / first)), 2))
    g = np.log(np.maximum(np.interp(at, frequency, smooth), np.finfo(float).tiny)) + 2 * np.log(at)
    rise = np.maximum.accumulate(g[::-1])[::-1] - g
    lowest = minimum_filter1d(g, 13, mode="nearest")
    minima = np.flatnonzero((g <= lowest) & (rise >= np.log(4)))
    if len(minima) == 0:
        return last - 1
    equal = minima[g[minima] <= np.min(g[minima]) + np.log(4)]
    return int(np.clip(np.searchsorted(frequency, at[equal[-1]]), first, last - 1))
