"""Whose speeds a motion is made of: those that a log holds, or the derivative of its positions.

Most controllers make ``dq`` of the positions, with a filter that is late by some milliseconds, or a difference that is
noisy or in coarse steps; its derivative, the acceleration, is off by as much. (Simulated arms whose speed had passed a
low-pass of 8 ms were told a delay, links and a spring for it; with the derivative of the positions friction and rotors
alone, as planted.) A zero-phase filter makes better ones of the positions afterwards, as long as these resolve the
motion; where they are coarse, a speed of a sensor of its own says more.

Both are compared as accelerations in the band that the positions bear: their difference is what positions scatter by
and what ``dq`` is off by. Where it is more than twice (mean square) what positions scatter by, ``dq`` is off by more.
One driver makes the speeds of all joints: where that of one joint is off they are left out, of all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.differentiate.scatter import position_noise
from hybrid_dynamics.loop.bandwidth import narrowed, seen_through
from hybrid_dynamics.loop.process import END_PERIODS, ProcessSettings, derivative, hann_kernel, least_rows, zero_phase
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: The mean square by which speeds and positions differ, as accelerations, beyond which the speeds are off by more.
TWICE = 2.0
#: A difference below this share of what a joint accelerates (rms), or below this [rad/s^2], is none.
SHARE, LEAST = 0.01, 1e-3
#: What positions scatter by is summed at so many frequencies up to this multiple of the cut-off: nothing passes beyond.
_GRID, _REACH = 600, 3.0


@dataclass(frozen=True)
class Speeds:
    """Of n joints whether ``dq`` is ``worse`` than the derivative of q (n,); ``off`` (n,) and ``scatter`` (n,)
    [rad/s^2], rms up to ``cutoff`` [Hz], of the difference of both, and of what positions scatter by."""

    worse: NDArray[np.bool_]
    off: Array
    scatter: Array
    cutoff: float

    def line(self, joints: Sequence[str]) -> str:
        """What is said where they are left out; ``joints``: their names."""
        most = int(np.argmax(np.where(self.worse, self.off / np.maximum(self.scatter, 1e-300), 0.0)))
        return (
            "the derivative of q is taken instead of dq, which is late, noisy or coarse: as accelerations up to "
            f"{self.cutoff:.2g} Hz both differ by {self.off[most]:.2g} rad/s^2 on {joints[most]}, where positions "
            f"scatter by {self.scatter[most]:.2g}"
        )


def judged(runs: Sequence[Trajectory], settings: ProcessSettings) -> Speeds | None:
    """Whether ``dq`` of ``runs`` (uniform grids) is worse than the derivative of ``q`` at the bandwidth of
    ``settings``; None where none is long enough and holds both."""
    usable = [run for run in runs if "dq" in run and len(run.time) >= least_rows(run.dt, settings)]
    if not usable:
        return None
    sums, rows = np.zeros((3, usable[0].n_joints)), 0
    for run in usable:
        dt, cutoff = run.dt, settings.cutoff_at(run.dt)
        inside = slice(trim := int(np.ceil(END_PERIODS / cutoff / dt)), len(run.time) - trim)
        kernel = hann_kernel(1.0 / cutoff, dt)
        speed = derivative(zero_phase(run["q"], cutoff, dt), dt)
        both = derivative(np.hstack([speed, zero_phase(run["dq"], cutoff, dt) - speed]), dt)
        smooth = np.apply_along_axis(np.convolve, 0, both, kernel, "same")[inside]
        moved, off = np.hsplit(np.sum(smooth**2, axis=0), 2)
        f = np.linspace(0.0, min(0.5 / dt, _REACH * cutoff), _GRID)
        through = seen_through(f, cutoff, dt)[0] @ (2 * np.pi * f) ** 4 * f[1]
        sums += np.array([moved, off, len(smooth) * through * position_noise(run["q"], dt)])
        rows += len(smooth)
    moved, off, scatter = sums / rows
    # A joint that stands says of its sensor no more than that it has one.
    moving = np.any([np.ptp(run["q"], axis=0) >= settings.moving_range for run in usable], axis=0)
    worse = moving & (off > TWICE * scatter) & (off > np.maximum(SHARE**2 * moved, LEAST**2))
    return Speeds(worse, np.sqrt(off), np.sqrt(scatter), max(settings.cutoff_at(run.dt) for run in usable))


def own_speeds(runs: Sequence[Trajectory], settings: ProcessSettings) -> tuple[list[Trajectory], Speeds | None]:
    """``runs`` without ``dq`` where these say, at the bandwidth of ``settings``, that it is worse than the derivative
    of ``q``, and what they say then."""
    speeds = judged(runs, settings)
    if speeds is None or not speeds.worse.any():
        return list(runs), None
    return [run.without("dq") for run in runs], speeds


def truer_speeds(
    robot: Robot,
    train: Sequence[Trajectory],
    test: Sequence[Trajectory],
    settings: ProcessSettings,
    held_out: float = 1.0,
) -> tuple[tuple[Trajectory, ...], tuple[Trajectory, ...], list[str]]:
    """``train`` and ``test`` runs, all without ``dq`` where the training runs say that it is worse than the derivative
    of ``q``, the test runs where they do, and a line that says so; the rest as of :func:`~.bandwidth.narrowed`."""
    if not any("dq" in run for run in (*train, *test)):
        return tuple(train), tuple(test), []
    at, _ = narrowed(robot, [run.without("dq") for run in train], settings, test, held_out)
    own, speeds = own_speeds(train, at)
    if speeds is not None:
        return tuple(own), tuple(run.without("dq") for run in test), [speeds.line(robot.joint_names)]
    asked, speeds = own_speeds(test, at)
    return tuple(own), tuple(asked), [] if speeds is None else [f"test runs: {speeds.line(robot.joint_names)}"]
