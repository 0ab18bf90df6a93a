"""Closed-loop rollouts in lockstep: many runs of one robot advance together, one column each.

Control period T: the PID torque of instant k is held over [kT, (k+1)T); the plant is integrated by semi-implicit Euler
(paper, eq. "franka-simulator-integration") with forward dynamics by the articulated-body algorithm. Row k records
time, q and dq at instant k and the torque held from there on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from hybrid_dynamics.errors import InputError, require
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.controller import RATIO_LIMIT, Controller, effective_inertia
from hybrid_dynamics.simulation.effects import JointEffects
from hybrid_dynamics.simulation.friction import DrySolver
from hybrid_dynamics.simulation.references import Reference
from hybrid_dynamics.types import Array, Progress

_BLOCK = 50
_CHECK_INERTIA_EVERY = 20


@dataclass(frozen=True)
class SimulationSettings:
    """``duration`` [s] of a rollout, ``control_period`` [s] of the zero-order hold, longest ``substep`` [s];
    ``attempts`` redraws before giving up, ``lockstep`` rollouts at once (bounds memory)."""

    duration: float = 10.0
    control_period: float = 1e-3
    substep: float = 1e-4
    attempts: int = 30
    lockstep: int = 20

    def __post_init__(self) -> None:
        require(
            0 < self.control_period <= 0.1,
            f"simulation.control_period = {self.control_period} s; expected in (0, 0.1]",
        )
        require(
            0 < self.substep <= self.control_period,
            f"simulation.substep = {self.substep} s; expected in (0, control_period = {self.control_period}]",
        )
        require(
            self.duration >= 10 * self.control_period,
            f"simulation.duration = {self.duration} s; expected at least ten control periods",
        )
        require(1 <= self.attempts <= 1000, f"simulation.attempts = {self.attempts}; expected 1 to 1000")
        require(1 <= self.lockstep <= 1000, f"simulation.lockstep = {self.lockstep}; expected 1 to 1000")


@dataclass(frozen=True)
class Rollout:
    """One accepted run: ``time`` (N,), ``q dq tau`` (N, n) and the reference it followed; row k as said above."""

    time: Array
    q: Array
    dq: Array
    tau: Array
    reference: Reference


@dataclass(frozen=True)
class Refusal:
    """A run that must not be kept, and why (one line naming the joint)."""

    reference: Reference
    why: str


def simulate(
    robot: Robot,
    references: Sequence[Reference],
    controller: Controller,
    substep: float = 1e-4,
    effects: JointEffects | None = None,
    progress: Progress | None = None,
) -> list[Rollout | Refusal]:
    """Let the true ``robot`` with ``effects`` follow ``references``, started on them; results in the same order.

    The controller may hold another (nominal) robot. Shorter references are held at their end until the longest is over
    and cut afterwards. A run that diverges, leaves the joint limits, needs more than the effort limit or makes the
    sampled loop unstable comes back as a :class:`Refusal`. Raises :class:`InputError` for references of another width.
    """
    for reference in references:
        if reference.q.shape[1] != robot.n_joints:
            raise InputError(
                f"reference {reference.seed} has {reference.q.shape[1]} joints; robot {robot.name} has {robot.n_joints}"
            )
    if not references:
        return []
    steps = max(len(reference.q) for reference in references)
    q_ref, dq_ref = np.empty((2, steps, len(references), robot.n_joints))
    for r, reference in enumerate(references):
        n = len(reference.q)
        q_ref[:n, r], dq_ref[:n, r] = reference.q, reference.dq
        q_ref[n:, r], dq_ref[n:, r] = reference.q[-1], 0.0

    q, dq, tau = np.zeros((3, *q_ref.shape))
    plant = _Plant(robot, effects or JointEffects(), controller.period, substep)
    gravity = _Gravity(controller.robot)
    why: dict[int, str] = {}
    active = np.arange(len(references))
    runs: slice | NDArray[np.int64] = slice(None)  # the active ones, without copying while all are
    state_q, state_dq = q_ref[0].copy(), dq_ref[0].copy()
    integral = np.zeros_like(state_q)
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(steps):
            q[k, runs], dq[k, runs] = state_q, state_dq
            error = q_ref[k, runs] - state_q
            torque = gravity(state_q) + controller.kp * error + integral + controller.kd * (dq_ref[k, runs] - state_dq)
            tau[k, runs] = torque
            integral += controller.ki * controller.period * error
            np.maximum(integral, -controller.integral_limit, out=integral)
            np.minimum(integral, controller.integral_limit, out=integral)
            plant.advance(state_q, state_dq, torque, k * controller.period)
            if (k + 1) % _BLOCK == 0 or k == steps - 1:
                start = k - k % _BLOCK
                lengths = np.array([len(references[int(r)].q) for r in active])
                block = (slice(start, k + 1), runs)
                found = _violations(robot, q[block], dq[block], tau[block])
                for column, (row, message) in found.items():
                    if start + row < lengths[column]:
                        why[int(active[column])] = f"{message} at t = {(start + row) * controller.period:.3f} s"
                keep = np.array([int(r) not in why for r in active])
                if not keep.all():
                    active, state_q, state_dq, integral = active[keep], state_q[keep], state_dq[keep], integral[keep]
                    runs = active
                    plant.keep(keep)
                if not len(active):
                    break
                if progress is not None:
                    progress((k + 1) / steps, f"{len(active)} rollouts, {(k + 1) * controller.period:.1f} s")
    out: list[Rollout | Refusal] = []
    for r, reference in enumerate(references):
        n = len(reference.q)
        message = why.get(r) or _unstable(robot, controller, q[:n, r])
        if message:
            out.append(Refusal(reference, message))
        else:
            time: Array = np.arange(n, dtype=np.float64) * controller.period
            out.append(Rollout(time, q[:n, r].copy(), dq[:n, r].copy(), tau[:n, r].copy(), reference))
    return out


class _Plant:
    """Forward dynamics of all runs over one control period, with preallocated arrays."""

    def __init__(self, robot: Robot, effects: JointEffects, period: float, substep: float) -> None:
        robot.demand_no_mimics("the simulation")
        self.robot, self.effects = robot, effects
        self.substeps = max(int(np.ceil(period / substep - 1e-9)), 1)
        self.h = period / self.substeps
        model = robot.model.copy()
        self.damping = effects.damping
        if self.damping is not None:
            # D (v + h a / 2): half a step of damping acts like inertia, the rest on the velocity known.
            armature = np.array(model.armature)
            armature[robot._v] += 0.5 * self.h * self.damping
            model.armature = armature
        self.model, self.pool = model, pin.ModelPool(model, 1)
        self.plain = _is_plain(robot)
        self.dry = DrySolver(model, robot._v) if effects.dry else None
        self.friction: Array | None = None
        self.load: Array | None = None
        self.memory: list[Array] = []

    def keep(self, rows: NDArray[np.bool_]) -> None:
        """Drop the state of refused runs."""
        if self.friction is not None and self.load is not None:
            self.friction, self.load = self.friction[rows], self.load[rows]
        self.memory = [z[rows] for z in self.memory]

    def acceleration(self, configuration: Array, dq: Array, torque: Array) -> Array:
        if self.plain:
            return _rows(pin.abaInParallel(1, self.pool, configuration, dq.T, torque.T), self.model.nv)
        tangent = self.robot._tangent
        full = pin.abaInParallel(1, self.pool, configuration, tangent(dq), tangent(torque))
        return _rows(full, self.model.nv)[:, self.robot._v]

    def advance(self, q: Array, dq: Array, tau: Array, time: float) -> None:
        """Integrate (R, n) ``q`` and ``dq`` in place over one control period under the held torque."""
        if self.dry is not None:
            self.dry.forget()
            if self.friction is None or self.load is None:
                self.friction, self.load = np.zeros_like(q), np.zeros_like(q)
        laws = self.effects.memory
        if laws and not self.memory:
            self.memory = [np.zeros_like(q) for _ in laws]
        for s in range(self.substeps):
            net = tau
            if self.damping is not None:
                net = net - self.damping * dq
            if self.effects.torque:
                net = net - self.effects.extra_torque(q, dq, time + s * self.h)
            for law, z in zip(laws, self.memory, strict=True):
                net = net - law.torque(z, q, dq, time + s * self.h)
            configuration = q.T if self.plain else self.robot._configuration(q)
            if self.dry is None:
                dq += self.h * self.acceleration(configuration, dq, net)
            else:
                self._advance_dry(q, dq, net, configuration, time + s * self.h)
            q += self.h * dq
            self.memory = [law.advance(z, q, dq, self.h) for law, z in zip(laws, self.memory, strict=True)]

    def _advance_dry(self, q: Array, dq: Array, net: Array, configuration: Array, time: float) -> None:
        assert self.dry is not None
        assert self.friction is not None
        assert self.load is not None
        backward, forward = self.effects.dry_bounds(q, dq, self.load, time)
        f = np.where(dq > 0, forward, np.where(dq < 0, -backward, np.clip(self.friction, -backward, forward)))
        acceleration = self.acceleration(configuration, dq, net - f)
        w = dq + self.h * acceleration
        if (w * dq <= 0).any():
            self.dry.solve(configuration, w, f, backward, forward, self.h)
            acceleration = (w - dq) / self.h
        self.friction = f
        self.load = net - f
        if self.damping is not None:
            self.load = self.load - 0.5 * self.h * self.damping * acceleration
        dq[:] = w


class _Gravity:
    """Gravity torque (R, n) of the controller's robot."""

    def __init__(self, robot: Robot) -> None:
        self.robot, self.pool, self.plain = robot, pin.ModelPool(robot.model, 1), _is_plain(robot)
        self.zero = np.zeros((robot.model.nv, 0))

    def __call__(self, q: Array) -> Array:
        nv = self.robot.model.nv
        if self.zero.shape[1] != len(q):
            self.zero = np.zeros((nv, len(q)), order="F")
        if self.plain:
            return _rows(pin.rneaInParallel(1, self.pool, q.T, self.zero, self.zero), nv)
        torque = pin.rneaInParallel(1, self.pool, self.robot._configuration(q), self.zero, self.zero)
        return _rows(torque, nv)[:, self.robot._v]


def _is_plain(robot: Robot) -> bool:
    """Whether the robot's joints are Pinocchio's, in the same order and without endless ones."""
    index = np.arange(robot.model.nv)
    return bool(robot.model.nq == robot.model.nv and (robot._v == index).all() and (robot._q == index).all())


def _rows(columns: Array, nv: int) -> Array:
    """Pinocchio's (nv, R) as (R, nv); it hands back a flat array for a single column."""
    return np.asarray(columns).reshape(nv, -1).T


def _violations(robot: Robot, q: Array, dq: Array, tau: Array) -> dict[int, tuple[int, str]]:
    """First offence of each run in a block (K, R, n): run -> (row, what the joint did)."""
    low, high = robot.position_limits
    speed = robot.velocity_limits
    speed = np.where(speed > 0, 2 * speed, np.inf)
    effort = np.where(robot.effort_limits > 0, robot.effort_limits, np.inf)
    diverged = ~np.isfinite(q) | ~np.isfinite(dq) | ~np.isfinite(tau) | (np.abs(dq) > speed)
    outside = (q < low) | (q > high)
    saturated = np.abs(tau) > effort
    bad = diverged | outside | saturated
    out: dict[int, tuple[int, str]] = {}
    for run in np.flatnonzero(bad.any(axis=(0, 2))):
        row = int(np.argmax(bad[:, run].any(axis=1)))
        at = (row, run)
        joint = int(np.argmax(diverged[at] if diverged[at].any() else bad[at]))
        name = robot.joint_names[joint]
        if diverged[at][joint]:
            text = f"joint {name} diverges: dq = {dq[at][joint]:.4g} rad/s, expected |dq| <= {speed[joint]:.4g}"
        elif outside[at][joint]:
            text = f"joint {name} leaves its limits: q = {q[at][joint]:.4f} rad, [{low[joint]:.4f}, {high[joint]:.4f}]"
        else:
            text = f"joint {name} saturates: {tau[at][joint]:.4g} N m, effort limit {effort[joint]:.4g} N m"
        out[int(run)] = (row, text)
    return out


def _unstable(robot: Robot, controller: Controller, q: Array) -> str:
    """Empty, or which joint made the sampled velocity loop unstable along ``q`` (N, n)."""
    rows = q[::_CHECK_INERTIA_EVERY]
    ratio = controller.kd * controller.period / effective_inertia(robot, rows)
    row, joint = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
    if ratio[row, joint] < RATIO_LIMIT:
        return ""
    return (
        f"joint {robot.joint_names[joint]}: Kd T / I_eff = {ratio[row, joint]:.3g}, expected < {RATIO_LIMIT}, "
        f"at t = {row * _CHECK_INERTIA_EVERY * controller.period:.3f} s"
    )
