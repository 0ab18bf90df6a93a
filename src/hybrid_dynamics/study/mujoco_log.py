"""Logs of another engine: random motions, torque by MuJoCo with hidden causes, sensors and coloured noise."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, lfilter, lsim, sosfilt

from hybrid_dynamics.errors import InputError, require
from hybrid_dynamics.loop.process import derivative
from hybrid_dynamics.simulation.references import ReferenceSettings, derive_seed, multi_sine
from hybrid_dynamics.study.engine import NATIVE, Engine, Hidden, read_text
from hybrid_dynamics.study.outside import LAWS, READINGS, Course
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

NOISES = ("none", "white", "ar1", "pink", "lowpass", "quantised")


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


def make_mujoco_log(
    robot_urdf: str | os.PathLike[str],
    hidden: Sequence[Hidden] = (),
    duration: float = 16.0,
    rate: float = 500.0,
    noise: str = "white",
    seed: int = 0,
    *,
    lock: tuple[str, ...] = (),
    settings: LogSettings | None = None,
) -> list[Trajectory]:
    """Training runs, then test runs, of the robot in ``robot_urdf`` (path or text) with ``hidden`` causes.

    ``duration``, ``rate`` and ``noise`` are those of :class:`LogSettings`; with ``settings`` they come from there. Same
    arguments, same numbers. Example: ``make_mujoco_log("ur5.urdf", [Hidden("frictionloss", 2, {"torque": 4.0})])``.
    """
    own = settings or LogSettings(duration=duration, rate=rate, noise=noise)
    text = read_text(robot_urdf, lock)
    engine = Engine(text)
    out = []
    for k, (course, tau) in enumerate(motions_of(text, hidden, own, seed)):
        rng = np.random.default_rng(derive_seed("sensors", seed, k))
        signals = read(course, tau, hidden, own, engine.robot.effort_limits, rng)
        out.append(Trajectory(f"run_{k + 1}", "train" if k < own.train else "test", course.time, signals))
    return out


def motions_of(text: str, hidden: Sequence[Hidden], settings: LogSettings, seed: int) -> Iterator[tuple[Course, Array]]:
    """True motion and true torque (T, n) of every run, before anything is read of them."""
    for h in hidden:
        if h.kind not in NATIVE and h.kind not in LAWS and h.kind not in READINGS:
            raise InputError(f"hidden cause {h.kind!r} is unknown; known are {', '.join([*NATIVE, *LAWS, *READINGS])}")
    native = [h for h in hidden if h.kind in NATIVE]
    engine = Engine(text, native)
    bodies = Engine(text, [h for h in native if h.kind in ("mass", "com", "block", "tilt", "armature")])
    period = 1.0 / settings.rate
    for k in range(settings.train + settings.test):
        draw = derive_seed("mujoco", seed, k)
        reference = multi_sine(engine.robot, settings.reference, settings.duration, period, draw)
        time: Array = np.arange(len(reference.q), dtype=np.float64) * period
        motion = (reference.q, reference.dq, derivative(reference.dq, period))
        course = Course(time, *motion, load=bodies.torque(*motion))
        tau = engine.torque(*motion)
        for h in hidden:
            if h.kind in LAWS:
                tau[:, h.at] += LAWS[h.kind](course, h.at, h.values)
        yield course, tau


def read(
    course: Course, tau: Array, hidden: Sequence[Hidden], settings: LogSettings, effort: Array, rng: np.random.Generator
) -> dict[str, Array]:
    """What the sensors log of ``course`` and the true torque ``tau`` (T, n)."""
    q, dt = course.q.copy(), 1.0 / settings.rate
    for h in hidden:
        joint = slice(None) if h.joint is None else h.joint
        if h.kind == "gain":
            tau[:, joint] *= h.values["gain"]
        elif h.kind == "position_offset":
            q[:, joint] -= h.values["offset"]
        elif h.kind == "delay":
            late = np.clip(course.time - h.values["delay"], course.time[0], course.time[-1])
            tau = np.asarray(make_interp_spline(course.time, tau, k=3, axis=0)(late))
        elif h.kind == "lag":
            drive = ([1.0], [h.values["constant"], 1.0])
            tau = tau[0] + np.column_stack([lsim(drive, own, course.time)[1] for own in (tau - tau[0]).T])
    if settings.encoder_bits:
        step = 2 * np.pi / 2**settings.encoder_bits
        q = np.round(q / step) * step
    size = settings.noise_share * np.where(effort > 0, effort, 1.0)
    if settings.noise == "quantised":
        step = size * np.sqrt(12.0)
        tau = np.where(step > 0, np.round(tau / np.where(step > 0, step, 1.0)) * step, tau)
    else:
        tau = tau + size * coloured(settings.noise, tau.shape, dt, settings.colour, rng)
    signals = {"q": q, "tau": tau}
    if settings.velocity:
        dq = course.dq + 2e-3 * rng.standard_normal(course.dq.shape)
        signals = {"q": q, "dq": dq, "tau": tau}
    return signals


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
