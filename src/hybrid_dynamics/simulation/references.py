"""References to follow: random multi-sines inside the joint's limits, or given positions.

The multi-sine is the paper's (Section "Data generation"): a random centre inside the limits less a margin, a sum of
sinusoids with random amplitude, frequency and phase, and one scale factor per joint so that position and velocity stay
inside. Three things are added to it and can be switched off: a least excursion (a centre drawn next to a limit leaves
the joint almost at rest), a share of the velocity limit, and standstill with smooth transitions at both ends.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_lsq_spline

from hybrid_dynamics.errors import InputError, require
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

_EPSILON = 1e-9


@dataclass(frozen=True)
class ReferenceSettings:
    """How multi-sine references are drawn.

    ``modes`` sinusoids per joint, with amplitudes (before scaling) and frequencies [Hz] uniform over the two ranges;
    ``margin`` [rad] is kept from every position limit; ``velocity_share`` of the velocity limit is used;
    ``minimum_excursion`` [rad] is the least distance of the centre from the shrunken limits; ``maximum_excursion``
    [rad] bounds the distance from the centre and the centre itself where a joint has no (or a very wide) limit;
    ``rest`` [s] of standstill at both ends, joined by transitions of ``ramp`` [s].
    """

    modes: int = 5
    amplitude: tuple[float, float] = (0.2, 1.0)
    frequency: tuple[float, float] = (0.1, 1.0)
    margin: float = 0.1
    velocity_share: float = 0.8
    minimum_excursion: float = 0.3
    maximum_excursion: float = 3.141592653589793
    rest: float = 0.0
    ramp: float = 0.0

    def __post_init__(self) -> None:
        require(1 <= self.modes <= 1000, f"reference.modes = {self.modes}; expected 1 to 1000")
        for name in ("amplitude", "frequency"):
            bounds = getattr(self, name)
            require(
                len(bounds) == 2 and 0 < bounds[0] <= bounds[1],
                f"reference.{name} = {list(bounds)}; expected two numbers, 0 < low <= high",
            )
        require(self.margin >= 0, f"reference.margin = {self.margin} rad; expected >= 0")
        require(0 < self.velocity_share <= 1, f"reference.velocity_share = {self.velocity_share}; expected in (0, 1]")
        require(
            self.minimum_excursion >= 0, f"reference.minimum_excursion = {self.minimum_excursion} rad; expected >= 0"
        )
        require(self.maximum_excursion > 0, f"reference.maximum_excursion = {self.maximum_excursion} rad; expected > 0")
        require(self.rest >= 0, f"reference.rest = {self.rest} s; expected >= 0")
        require(self.ramp >= 0, f"reference.ramp = {self.ramp} s; expected >= 0")
        require(
            self.rest == 0 or self.ramp > 0,
            f"reference.rest = {self.rest} s needs reference.ramp > 0 s (a smooth start and stop)",
        )


@dataclass(frozen=True)
class Reference:
    """A reference sampled at the control period: ``q`` (N, n) [rad], ``dq`` (N, n) [rad/s]; ``seed`` names it."""

    q: Array
    dq: Array
    seed: str = ""

    def __post_init__(self) -> None:
        if self.q.ndim != 2 or self.q.shape != self.dq.shape:
            raise InputError(f"reference {self.seed}: q has shape {self.q.shape}, dq {self.dq.shape}; expected (N, n)")
        if not (np.isfinite(self.q).all() and np.isfinite(self.dq).all()):
            raise InputError(f"reference {self.seed}: holds NaN or infinite values; expected finite positions")


def shrunken_limits(robot: Robot, settings: ReferenceSettings) -> tuple[Array, Array]:
    """Position limits (n,) [rad] less the margin; endless or very wide joints get +-``maximum_excursion``."""
    low, high = robot.position_limits
    low = np.maximum(low + settings.margin, -settings.maximum_excursion)
    high = np.minimum(high - settings.margin, settings.maximum_excursion)
    for name, a, b in zip(robot.joint_names, low, high, strict=True):
        require(
            b - a >= 2 * settings.minimum_excursion and b > a,
            f"reference.margin = {settings.margin} rad and minimum_excursion = {settings.minimum_excursion} rad leave "
            f"joint {name} no room in [{a:.4g}, {b:.4g}] rad; consider smaller ones",
        )
    return low, high


def multi_sine(robot: Robot, settings: ReferenceSettings, duration: float, period: float, seed: int) -> Reference:
    """Draw one multi-sine reference of ``duration`` [s] sampled every ``period`` [s]; same seed, same reference."""
    rng = np.random.default_rng(seed)
    n = robot.n_joints
    low, high = shrunken_limits(robot, settings)
    room = settings.minimum_excursion
    centre = rng.uniform(low + room, high - room)
    shape = (settings.modes, n)
    amplitude = rng.uniform(*settings.amplitude, shape)
    omega = 2 * np.pi * rng.uniform(*settings.frequency, shape)
    phase = rng.uniform(0, 2 * np.pi, shape)

    time: Array = np.arange(round(duration / period), dtype=np.float64) * period
    window, slope = _window(time, settings)
    raw, raw_rate = np.zeros((len(time), n)), np.zeros((len(time), n))
    for a, w, p in zip(amplitude, omega, phase, strict=True):
        angle = time[:, None] * w + p
        raw += a * np.sin(angle)
        raw_rate += a * w * np.cos(angle)
    raw, raw_rate = window * raw, slope * raw + window * raw_rate

    reach = np.minimum(high - centre, centre - low)
    limit = settings.velocity_share * robot.velocity_limits
    scale = np.minimum(reach / (np.abs(raw).max(axis=0) + _EPSILON), limit / (np.abs(raw_rate).max(axis=0) + _EPSILON))
    return Reference(centre + scale * raw, scale * raw_rate, str(seed))


def reference_from_positions(
    positions: Array, period: float, smoothing: float = 0.02, name: str = "", rate: float | None = None
) -> Reference:
    """A reference from given positions (T, n) [rad] sampled every ``period`` [s].

    Positions in a file are rounded (1e-5 rad at 1 kHz is 0.01 rad/s of velocity noise), so a least-squares cubic
    spline with one knot every ``smoothing`` [s] is laid through them; its derivative is the velocity. ``rate`` [Hz]
    resamples (default: as given).
    """
    x = np.atleast_2d(np.asarray(positions, float))
    if len(x) < 8:
        raise InputError(f"reference {name}: {len(x)} samples; expected at least 8")
    if not np.isfinite(x).all():
        row = int(np.flatnonzero(~np.isfinite(x).all(axis=1))[0])
        raise InputError(f"reference {name}: row {row + 1} is not finite; expected positions in rad")
    time = np.arange(len(x)) * period
    pieces = max(round(time[-1] / max(smoothing, 2 * period)), 1)
    inner = np.linspace(0, time[-1], pieces + 1)[1:-1]
    knots = np.concatenate([np.zeros(4), inner, np.full(4, time[-1])])
    spline = make_lsq_spline(time, x, knots, k=3)
    grid = time if rate is None else np.arange(int(time[-1] * rate) + 1) / rate
    return Reference(spline(grid), spline.derivative()(grid), name)


def derive_seed(*parts: int | str) -> int:
    """A 63-bit seed that depends on all ``parts`` and on nothing else (not on the machine, not on the hash seed)."""
    text = "/".join(str(part) for part in parts)
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 1


def _window(time: Array, settings: ReferenceSettings) -> tuple[Array, Array]:
    """A window (T, 1) that rises from 0 to 1 after ``rest`` within ``ramp`` (and falls likewise), and its rate."""
    if settings.ramp == 0:
        return np.ones((len(time), 1)), np.zeros((len(time), 1))
    end = time[-1]
    require(
        2 * (settings.rest + settings.ramp) < end,
        f"reference.rest = {settings.rest} s and ramp = {settings.ramp} s do not fit twice into {end:.4g} s",
    )
    rising, rising_rate = _quintic((time - settings.rest) / settings.ramp)
    falling, falling_rate = _quintic((end - settings.rest - time) / settings.ramp)
    window = rising * falling
    rate = (rising_rate * falling - rising * falling_rate) / settings.ramp
    return window[:, None], rate[:, None]


def _quintic(x: Array) -> tuple[Array, Array]:
    """Smooth step with zero slope and curvature at 0 and 1, and its derivative."""
    s = np.clip(x, 0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2
