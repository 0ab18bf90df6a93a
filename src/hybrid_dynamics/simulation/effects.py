"""What a simulated joint feels beyond the rigid body, as torques the drive must ADD (vectorised over rollouts).

Four kinds, because each needs its own integration:

- ``damping``: viscous coefficients; taken at the middle of the sub-step, so stiff damping stays stable;
- ``dry``: the size of Coulomb-like friction; solved as true sticking (see :mod:`.friction`), never as ``sign(dq)``;
- ``memory``: laws with a state of their own (Dahl's presliding); the state advances with the new velocity;
- ``torque``: anything else (springs, ripple, contact, coupling); explicit at the beginning of the sub-step.

Changes of inertia, armature or gravity are not forces: pass another ``Robot`` to the simulation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hybrid_dynamics.types import Array

#: ``torque(q, dq, time) -> (R, n)`` [N m] with q, dq (R, n) [rad, rad/s] and time [s].
TorqueLaw = Callable[[Array, Array, float], Array]
#: ``dry(q, dq, load, time) -> (backward, forward)``: friction torques >= 0, (n,) or (R, n) [N m], for dq < 0 and
#: dq > 0; ``load`` (R, n) is the rigid-body torque of the joint [N m].
DryLaw = Callable[[Array, Array, Array, float], tuple[Array, Array]]


class MemoryLaw(Protocol):
    """A law with a state z (R, n), zero at the start of a run. All methods are pure: the simulation keeps z."""

    def torque(self, z: Array, q: Array, dq: Array, time: float) -> Array:
        """Torque (R, n) [N m] the drive must add."""

    def advance(self, z: Array, q: Array, dq: Array, h: float) -> Array:
        """The state after a sub-step of ``h`` [s] at velocity ``dq``."""


@dataclass(frozen=True)
class JointEffects:
    """Effects acting on the joints; ``damping`` (n,) [N m s/rad]. Several laws of a kind add up."""

    damping: Array | None = None
    dry: tuple[DryLaw, ...] = ()
    torque: tuple[TorqueLaw, ...] = ()
    memory: tuple[MemoryLaw, ...] = ()

    def __add__(self, other: JointEffects) -> JointEffects:
        parts = [d for d in (self.damping, other.damping) if d is not None]
        damping = np.sum(parts, axis=0) if parts else None
        return JointEffects(damping, self.dry + other.dry, self.torque + other.torque, self.memory + other.memory)

    def dry_bounds(self, q: Array, dq: Array, load: Array, time: float) -> tuple[Array, Array]:
        """Total dry friction (backward, forward), each (R, n) [N m], never negative."""
        backward, forward = np.zeros_like(q), np.zeros_like(q)
        for law in self.dry:
            low, high = law(q, dq, load, time)
            backward += low
            forward += high
        return np.maximum(backward, 0.0), np.maximum(forward, 0.0)

    def extra_torque(self, q: Array, dq: Array, time: float) -> Array:
        """Sum of the ``torque`` laws, (R, n) [N m]."""
        total = np.zeros_like(q)
        for law in self.torque:
            total += law(q, dq, time)
        return total


def viscous(coefficients: Sequence[float] | Array) -> JointEffects:
    """Fv dq [N m s/rad]."""
    return JointEffects(damping=np.asarray(coefficients, float))


def coulomb(forward: Sequence[float] | Array, backward: Sequence[float] | Array | None = None) -> JointEffects:
    """Fc sign(dq) [N m]; with ``backward`` another level for dq < 0."""
    up = np.asarray(forward, float)
    down = up if backward is None else np.asarray(backward, float)
    return JointEffects(dry=(lambda q, dq, load, time: (down, up),))


def stribeck(
    coulomb_torque: Sequence[float] | Array, static_torque: Sequence[float] | Array, velocity: float | Array
) -> JointEffects:
    """(Fc + (Fs - Fc) exp(-(dq/vs)^2)) sign(dq)."""
    fc, fs = np.asarray(coulomb_torque, float), np.asarray(static_torque, float)

    def law(q: Array, dq: Array, load: Array, time: float) -> tuple[Array, Array]:
        level = fc + (fs - fc) * np.exp(-((dq / velocity) ** 2))
        return level, level

    return JointEffects(dry=(law,))


def load_dependent(coefficients: Sequence[float] | Array) -> JointEffects:
    """mu |tau_load| sign(dq), tau_load the rigid-body torque of the joint."""
    mu = np.asarray(coefficients, float)

    def law(q: Array, dq: Array, load: Array, time: float) -> tuple[Array, Array]:
        level = mu * np.abs(load)
        return level, level

    return JointEffects(dry=(law,))


def offset(torque: Sequence[float] | Array) -> JointEffects:
    """A constant torque b [N m]."""
    b = np.asarray(torque, float)
    return JointEffects(torque=(lambda q, dq, time: b,))


@dataclass(frozen=True)
class Dahl:
    """Presliding hysteresis: torque K z, dz/dt = dq - |dq| z K/Fc (Dahl 1968). K (n,) [N m/rad], Fc (n,) [N m] > 0."""

    stiffness: Array
    coulomb_torque: Array

    def torque(self, z: Array, q: Array, dq: Array, time: float) -> Array:
        """Torque (R, n) [N m] at states ``z``, ``q``, ``dq`` (R, n)."""
        return self.stiffness * z

    def advance(self, z: Array, q: Array, dq: Array, h: float) -> Array:
        """The memory ``z`` (R, n) after a sub-step of ``h`` [s]."""
        # Exact for a velocity that is constant over the sub-step: z tends to Fc/K sign(dq).
        limit = np.sign(dq) * self.coulomb_torque / self.stiffness
        return limit + (z - limit) * np.exp(-np.abs(dq) * h * self.stiffness / self.coulomb_torque)


def dahl(stiffness: Sequence[float] | Array, coulomb_torque: Sequence[float] | Array) -> JointEffects:
    """Dahl's hysteresis; a joint without it has Fc = 0 (its stiffness is then of no account)."""
    fc, k = np.asarray(coulomb_torque, float), np.asarray(stiffness, float)
    absent = fc <= 0
    return JointEffects(memory=(Dahl(np.where(absent, 1e-9, k), np.where(absent, 1e-9, fc)),))


def from_state_torque(torque: Callable[[Array, Array], Array], n_joints: int) -> JointEffects:
    """Effects from one law ``torque(q, dq) -> (R, n)`` [N m] that may jump at dq = 0 (Coulomb, Stribeck, asymmetric).

    Per joint, half the jump at standstill becomes dry friction (true sticking) and the rest, continuous in dq, stays as
    it is; its slope over 0.1 to 1 rad/s at q = 0 is integrated as damping, so that stiff viscous terms stay stable. The
    torque of a moving joint is the law's own, whatever the split. The jump of joint j must come from its own velocity.
    """
    tiny = 1e-9
    ones = np.ones((1, n_joints))
    slope = (torque(0 * ones, ones) - torque(0 * ones, 0.1 * ones))[0] / 0.9
    damping = np.maximum(slope, 0.0)

    def half_jump(q: Array) -> Array:
        speed = np.full_like(q, tiny)
        return np.maximum(0.5 * (torque(q, speed) - torque(q, -speed)), 0.0)

    def smooth(q: Array, dq: Array, time: float) -> Array:
        return np.asarray(torque(q, dq) - half_jump(q) * np.sign(dq) - damping * dq)

    def dry(q: Array, dq: Array, load: Array, time: float) -> tuple[Array, Array]:
        level = half_jump(q)
        return level, level

    jumps = bool((half_jump(0 * ones) > 1e-6).any())
    return JointEffects(damping, (dry,) if jumps else (), (smooth,))
