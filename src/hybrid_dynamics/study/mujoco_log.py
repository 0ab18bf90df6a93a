"""Logs of another engine: random motions, torque by MuJoCo with hidden causes, sensors and coloured noise."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import lsim

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop.process import derivative
from hybrid_dynamics.simulation.references import derive_seed, multi_sine
from hybrid_dynamics.study.blind_logs import VELOCITY_NOISE, LogSettings, noisy
from hybrid_dynamics.study.engine import NATIVE, Engine, Hidden, read_text
from hybrid_dynamics.study.outside import LAWS, READINGS, Course
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array


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
    q = course.q.copy()
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
    tau = noisy(tau, settings, effort, rng)
    signals = {"q": q, "tau": tau}
    if settings.velocity:
        dq = course.dq + VELOCITY_NOISE * rng.standard_normal(course.dq.shape)
        signals = {"q": q, "dq": dq, "tau": tau}
    return signals
