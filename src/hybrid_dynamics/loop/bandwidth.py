"""Up to which frequency accelerations and torque tell of each other: a log's own bandwidth.

Positions that come in coarse steps make accelerations that nobody moved with, the more the higher the frequency; a
torque that was smoothed before it was logged lacks what the arm did. Either way inertia times acceleration is larger
than what was measured, a fit of it comes out too small, and links, rotors and couplings get named for it (errors in
variables; Gautier and Poignet 2001 choose their filters by hand for the same reason). Two things tell:

- what positions (or velocities, where those are measured) scatter by: the level of their spectrum beyond all motion,
  at least what their steps round away;
- rigid-body torque of which the measured one has next to nothing: beyond the frequencies of the motion inertia acts
  alone, and what it takes must have been there.

The cut-off is lowered until all that a fit of inertia could gain from such noise is below one unit of likelihood, and
no further than where the motion itself would be lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal import csd, welch

from hybrid_dynamics.loop.process import END_PERIODS, ProcessSettings, derivative, hann_kernel
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: Length [s] of the stretches whose spectra are taken the median of: a knock or a glitch is in one of them.
_STRETCH = 2.0
#: Shares of the sampling rate between which next to nothing moves, and positions scatter alone.
_BEYOND_MOTION = (0.3, 0.5)
#: States of a run at which its joints' inertias are asked.
_STATES = 60
#: Power by which the torque of the rigid body may exceed what was measured: links of a URDF can weigh twice too much.
_MARGIN = 4.0
#: Frequencies over which that is asked together.
_BINS = 5
#: Power of accelerations over that of their noise from which on they are heard.
_CLEAR = 10.0
#: Share of the measured power below whose frequency the motion lies.
_MOTION = 0.99
#: Share of the acceleration that the filter may take beyond what it takes anyway.
_LOST = 0.01
#: Of the torque (rms), the share that no noise should hide that is not the torque's own: friction may be as little.
_LOUD = 0.02
#: Share of the longest run that its ends may take.
_ENDS = 1 / 6
#: Lowest cut-off [Hz], and the step from one to the next.
_LOWEST, _STEP = 1.0, 2.0 ** (-1 / 8)


@dataclass(frozen=True)
class _Spectra:
    """Of one run, at frequencies ``f`` (F,) [Hz], per joint (F, n) [(N m)^2/Hz]: torque of the ``inertia`` that moved,
    what was ``felt`` of it, ``noise`` in the torque that it is said to take; ``sensor`` (n,): the level of the torque's
    own noise, ``torque`` its variance [(N m)^2]."""

    f: Array
    inertia: Array
    felt: Array
    noise: Array
    sensor: Array
    torque: Array
    dt: float
    duration: float


def narrowed(robot: Robot, runs: Sequence[Trajectory], settings: ProcessSettings) -> tuple[ProcessSettings, list[str]]:
    """``settings`` with the cut-off that ``runs`` (``q``, perhaps ``dq`` and ``tau``, on uniform grids) can bear, and a
    line that says so where it is lower than what was asked for."""
    if not settings.own_bandwidth:
        return settings, []
    moving = np.any([np.ptp(run["q"], axis=0) >= settings.moving_range for run in runs], axis=0)
    heavy = _with_rotors(robot, runs)
    spectra = [_spectra(heavy, run) for run in runs]
    asked = max(settings.cutoff_at(run.dt) for run in runs)
    best, cutoff = asked, asked
    borne = _LOST + _judged(spectra, asked, moving)[2]
    # At both ends of a run the filter knows one side only.
    ends = 2 * END_PERIODS / (_ENDS * max(run.time[-1] - run.time[0] for run in runs))
    while cutoff >= max(_LOWEST, ends):
        gain, noisy, lost, loud = _judged(spectra, cutoff, moving)
        if lost > max(borne, noisy):
            break
        best = cutoff
        if gain <= 1.0 and not loud:
            break
        cutoff *= _STEP
    if best == asked:
        return settings, []
    left = _judged(spectra, best, moving)
    rest = (
        f"; {left[1]:.2g} of what accelerates is noise still, and inertias come out too small by that"
        if (left[0] > 1.0)
        else ""
    )
    return replace(settings, cutoff=best), [
        f"beyond {best:.2g} Hz accelerations ask for torque that was not measured (positions too coarse or too noisy, "
        f"or a torque that was smoothed before it was logged): compared up to there, not up to {asked:.3g} Hz{rest}"
    ]


def _judged(spectra: Sequence[_Spectra], cutoff: float, moving: NDArray[np.bool_]) -> tuple[float, float, float, bool]:
    """At this ``cutoff`` [Hz]: what a fit of inertia could gain from noise, in units of twice the log-likelihood; the
    largest share of a moving joint's inertial torque that is noise; and that is lost to the filter; whether noise
    hides a :data:`_LOUD` part of a joint's torque that its sensor would show."""
    sums = np.zeros((5, len(moving)))
    length = 0.0
    for s in spectra:
        own = min(cutoff, s.f[-1])
        low_pass = 1.0 / (1.0 + (s.f / own) ** 8)
        kernel = hann_kernel(1.0 / own, s.dt)
        half = len(kernel) // 2
        turns = np.cos(2 * np.pi * s.dt * np.outer(s.f, np.arange(-half, half + 1)))
        window = (turns @ kernel) ** 2
        seen, gone = window * low_pass**2, window * (1.0 - low_pass) ** 2
        parts = (seen @ s.noise, seen @ s.inertia, gone @ s.felt, window.sum() * s.sensor)
        sums[:4] += s.duration * (s.f[1] - s.f[0]) * np.array(parts)
        sums[4] += s.duration * s.torque
        length += s.duration
    noise, inertia, lost, sensor, torque = sums[:, moving]
    inertia = np.maximum(inertia, 1e-300)
    share = noise / (noise + inertia)
    rows = cutoff * length
    gain = rows * float(np.sum(share * noise / np.maximum(noise + sensor, 1e-300)))
    # Of a joint whose torque never changes there is nothing to hide.
    loud = bool(np.any((noise > np.maximum(_LOUD**2 * torque, sensor)) & (torque > 0.0)))
    return gain, float(share.max(initial=0.0)), float((lost / inertia).max(initial=0.0)), loud


def _spectra(robot: Robot, run: Trajectory) -> _Spectra:
    q, dq, ddq = _motion(run)
    whole = robot.inverse_dynamics(q, dq, ddq)
    inertial = whole - robot.inverse_dynamics(q, dq, np.zeros_like(ddq))
    f, moved = _welch(inertial, run.dt, "mean")
    noise = (2 * np.pi * f[:, None]) ** _order(run) * (_scatter(run) @ _squared_inertia(robot, q).T)
    most, sensor, torque = np.full_like(noise, np.inf), np.zeros(run.n_joints), np.zeros(run.n_joints)
    if "tau" in run:
        _, most = _welch(run["tau"], run.dt)
        torque = run["tau"].var(axis=0)
        sensor = np.median(most[_beyond(f, run.dt)], axis=0)
        noise = np.maximum(noise, _unmeasured(_welch(whole, run.dt)[1], most))
        _, most = _welch(run["tau"], run.dt, "mean")
    inertia = np.maximum(moved - noise, 0.0)
    felt = np.minimum(inertia, most)
    return _Spectra(f, inertia, felt, noise, sensor, torque, run.dt, len(run.time) * run.dt)


def _unmeasured(asked: Array, measured: Array) -> Array:
    """(F, n) what the rigid body's torque has of power beyond all that the ``measured`` one could have, at frequencies
    above those of the motion: a unit or a weight that is off is in both."""
    power = np.cumsum(measured, axis=0)
    slow = power <= _MOTION * power[-1]
    slow[0] = True
    ratio = np.maximum(np.sum(asked * slow, axis=0) / np.maximum(np.sum(measured * slow, axis=0), 1e-300), 1.0)
    # At a single frequency weight, friction and inertia may cancel by chance.
    wide = [uniform_filter1d(x, _BINS, axis=0) for x in (asked, measured)]
    return np.asarray(np.where(slow, 0.0, np.maximum(wide[0] - _MARGIN * ratio * wide[1], 0.0)))


def _order(run: Trajectory) -> int:
    """Power of the frequency by which the noise of positions, or of measured velocities, grows in accelerations."""
    return 2 if "dq" in run else 4


def _motion(run: Trajectory) -> tuple[Array, Array, Array]:
    dq = run["dq"] if "dq" in run else derivative(run["q"], run.dt)
    return run["q"], dq, derivative(dq, run.dt)


def _scatter(run: Trajectory) -> Array:
    """(n,) density [rad^2/Hz, (rad/s)^2/Hz] of the noise of what accelerations are made from."""
    signal = run["dq"] if "dq" in run else run["q"]
    f, power = _welch(signal, run.dt)
    level = np.median(power[_beyond(f, run.dt)], axis=0)
    return np.maximum(level, _steps(signal) ** 2 / 12 * 2 * run.dt)


def _steps(signal: Array) -> Array:
    """(n,) smallest step between values of ``signal`` (N, n); of a fine one next to nothing."""
    out = np.zeros(signal.shape[1])
    for j, column in enumerate(signal.T):
        gaps = np.diff(np.unique(column))
        # What differs by rounding is one value.
        real = gaps[gaps > 1e-6 * np.ptp(column)]
        out[j] = real.min() if len(real) else 0.0
    return out


def _squared_inertia(robot: Robot, q: Array) -> Array:
    """(n, n) mean square of the entries of the mass matrix along ``q`` (N, n)."""
    at = q[np.linspace(0, len(q) - 1, min(_STATES, len(q))).astype(int)]
    still = np.zeros_like(at)
    weight = robot.inverse_dynamics(at, still, still)
    columns = [robot.inverse_dynamics(at, still, still + one) - weight for one in np.eye(at.shape[1])]
    return np.asarray(np.mean(np.square(columns), axis=1).T)


def _with_rotors(robot: Robot, runs: Sequence[Trajectory]) -> Robot:
    """``robot`` with rotors where what its links leave of the torque follows the acceleration of the joint: URDFs
    seldom have them. A lighter weight and a spring act against it, friction across it; neither looks like one."""
    inertia = np.zeros(robot.n_joints)
    for run in (run for run in runs if "tau" in run):
        q, dq, ddq = _motion(run)
        left = run["tau"] - robot.inverse_dynamics(q, dq, ddq)
        f, power = _welch(ddq, run.dt, "mean")
        _, together = csd(  # type: ignore[call-overload]  # the stubs know no detrend="linear"
            ddq, left, 1.0 / run.dt, nperseg=_length(len(ddq), run.dt), detrend="linear", axis=0
        )
        noise = (2 * np.pi * f[:, None]) ** _order(run) * _scatter(run)
        clear = power > _CLEAR * noise
        own = np.sum(together.real * clear, axis=0) / np.maximum(np.sum(power * clear, axis=0), 1e-300)
        inertia = np.maximum(inertia, own)
    heavy = robot.copy()
    rotors = heavy.model.armature.copy()
    for j, joint in enumerate(robot.joint_ids):
        rotors[robot.model.idx_vs[joint]] += inertia[j]
    heavy.model.armature = rotors
    return heavy


def _length(rows: int, dt: float) -> int:
    return max(min(round(_STRETCH / dt), rows // 2), 8)


def _welch(signal: Array, dt: float, average: Literal["mean", "median"] = "median") -> tuple[Array, Array]:
    f, power = welch(  # type: ignore[call-overload]
        signal, 1.0 / dt, nperseg=_length(len(signal), dt), detrend="linear", axis=0, average=average
    )
    return np.asarray(f), np.asarray(power)


def _beyond(f: Array, dt: float) -> NDArray[np.bool_]:
    low, high = _BEYOND_MOTION
    return np.asarray((f >= low / dt) & (f <= high / dt))
