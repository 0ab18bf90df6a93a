"""Blocks of data reduced to triangular factors, joint by joint, so that nothing later touches a sample again.

A block is a stretch of one trajectory. Per block and joint j the rows

    [Y_base (p) | dq_j | sign(dq_j) for each width | 1 | tau_j]

are reduced to the R of their QR. Weighting joints, choosing a sign width, cross-validation over blocks, the fit and
the jackknife all work on these factors; memory does not depend on the number of samples.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.signal
from numpy.typing import NDArray

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.identification.base_parameters import BaseParameters, full_regressor
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

_FEWEST_MOVING_ROWS = 0.05  # below this share of moving rows a joint's friction is left at zero


def smooth_sign(dq: Array, width: float) -> Array:
    """``tanh(dq / width)``, or sign(dq) at width 0 [rad/s]."""
    return np.tanh(dq / width) if width > 0 else np.sign(dq)


def low_pass_taps(cutoff: float, dt: float) -> Array:
    """Symmetric (zero-phase) FIR low-pass: Hamming window, -6 dB at ``cutoff`` [Hz], sum 1. ``[1]`` for cutoff 0."""
    if cutoff <= 0 or cutoff >= 0.5 / dt:
        return np.ones(1)
    half = int(np.ceil(0.8 / (cutoff * dt)))
    return np.asarray(scipy.signal.firwin(2 * half + 1, cutoff, fs=1.0 / dt))


@dataclass(frozen=True)
class BlockFactors:
    """``factors`` (B, n, c, c) upper triangles with c = p + 1 + W + 1 + 1 of the rows that are fitted, ``slow`` of
    those left out, ``rows`` (B, n) samples behind ``factors``, ``trajectory`` (B,) index of the trajectory of each
    block, ``widths`` (W,) [rad/s], ``moving`` (n,) whether the joint moved enough for friction."""

    factors: Array
    slow: Array
    rows: NDArray[np.intp]
    trajectory: NDArray[np.intp]
    widths: tuple[float, ...]
    moving: NDArray[np.bool_]


def block_factors(
    robot: Robot,
    base: BaseParameters,
    trajectories: Iterable[Trajectory],
    *,
    widths: tuple[float, ...],
    min_speed: float,
    block_seconds: float,
    max_rows: int,
    filter_cutoff: float,
) -> BlockFactors:
    """Reduce ``trajectories`` (with ``q dq ddq tau``) to block factors.

    Every ``stride``-th row is used so that at most ``max_rows`` remain. Rows with ``|dq_j| < min_speed`` [rad/s] are
    left out for joint j (in the stick band the torque is no function of the motion) unless the joint hardly moves
    at all. With ``filter_cutoff`` [Hz] torque and every column pass the same FIR (parallel filtering).
    """
    runs = list(trajectories)
    if not runs:
        raise InputError("least squares: no trajectory to fit; give at least one with split 'train'")
    for run in runs:
        for signal in ("q", "dq", "ddq", "tau"):
            bad = np.argwhere(~np.isfinite(run[signal]))
            if len(bad):
                raise InputError(
                    f"trajectory {run.name}: {signal}{bad[0, 1] + 1} is {run[signal][tuple(bad[0])]} in row "
                    f"{bad[0, 0] + 1}; remove or repair the row"
                )
        if run.n_joints != robot.n_joints:
            raise InputError(f"trajectory {run.name}: {run.n_joints} joints; robot {robot.name} has {robot.n_joints}")
        if len(run.time) < 2:
            raise InputError(f"trajectory {run.name}: {len(run.time)} samples; expected at least 2")
    n = robot.n_joints
    total = sum(len(run.time) for run in runs)
    stride = max(1, -(-total // max_rows))
    speeds = np.concatenate([np.abs(run["dq"][::stride]) for run in runs])
    share = np.mean(speeds >= min_speed, axis=0)
    moving = (share >= _FEWEST_MOVING_ROWS) & (speeds.max(axis=0) > 0)
    duration = sum(run.time[-1] - run.time[0] for run in runs)
    seconds = float(np.clip(block_seconds, duration / 256, max(duration / 20, 1e-9)))

    factors, slow, rows, owner = [], [], [], []
    for index, run in enumerate(runs):
        taps = low_pass_taps(filter_cutoff, run.dt)
        half = len(taps) // 2
        length = max(stride, round(seconds / run.dt))
        last = len(run.time) - half
        if last <= half:
            raise InputError(
                f"trajectory {run.name}: {len(run.time)} samples are shorter than the filter's {len(taps)}; "
                "consider a higher filter_cutoff"
            )
        pieces = max(1, (last - half) // length)
        edges = np.linspace(half, last, pieces + 1).astype(int)
        for start, stop in itertools.pairwise(edges):
            centre = np.arange(start, stop, stride)
            kept = np.abs(run["dq"][centre]) >= min_speed
            kept[:, ~moving] = True
            columns = _columns(robot, base, run, centre, taps, widths)
            factors.append([_triangle(columns[kept[:, j], j]) for j in range(n)])
            slow.append([_triangle(columns[~kept[:, j], j]) for j in range(n)])
            rows.append(kept.sum(axis=0))
            owner.append(index)
    return BlockFactors(np.array(factors), np.array(slow), np.array(rows), np.array(owner), widths, moving)


def _columns(
    robot: Robot,
    base: BaseParameters,
    run: Trajectory,
    centre: NDArray[np.intp],
    taps: Array,
    widths: tuple[float, ...],
) -> Array:
    """Rows (len(centre), n, c) of one block, filtered by ``taps``."""
    half = len(taps) // 2
    index = centre if half == 0 else np.arange(centre[0] - half, centre[-1] + half + 1)
    q, dq, ddq, tau = (run[s][index] for s in ("q", "dq", "ddq", "tau"))
    regressor = full_regressor(robot, q, dq, ddq)[:, :, base.independent]
    extra = [dq, *(smooth_sign(dq, w) for w in widths), np.ones_like(dq), tau]
    columns = np.concatenate([regressor, np.stack(extra, axis=2)], axis=2)
    if half == 0:
        return columns
    weights = np.zeros((len(centre), len(index)))
    at = centre - centre[0]
    for k, tap in enumerate(taps):
        weights[np.arange(len(centre)), at + k] = tap
    return np.asarray((weights @ columns.reshape(len(index), -1)).reshape(len(centre), *columns.shape[1:]))


def _triangle(rows: Array) -> Array:
    """Upper triangle (c, c) of the QR of ``rows`` (k, c), zero-padded where k < c."""
    c = rows.shape[1]
    out = np.zeros((c, c))
    if len(rows):
        upper = scipy.linalg.qr(rows, mode="r", check_finite=False)[0][:c]
        out[: len(upper)] = upper
    return out
