"""From a rollout to a recording: what encoders and torque sensors would have logged, and the truth beside it.

State and torque of a recorded row belong to the same instant t_k. The simulated torque jumps there (it is held over
each control period), so the recorded torque is the mean of the two held values on either side, and the true
acceleration likewise: the torque is interpolated between the middles of the control periods. That is what a
differentiator for recordings (central differences, zero-phase filters) assumes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.acting import lagged
from hybrid_dynamics.errors import ConfigError, require
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.references import derive_seed
from hybrid_dynamics.simulation.rollout import Rollout
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array


@dataclass(frozen=True)
class SensorSettings:
    """What is recorded, and how badly.

    ``record_every`` control periods give one row. The position is rounded to ``encoder_resolution`` [rad] (per joint,
    or one number) or to a turn's 2^-``encoder_bits`` (one of the two; 0: ideal). White torque noise has the standard
    deviation ``torque_noise`` [N m] (per joint, or one number) or ``torque_noise_share`` of the effort limit.
    ``velocity``: whether dq is recorded, with white noise ``velocity_noise`` [rad/s].

    Four faults of recordings, for planting: ``torque_gain`` k per joint (recorded = k times true),
    ``position_offset`` [rad] per joint (q_true = q_read + offset), ``delay`` [s] of the torque (positive: late), and
    ``lag`` [s], the time constant of a first-order low-pass that it has passed.
    """

    record_every: int = 1
    encoder_resolution: float | tuple[float, ...] = 0.0
    encoder_bits: int = 0
    torque_noise: float | tuple[float, ...] = 0.0
    torque_noise_share: float = 0.0
    velocity: bool = False
    velocity_noise: float = 0.0
    torque_gain: tuple[float, ...] = ()
    position_offset: tuple[float, ...] = ()
    delay: float = 0.0
    lag: float = 0.0

    def __post_init__(self) -> None:
        require(1 <= self.record_every <= 10_000, f"sensors.record_every = {self.record_every}; expected 1 to 10000")
        steps = _as_tuple(self.encoder_resolution)
        require(
            all(0 <= x < 0.1 for x in steps),
            f"sensors.encoder_resolution = {self.encoder_resolution} rad; expected in [0, 0.1)",
        )
        require(0 <= self.encoder_bits <= 40, f"sensors.encoder_bits = {self.encoder_bits}; expected 0 to 40")
        require(
            not (self.encoder_bits and any(steps)),
            "sensors.encoder_bits and sensors.encoder_resolution exclude each other; set one of them to 0",
        )
        noise = _as_tuple(self.torque_noise)
        require(all(x >= 0 for x in noise), f"sensors.torque_noise = {self.torque_noise} N m; expected >= 0")
        require(
            0 <= self.torque_noise_share <= 1,
            f"sensors.torque_noise_share = {self.torque_noise_share}; expected in [0, 1]",
        )
        require(
            not (self.torque_noise_share and any(noise)),
            "sensors.torque_noise and sensors.torque_noise_share exclude each other; set one of them to 0",
        )
        require(self.velocity_noise >= 0, f"sensors.velocity_noise = {self.velocity_noise} rad/s; expected >= 0")
        require(abs(self.delay) <= 0.1, f"sensors.delay = {self.delay} s; expected at most 0.1 s")
        require(0 <= self.lag <= 0.1, f"sensors.lag = {self.lag} s; expected 0 to 0.1 s")

    def encoder_step(self, n: int) -> Array:
        """Encoder step (n,) [rad], 0 where ideal."""
        if self.encoder_bits:
            return np.full(n, 2 * np.pi / 2**self.encoder_bits)
        return _spread("encoder_resolution", self.encoder_resolution, n)


def true_run(rollout: Rollout, name: str, split: str, record_every: int = 1) -> Trajectory:
    """Noise-free q dq ddq dddq tau at the recorded instants; time starts at 0.

    ddq and dddq are central differences of the simulated velocity over one control period either side.
    """
    period = float(rollout.time[1] - rollout.time[0])
    rows = _rows(len(rollout.time), record_every)
    dq = rollout.dq
    ddq = (dq[rows + 1] - dq[rows - 1]) / (2 * period)
    dddq = (dq[rows + 1] - 2 * dq[rows] + dq[rows - 1]) / period**2
    tau = 0.5 * (rollout.tau[rows - 1] + rollout.tau[rows])
    signals = {"q": rollout.q[rows], "dq": dq[rows], "ddq": ddq, "dddq": dddq, "tau": tau}
    return Trajectory(name, split, (rows - rows[0]) * period, signals)


def record(
    rollout: Rollout, robot: Robot, settings: SensorSettings, name: str, split: str, seed: int = 0
) -> Trajectory:
    """What the sensors log of ``rollout``: q, tau (and dq where recorded) at the instants of :func:`true_run`.

    Noise depends on ``seed`` and ``name`` only.
    """
    rng = np.random.default_rng(derive_seed("sensors", seed, name))
    period = float(rollout.time[1] - rollout.time[0])
    n = robot.n_joints
    rows = _rows(len(rollout.time), settings.record_every)
    middles = np.arange(len(rollout.time)) + 0.5
    wanted = rows - settings.delay / period
    drives = lagged(rollout.tau, np.asarray(middles * period, float), settings.lag)
    tau = np.column_stack([np.interp(wanted, middles, drives[:, j]) for j in range(n)])
    tau *= _per_joint("torque_gain", settings.torque_gain, n, 1.0)
    if settings.torque_noise_share:
        deviation = settings.torque_noise_share * robot.effort_limits
    else:
        deviation = _spread("torque_noise", settings.torque_noise, n)
    tau += deviation * rng.standard_normal(tau.shape)
    q = rollout.q[rows] - _per_joint("position_offset", settings.position_offset, n, 0.0)
    step = settings.encoder_step(n)
    coarse = step > 0
    q[:, coarse] = np.round(q[:, coarse] / step[coarse]) * step[coarse]
    signals = {"q": q, "tau": tau}
    if settings.velocity:
        dq = rollout.dq[rows]
        signals = {"q": q, "dq": dq + settings.velocity_noise * rng.standard_normal(dq.shape), "tau": tau}
    return Trajectory(name, split, (rows - rows[0]) * period, signals)


def _rows(length: int, every: int) -> NDArray[np.int64]:
    """Recorded instants: every ``every``-th, with a neighbour on both sides."""
    rows = np.arange(every, length - 1, every)
    if len(rows) < 2:
        raise ConfigError(f"sensors.record_every = {every} leaves fewer than two of {length} control periods")
    return rows


def _per_joint(name: str, values: tuple[float, ...], n: int, default: float) -> Array:
    require(len(values) in (0, n), f"sensors.{name} holds {len(values)} numbers; the robot has {n} joints")
    return np.asarray(values, float) if values else np.full(n, default)


def _as_tuple(values: float | tuple[float, ...]) -> tuple[float, ...]:
    return values if isinstance(values, tuple) else (values,)


def _spread(name: str, values: float | tuple[float, ...], n: int) -> Array:
    """One number for all joints, or one per joint."""
    return _per_joint(name, values, n, 0.0) if isinstance(values, tuple) else np.full(n, values)
