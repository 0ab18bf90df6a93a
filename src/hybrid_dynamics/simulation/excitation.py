"""Exact runs without forward dynamics: a smooth motion is chosen, torque follows by inverse dynamics and effects.

Fast and free of any controller: for tests, and for a first look at what a set of logs could show.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import make_interp_spline

from hybrid_dynamics.effects import Effect, predict, readings
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.references import derive_seed
from hybrid_dynamics.trajectory import Trajectory

FREQUENCIES = (0.1, 0.23, 0.41, 0.67, 1.03)


def excitation(
    robot: Robot,
    effects: Sequence[Effect] = (),
    *,
    name: str = "run",
    split: str = "train",
    seed: int = 0,
    duration: float = 16.0,
    rate: float = 500.0,
    torque_noise_share: float = 0.003,
    encoder_bits: int = 16,
    still: Sequence[int] = (),
) -> Trajectory:
    """One run ``q tau`` of ``robot`` with ``effects``, also those on what is read: a multi-sine of all but ``still``.

    At rest at both ends. Torque noise is white (share of the effort limit), positions are rounded
    to a turn's 2^-``encoder_bits`` (0: exact).
    """
    rng = np.random.default_rng(derive_seed("exercise", seed, name))
    n = robot.n_joints
    low, high = robot.position_limits
    low, high = np.maximum(low, -2.8), np.minimum(high, 2.8)
    time = np.arange(round(duration * rate)) / rate
    omega = 2 * np.pi * np.array(FREQUENCIES)
    amplitude = rng.normal(size=(len(omega), n)) / np.sqrt(omega)[:, None]
    phase = rng.uniform(0, 2 * np.pi, (len(omega), n))
    q = np.einsum("kn,tkn->tn", amplitude, np.sin(omega[:, None] * time[:, None, None] + phase))
    ramp = min(1.5, duration / 4)
    s = np.clip(np.minimum(time, time[-1] - time) / ramp, 0.0, 1.0)
    q *= (s**3 * (10 - 15 * s + 6 * s**2))[:, None]
    half = np.minimum(0.35 * (high - low), 1.5)
    centre = (low + high) / 2
    q = centre + q * half / np.abs(q).max(axis=0)
    q[:, list(still)] = centre[list(still)]
    spline = make_interp_spline(time, q, k=7)
    dq, ddq = spline(time, 1), spline(time, 2)
    # What the encoder reads; what the torque sensor records follows from it.
    q = q - readings(robot, effects).offset
    tau = predict(robot, effects, q, dq, ddq, time)
    tau += rng.normal(size=tau.shape) * torque_noise_share * robot.effort_limits
    if encoder_bits:
        step = 2 * np.pi / 2**encoder_bits
        q = np.round(q / step) * step
    return Trajectory(name, split, time, {"q": q, "tau": tau})


def excitations(
    robot: Robot, effects: Sequence[Effect] = (), *, train: int = 4, test: int = 2, **options: object
) -> tuple[list[Trajectory], list[Trajectory]]:
    """``train`` and ``test`` runs of :func:`excitation`, each its own motion."""
    runs = [
        excitation(robot, effects, name=f"{split}_{k + 1}", split=split, **options)  # type: ignore[arg-type]
        for split, count in (("train", train), ("test", test))
        for k in range(count)
    ]
    return runs[:train], runs[train:]
