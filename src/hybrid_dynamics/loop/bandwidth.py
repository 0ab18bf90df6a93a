"""Up to which frequency a log's accelerations are those of the arm: its own bandwidth.

Positions that come in coarse steps make accelerations that nobody moved with, the more the higher the frequency.
Inertia times acceleration is larger than what was measured then, a fit of it comes out too small (errors in variables),
and links, rotors and couplings get named for it. What positions (or velocities, where those are measured) scatter by
tells: the level of their spectrum beyond all motion, and what their steps round away.

The cut-off is lowered until a fit of inertia could gain next to nothing from such noise, and no further than where the
motion itself, or too much of a run's ends, would be lost.

That a torque was smoothed before it was logged is not looked for: beyond the motion's frequencies an arm accelerates by
its friction, too, and no torque is measured of that either.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import spectrogram

from hybrid_dynamics.differentiate.scatter import density, level, position_noise, stretch_rows, within
from hybrid_dynamics.loop.heard import Heard, as_heard
from hybrid_dynamics.loop.process import END_PERIODS, ProcessSettings, derivative, hann_kernel, least_rows
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: Shares of the sampling rate between which next to nothing moves: nearer than where positions scatter alone.
_NEARER = (0.2, 0.3)
#: Differences over one sample have twice the power of positions there, over two samples the same: within such a factor.
_LIKE_DIFFERENCES = 3.0
#: States of a run at which its joints' inertias are asked.
_STATES = 60
#: Twice the log-likelihood that a fit of inertia may gain from noise, all joints together: as of one coefficient of two
#: standard errors, half of what a name must have.
_GAIN = 4.0
#: Share of the acceleration that the filter may take beyond what it takes anyway.
_LOST = 0.01
#: Of the torque (rms), the share that no noise should hide that is not the torque's own: friction may be as little.
_LOUD = 0.02
#: Share of all runs that their ends may take: for inertias that are not too small, and for small torques to show.
_ENDS, _ENDS_FOR_POWER = 1 / 6, 1 / 10
#: Lowest cut-off [Hz], and the step from one to the next.
_LOWEST, _STEP = 1.0, 2.0 ** (-1 / 8)


@dataclass(frozen=True)
class _Spectra:
    """Of one run, at frequencies ``f`` (F,) [Hz], per joint (F, n) [(N m)^2/Hz]: torque of the ``inertia`` that moved,
    what was ``felt`` of it, ``noise`` in the torque that it is said to take; ``sensor`` (n,): the level of the torque's
    own noise, ``torque`` its variance [(N m)^2]. ``asked``: the cut-off [Hz] of a run of this rate."""

    f: Array
    inertia: Array
    felt: Array
    noise: Array
    sensor: Array
    torque: Array
    dt: float
    duration: float
    asked: float


@dataclass(frozen=True)
class _Judged:
    """At a cut-off: what a fit of inertia could ``gain`` from noise, as twice the log-likelihood; the largest share of
    a joint's inertial torque that is ``noise``, and that is ``lost`` to the filter; whether noise is ``loud``: it hides
    a :data:`_LOUD` part of a joint's torque that its sensor would show."""

    gain: float
    noise: float
    lost: float
    loud: bool


def narrowed(
    robot: Robot,
    train: Sequence[Trajectory],
    settings: ProcessSettings,
    test: Sequence[Trajectory] = (),
    held_out: float = 1.0,
) -> tuple[ProcessSettings, list[str]]:
    """``settings`` with the cut-off that the ``train`` runs (``q tau``, perhaps ``dq``, on uniform grids) can bear, and
    a line that says so where it is lower than what was asked for.

    No run, nor one of ``test``, becomes too short for the filter by it; of every training run the share ``held_out`` is
    one, too.
    """
    # A run too short for the filter as it is set is refused where it is filtered, and says so.
    if not settings.own_bandwidth or any(len(run.time) < least_rows(run.dt, settings) for run in train):
        return settings, []
    heard = as_heard(robot, train, settings)
    moving = np.any([np.ptp(run["q"], axis=0) >= settings.moving_range for run in train], axis=0) & heard.alive
    if not moving.any():
        return settings, []
    spectra = [_spectra(robot, run, heard, settings.cutoff_at(run.dt)) for run in train]
    asked = max(s.asked for s in spectra)
    best, left = asked, _judged(spectra, asked, moving)
    borne = _LOST + left.lost
    # At both ends of a run the filter knows one side only.
    ends = 2 * END_PERIODS * len(train) / sum(s.duration for s in spectra)
    long_enough = _long_enough([*test, *(run.rows(slice(0, int(held_out * len(run.time)))) for run in train)], settings)
    while left.gain > _GAIN or (left.loud and best * _STEP >= ends / _ENDS_FOR_POWER):
        cutoff = best * _STEP
        if cutoff < max(_LOWEST, ends / _ENDS) or not long_enough(cutoff):
            break
        lower = _judged(spectra, cutoff, moving)
        if lower.lost > max(borne, lower.noise):
            break
        best, left = cutoff, lower
    if best == asked:
        return settings, []
    rest = f"; {left.noise:.2g} of what accelerates is noise still, and inertias come out too small by that"
    signal = "velocities" if "dq" in train[0] else "positions"
    return replace(settings, cutoff=best), [
        f"beyond {best:.2g} Hz accelerations are noise of the {signal}, which are too coarse for more: "
        f"torque and motion are compared up to there, not up to {asked:.3g} Hz"
        f"{rest if left.gain > _GAIN else ''}"
    ]


def _long_enough(runs: Sequence[Trajectory], settings: ProcessSettings) -> Callable[[float], bool]:
    """What says of a cut-off [Hz] whether each of ``runs`` that is long enough for the filter as it is set stays so."""
    usable = [run for run in runs if len(run.time) >= least_rows(run.dt, settings)]
    return lambda cutoff: all(
        len(run.time) >= least_rows(run.dt, replace(settings, cutoff=min(cutoff, settings.cutoff))) for run in usable
    )


def _judged(spectra: Sequence[_Spectra], cutoff: float, moving: NDArray[np.bool_]) -> _Judged:
    sums = np.zeros((5, len(moving)))
    rows = 0.0
    for s in spectra:
        own = min(cutoff, s.asked)
        seen, gone, window = seen_through(s.f, own, s.dt)
        parts = (seen @ s.noise, seen @ s.inertia, gone @ s.felt, window.sum() * s.sensor)
        sums[:4] += s.duration * (s.f[1] - s.f[0]) * np.array(parts)
        sums[4] += s.duration * s.torque
        rows += own * s.duration
    noise, inertia, lost, sensor, torque = sums[:, moving]
    inertia = np.maximum(inertia, 1e-300)
    share = noise / (noise + inertia)
    gain = rows * float(np.sum(share * noise / np.maximum(noise + sensor, 1e-300)))
    loud = bool(np.any(noise > np.maximum(_LOUD**2 * torque, sensor)))
    return _Judged(gain, float(share.max()), float((lost / inertia).max()), loud)


def seen_through(f: Array, cutoff: float, dt: float) -> tuple[Array, Array, Array]:
    """At frequencies ``f`` (F,) [Hz] the shares of a motion's power that pass both filters, the motion's low-pass at
    ``cutoff`` [Hz] and the window that torque and columns pass, too; that the window passes and the low-pass keeps
    back; that the window passes."""
    low_pass = 1.0 / (1.0 + (f / cutoff) ** 8)
    kernel = hann_kernel(1.0 / cutoff, dt)
    half = len(kernel) // 2
    window = np.array([np.cos(2 * np.pi * dt * at * np.arange(-half, half + 1)) @ kernel for at in f]) ** 2
    return window * low_pass**2, window * (1.0 - low_pass) ** 2, window


def _spectra(robot: Robot, run: Trajectory, heard: Heard, asked: float) -> _Spectra:
    q = run["q"]
    dq = run["dq"] if "dq" in run else derivative(q, run.dt)
    ddq = derivative(dq, run.dt)
    rest = robot.inverse_dynamics(q, dq, np.zeros_like(ddq))
    inertial = heard.inertial(robot.inverse_dynamics(q, dq, ddq) - rest, ddq)
    f, moved = _usual(inertial, run.dt)
    _, measured = density(run["tau"], run.dt)
    noise = _scatter(f, run) @ _squared_inertia(robot, q, heard).T
    inertia = np.maximum(moved - noise, 0.0)
    return _Spectra(
        f,
        inertia,
        np.minimum(inertia, _usual(run["tau"], run.dt)[1]),
        noise,
        level(f, measured, run.dt),
        run["tau"].var(axis=0),
        run.dt,
        len(run.time) * run.dt,
        asked,
    )


def _scatter(f: Array, run: Trajectory) -> Array:
    """(F, n) density [(rad/s^2)^2/Hz] of the noise of accelerations.

    That of positions, and of velocities that were measured, is white. Where velocities scatter as differences of the
    positions do, a controller made them of these.
    """
    omega = (2 * np.pi * f[:, None]) ** 2
    from_positions = omega**2 * position_noise(run["q"], run.dt)
    if "dq" not in run:
        return np.asarray(from_positions)
    near = within(f, run.dt, _NEARER)
    positions, speeds = (np.median(density(run[s], run.dt)[1][near], axis=0) for s in ("q", "dq"))
    times = speeds * run.dt**2 / np.maximum(positions, 1e-300)
    differences = (times > 1.0 / _LIKE_DIFFERENCES) & (times < _LIKE_DIFFERENCES)
    return np.asarray(np.where(differences, from_positions, omega * speeds))


def _squared_inertia(robot: Robot, q: Array, heard: Heard) -> Array:
    """(n, n) mean square of the entries of the mass matrix, as ``heard``, along ``q`` (N, n)."""
    at = q[np.linspace(0, len(q) - 1, min(_STATES, len(q))).astype(int)]
    still = np.zeros_like(at)
    weight = robot.inverse_dynamics(at, still, still)
    columns = [
        heard.inertial(robot.inverse_dynamics(at, still, still + one) - weight, still + one)
        for one in np.eye(at.shape[1])
    ]
    return np.asarray(np.mean(np.square(columns), axis=1).T)


def _usual(signal: Array, dt: float) -> tuple[Array, Array]:
    """The mean over all stretches but the loudest: a joint that seldom moves counts, and a knock does not."""
    length = stretch_rows(len(signal), dt)
    f, _, power = spectrogram(  # type: ignore[call-overload]
        signal, 1.0 / dt, "hann", nperseg=length, noverlap=length // 2, detrend="linear", axis=0
    )
    count = power.shape[-1]
    loudest = power.max(axis=-1) if count > 2 else 0.0
    return np.asarray(f), np.asarray((power.sum(axis=-1) - loudest) / max(count - (count > 2), 1))
