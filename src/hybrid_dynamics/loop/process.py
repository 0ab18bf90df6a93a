"""From a log to signals that belong together: position, velocity, acceleration and torque at the same bandwidth.

Position (and velocity, where the log has it) passes a zero-phase low-pass; derivatives are central differences of
fourth order. Torque and every column the torque is compared with pass the same short symmetric FIR (parallel
filtering), then both are decimated. Samples near standstill are marked: in the stick band the torque is not a function
of the motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.signal import butter, sosfiltfilt, upfirdn

from hybrid_dynamics.check.clipped import clipped_samples
from hybrid_dynamics.effects import Motion
from hybrid_dynamics.errors import InputError, require
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: States of which wide columns are computed at once: a run of an hour takes no more memory than a minute.
PIECE = 4096
#: States that a model is asked about within one period of the cut-off, at least.
STATES = 8
#: Share by which the sampling rate may lie below the one that is kept.
UNEVEN = 0.01
#: Left out at both ends of a run, in periods of the cut-off: there a filter knows one side only.
END_PERIODS = 2.0


@dataclass(frozen=True)
class ProcessSettings:
    """``cutoff`` [Hz] of position and torque, lowered to ``cutoff_share`` of the sampling rate for slow logs, and with
    ``own_bandwidth`` to what the noise of a log's accelerations leaves (:mod:`.bandwidth`);
    ``rate`` [Hz] at least kept after decimation; ``motion_rate`` [Hz], at least kept of the states a model is asked
    about (and :data:`STATES` in a period of the cut-off; fewer, and a sharp sign of the speed looks like one that turns
    over slowly: at 400 Hz halved to 200 Hz by 0.01 rad/s); ``slow_speed`` [rad/s] below which a joint counts as
    standing; ``moving_range`` [rad] a joint must cover to count as moving."""

    cutoff: float = 25.0
    cutoff_share: float = 0.1
    own_bandwidth: bool = True
    rate: float = 100.0
    motion_rate: float = 400.0
    slow_speed: float = 0.02
    moving_range: float = 0.02

    def __post_init__(self) -> None:
        require(0 < self.cutoff <= 1000, f"cutoff is {self.cutoff}; expected 0 < cutoff <= 1000 Hz")
        require(0 < self.cutoff_share <= 0.2, f"cutoff_share is {self.cutoff_share}; expected 0 < share <= 0.2")
        require(self.rate > 0, f"rate is {self.rate}; expected > 0 Hz")
        require(self.motion_rate >= self.rate, f"motion_rate is {self.motion_rate}; expected at least rate")
        require(self.slow_speed >= 0, f"slow_speed is {self.slow_speed}; expected >= 0 rad/s")
        require(self.moving_range > 0, f"moving_range is {self.moving_range}; expected > 0 rad")

    def cutoff_at(self, dt: float) -> float:
        """Bandwidth [Hz] of a log sampled every ``dt`` [s]."""
        return min(self.cutoff, self.cutoff_share / dt)


@dataclass(frozen=True)
class Run:
    """One processed run. ``motion`` holds M states; ``time`` (K,), ``q dq ddq tau`` (K, n) are smoothed, decimated.

    ``cut_off`` (K, n) is true where the torque is, somewhere in the filter's window
    (:mod:`hybrid_dynamics.check.clipped`), and ``mask`` (K, n) where the joint moves over all of it and that is not so.
    ``smooth`` maps (M, ...) to (K, ...); a row of its result is made of ``window`` states, the next one of those
    ``every`` later.
    """

    name: str
    motion: Motion
    time: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    mask: NDArray[np.bool_]
    cut_off: NDArray[np.bool_]
    smooth: Callable[[Array], Array]
    cutoff: float
    window: int
    every: int

    @property
    def began(self) -> float:
        """Time stamp [s] at which the run did, also of a piece of it."""
        return float(self.time[0]) if self.motion.began is None else self.motion.began

    def pieces(self) -> Iterator[tuple[slice, slice]]:
        """Rows of :attr:`smooth`'s result and the states they are made of, some thousand states at a time."""
        rows = max(PIECE // self.every, 1)
        for first in range(0, len(self.time), rows):
            last = min(first + rows, len(self.time)) - 1
            yield slice(first, last + 1), slice(first * self.every, last * self.every + self.window)


def derivative(x: Array, dt: float) -> Array:
    """Central difference of fourth order along axis 0; second order near the ends."""
    out = np.gradient(x, dt, axis=0)
    if len(x) > 4:
        out[2:-2] = (8 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) / (12 * dt)
    return out


def zero_phase(x: Array, cutoff: float, dt: float) -> Array:
    """The motion's low-pass: ``x`` (T, n), sampled every ``dt`` [s], up to ``cutoff`` [Hz], nothing delayed."""
    trim = int(np.ceil(END_PERIODS / cutoff / dt))
    sections = butter(4, cutoff, fs=1.0 / dt, output="sos")
    return np.asarray(sosfiltfilt(sections, x, axis=0, padlen=min(3 * trim, len(x) - 1)))


def thinned(rate: float, motion_rate: float, row_rate: float) -> tuple[int, int]:
    """How many samples become one state, and how many states one row, of a log sampled at ``rate`` [Hz].

    Rows are as few as ``row_rate`` [Hz] lets them be, states of those as few as ``motion_rate`` lets them be.
    """
    # A rate that stamps give a little too low is no other rate.
    rate *= 1.0 + UNEVEN
    total = max(int(rate / row_rate), 1)
    step = max((s for s in range(1, total + 1) if total % s == 0 and rate / s >= motion_rate), default=1)
    return step, total // step


def hann_kernel(duration: float, dt: float, step: int = 1) -> Array:
    """Symmetric Hann window of ``duration`` [s] with an odd number of taps and unit sum: -6 dB at 1/duration.

    For a signal of which only every ``step``-th sample is there, the same window at those: both are smoothed alike.
    """
    half = max(round(duration / (2 * dt)), 1)
    reach = half // step
    taps = np.cos(np.pi * step * np.arange(-reach, reach + 1) / (2 * (half + 1))) ** 2
    return np.asarray(taps / taps.sum())


def least_rows(dt: float, settings: ProcessSettings) -> int:
    """Samples, one every ``dt`` [s], below which a run is too short for the filter."""
    return 2 * int(np.ceil(END_PERIODS / settings.cutoff_at(dt) / dt)) + max(20, round(0.3 / dt))


def process(trajectory: Trajectory, robot: Robot, settings: ProcessSettings) -> Run:
    """Process one uniformly sampled run; :class:`InputError` where it is too short."""
    dt = trajectory.dt
    if not np.allclose(np.diff(trajectory.time), dt, rtol=1e-2, atol=1e-9):
        raise InputError(f"run {trajectory.name}: time stamps are not uniform; resample the log first")
    if trajectory.n_joints != robot.n_joints:
        raise InputError(
            f"run {trajectory.name}: holds {trajectory.n_joints} joints; robot {robot.name} has {robot.n_joints}"
        )
    rate = 1.0 / dt
    cutoff = settings.cutoff_at(dt)
    trim = int(np.ceil(END_PERIODS / cutoff / dt))
    if len(trajectory.time) < least_rows(dt, settings):
        raise InputError(
            f"run {trajectory.name}: lasts {trajectory.time[-1] - trajectory.time[0]:.2f} s at {rate:.0f} Hz; "
            f"expected at least {2 * trim * dt + 0.5:.1f} s; record longer runs, or hold out whole runs with --test"
        )
    q = zero_phase(trajectory["q"], cutoff, dt)
    dq = zero_phase(trajectory["dq"], cutoff, dt) if "dq" in trajectory else derivative(q, dt)
    ddq = derivative(dq, dt)
    kernel = hann_kernel(1.0 / cutoff, dt)
    half = len(kernel) // 2
    step, keep = thinned(rate, max(settings.motion_rate, STATES * cutoff), max(settings.rate, 2 * cutoff))

    inside = slice(trim, len(q) - trim)
    fine = slice(trim, len(q) - trim, step)
    motion = Motion(
        robot,
        trajectory.time[fine],
        q[fine],
        dq[fine],
        ddq[fine],
        began=trajectory.start,
    )
    coarse = hann_kernel(1.0 / cutoff, dt, step)
    edge = len(coarse) // 2
    count = len(range(edge, len(motion.time) - edge, keep))
    first = trim + edge * step

    def smooth(x: Array) -> Array:
        rows = len(range(edge, len(x) - edge, keep))
        filtered = upfirdn(coarse, x, up=1, down=1, axis=0) if keep == 1 else None
        if filtered is None:
            # Shift so that the first kept output is the one centred on sample `edge`.
            shift = (2 * edge) % keep
            start = (2 * edge) // keep
            padded = np.concatenate([np.zeros(((keep - shift) % keep, *x.shape[1:])), x]) if shift else x
            start += 1 if shift else 0
            return np.asarray(upfirdn(coarse, padded, up=1, down=keep, axis=0))[start : start + rows]
        return np.asarray(filtered)[2 * edge : 2 * edge + rows]

    torque = np.asarray(upfirdn(kernel, trajectory["tau"], axis=0))[half : half + len(q)]
    rows = first + keep * step * np.arange(count)
    speed = minimum_filter1d(np.abs(dq[inside]), size=2 * half + 1, axis=0)
    crossing = minimum_filter1d(dq[inside], 2 * half + 1, axis=0) * -minimum_filter1d(-dq[inside], 2 * half + 1, axis=0)
    cut_off = maximum_filter1d(clipped_samples(trajectory, robot)[inside], size=2 * half + 1, axis=0)
    mask = (speed >= settings.slow_speed) & (crossing > 0) & ~cut_off
    return Run(
        name=trajectory.name,
        motion=motion,
        time=trajectory.time[rows],
        q=smooth(motion.q),
        dq=smooth(motion.dq),
        ddq=smooth(motion.ddq),
        tau=torque[rows],
        mask=mask[rows - trim],
        cut_off=cut_off[rows - trim],
        smooth=smooth,
        cutoff=cutoff,
        window=2 * edge + 1,
        every=keep,
    )


def moving_joints(runs: list[Run], settings: ProcessSettings) -> NDArray[np.bool_]:
    """(n,) which joints move in at least one run."""
    spans = np.array([np.ptp(run.q, axis=0) for run in runs])
    rows = np.array([run.mask.sum(axis=0) for run in runs]).sum(axis=0)
    return np.asarray((spans.max(axis=0) >= settings.moving_range) & (rows >= 20))
