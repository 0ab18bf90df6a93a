"""How a blind case is logged, whichever engine moves the robot: lengths, rates, noise and its colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import butter, lfilter, oaconvolve, sosfilt

from hybrid_dynamics.errors import require
from hybrid_dynamics.loop.process import ProcessSettings, hann_kernel
from hybrid_dynamics.simulation.references import ReferenceSettings
from hybrid_dynamics.study.blind import BlindSettings
from hybrid_dynamics.types import Array

NOISES = ("none", "white", "ar1", "pink", "lowpass", "quantised")
#: Colours and rates that a drawn log may have; white is as frequent as two others.
_NOISES = ("white", "white", "ar1", "lowpass", "quantised")
_RATES = (100.0, 250.0, 500.0, 1000.0)
#: Standard deviation [rad/s] of a logged velocity.
VELOCITY_NOISE = 2e-3


def _reference() -> ReferenceSettings:
    return ReferenceSettings(velocity_share=0.4, maximum_excursion=2.0, rest=0.3, ramp=1.5)


@dataclass(frozen=True)
class LogSettings:
    """``train`` and ``test`` runs of ``duration`` [s] at ``rate`` [Hz]; torque ``noise`` of a standard deviation of
    ``noise_share`` of the effort limit: ``white``; ``ar1`` with the correlation time ``colour`` [s]; ``pink`` (1/f);
    ``lowpass``, white behind a drive's filter of 1/(2 pi ``colour``) Hz; ``quantised``, rounded to steps of that
    deviation. Position is rounded to a turn's 2^-``encoder_bits``; ``velocity``: dq is logged as well.
    """

    train: int = 4
    test: int = 2
    duration: float = 16.0
    rate: float = 500.0
    noise: str = "white"
    noise_share: float = 0.003
    colour: float = 0.02
    encoder_bits: int = 16
    velocity: bool = False
    reference: ReferenceSettings = field(default_factory=_reference)

    def __post_init__(self) -> None:
        require(self.noise in NOISES, f"noise is {self.noise!r}; expected one of {', '.join(NOISES)}")
        require(self.train >= 1, f"train is {self.train}; expected at least one run")
        require(self.test >= 0, f"test is {self.test}; expected no run or more")
        require(3 <= self.duration <= 600, f"duration is {self.duration} s; expected 3 to 600 s")
        require(50 <= self.rate <= 4000, f"rate is {self.rate} Hz; expected 50 to 4000 Hz")
        require(0 <= self.noise_share <= 1, f"noise_share is {self.noise_share}; expected 0 to 1")
        require(self.colour > 0, f"colour is {self.colour} s; expected > 0")


def log_settings(settings: BlindSettings, rng: np.random.Generator) -> LogSettings:
    """How one case is logged: 1 to 6 training runs of 5 to 30 s.

    30 s of training or more; with ``settings.short_logs`` the length of a run does not depend on their number.
    """
    train = int(rng.integers(1, 7))
    if settings.short_logs:
        length = float(np.exp(rng.uniform(np.log(5.0), np.log(30.0))))
    else:
        length = float(np.clip(rng.uniform(30, 60) / train, 5.0, 30.0))
    return LogSettings(
        train=train,
        test=max(settings.test, 1),
        duration=float(np.round(length, 1)),
        rate=float(rng.choice(_RATES)),
        noise=str(rng.choice(_NOISES)),
        noise_share=settings.torque_noise_share,
        encoder_bits=settings.encoder_bits,
        velocity=bool(rng.random() < 0.5),
        reference=settings.reference,
    )


def noise_level(log: LogSettings, effort: Array) -> Array:
    """Standard deviation (n,) [N m] of the torque noise behind the loop's filter."""
    dt = 1.0 / log.rate
    process = ProcessSettings()
    kernel = hann_kernel(1.0 / min(process.cutoff, process.cutoff_share * log.rate), dt)
    kind = "white" if log.noise == "quantised" else log.noise
    sample = coloured(kind, (20000, 1), dt, log.colour, np.random.default_rng(0))[:, 0]
    share = float(np.convolve(sample, kernel, mode="valid").std()) if kind != "none" else 0.0
    return np.asarray(log.noise_share * effort * share)


def measured_level(clean: Sequence[Array], logged: Sequence[Array], log: LogSettings, effort: Array) -> Array:
    """Root mean square (n,) [N m] of what rounding changed in the torque (T, n) of runs, behind the loop's filter.

    It is no white noise where a torque changes by a few steps only: the filter then takes little of it away. A torque
    that does not leave its step is off by up to half a step, and nobody can see by how much.
    """
    kernel = hann_kernel(1.0 / ProcessSettings().cutoff_at(1.0 / log.rate), 1.0 / log.rate)[:, None]
    left = [oaconvolve(b - a, kernel, mode="valid", axes=0) for a, b in zip(clean, logged, strict=True)]
    level = np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0))
    step = _step(log, effort)
    return np.where(np.concatenate(logged).std(axis=0) < 0.5 * step, np.maximum(level, 0.5 * step), level)


def noisy(tau: Array, log: LogSettings, effort: Array, rng: np.random.Generator) -> Array:
    """Torque (T, n) as it is logged: with noise, or in steps."""
    size = log.noise_share * np.where(effort > 0, effort, 1.0)
    if log.noise == "quantised":
        step = _step(log, effort)
        return np.where(step > 0, np.round(tau / np.where(step > 0, step, 1.0)) * step, tau)
    return np.asarray(tau + size * coloured(log.noise, tau.shape, 1.0 / log.rate, log.colour, rng))


def _step(log: LogSettings, effort: Array) -> Array:
    """Step (n,) [N m] of a torque that is logged in steps."""
    return np.asarray(log.noise_share * np.where(effort > 0, effort, 1.0) * np.sqrt(12.0))


def coloured(kind: str, shape: tuple[int, ...], dt: float, colour: float, rng: np.random.Generator) -> Array:
    """Noise (T, n) of unit standard deviation."""
    white = rng.standard_normal(shape)
    if kind == "none":
        return np.zeros(shape)
    if kind == "ar1":
        keep = float(np.exp(-dt / colour))
        # Started in its stationary distribution.
        start = keep * rng.standard_normal((1, *shape[1:]))
        out, _ = lfilter([np.sqrt(1 - keep**2)], [1, -keep], white, axis=0, zi=start)
        return np.asarray(out)
    if kind == "lowpass":
        long = rng.standard_normal((2 * shape[0], *shape[1:]))
        filtered = sosfilt(butter(2, min(1 / (2 * np.pi * colour), 0.4 / dt), fs=1 / dt, output="sos"), long, axis=0)
        return np.asarray(filtered[shape[0] :] / filtered[shape[0] :].std(axis=0))
    if kind == "pink":
        spectrum = np.fft.rfft(white, axis=0)
        frequency = np.fft.rfftfreq(shape[0], dt)
        spectrum /= np.sqrt(np.maximum(frequency, frequency[1]))[:, None]
        spectrum[0] = 0.0
        out = np.fft.irfft(spectrum, n=shape[0], axis=0)
        return np.asarray(out / out.std(axis=0))
    return white
