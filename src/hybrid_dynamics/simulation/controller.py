"""Joint-space PID with gravity compensation (paper, Section "Controller"), and gains that keep the sampled loop stable.

A velocity gain held for a control period T acts on the effective inertia I_eff = 1/(M^-1)_jj of its joint (the inertia
felt when the other joints are free). The sampled loop is stable only while Kd T / I_eff stays well below 2; where it
came to 1.7 rollouts diverged. Finer integration does not help, so the ratio is bounded here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from hybrid_dynamics.errors import ConfigError, require
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: Largest Kd T / I_eff a rollout may reach.
RATIO_LIMIT = 0.8


@dataclass(frozen=True)
class ControllerSettings:
    """How gains are chosen; ``kp``, ``ki``, ``kd`` (one number per joint) replace the automatic ones.

    ``ratio`` is Kd T / I_eff at the smallest effective inertia found; ``damping_ratio`` is that of the position loop at
    the largest inertia M_jj (drive damping not counted); ``integral_rate`` [1/s] is Ki/Kp; the integral's torque is
    clipped to ``integral_share`` of the effort limit; Kp is at most the effort limit per ``stiffest_error`` [rad].
    """

    ratio: float = 0.6
    damping_ratio: float = 0.3
    integral_rate: float = 1.0
    integral_share: float = 0.3
    stiffest_error: float = 0.05
    kp: tuple[float, ...] = ()
    ki: tuple[float, ...] = ()
    kd: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        require(0 < self.ratio < RATIO_LIMIT, f"controller.ratio = {self.ratio}; expected in (0, {RATIO_LIMIT})")
        require(self.damping_ratio > 0, f"controller.damping_ratio = {self.damping_ratio}; expected > 0")
        require(self.integral_rate >= 0, f"controller.integral_rate = {self.integral_rate} 1/s; expected >= 0")
        require(0 <= self.integral_share <= 1, f"controller.integral_share = {self.integral_share}; expected in [0, 1]")
        require(self.stiffest_error > 0, f"controller.stiffest_error = {self.stiffest_error} rad; expected > 0")
        for name in ("kp", "ki", "kd"):
            require(
                all(value >= 0 for value in getattr(self, name)),
                f"controller.{name} = {list(getattr(self, name))}; expected gains >= 0",
            )


@dataclass(frozen=True)
class Controller:
    """PID gains (n,) [N m/rad, N m/(rad s), N m s/rad], bound of the integral's torque (n,) [N m], period [s].

    ``robot`` is the nominal robot whose gravity torque is compensated.
    """

    robot: Robot
    period: float
    kp: Array
    ki: Array
    kd: Array
    integral_limit: Array


def make_controller(
    robot: Robot, settings: ControllerSettings, period: float, plants: tuple[Robot, ...] = ()
) -> Controller:
    """Choose gains for ``robot`` sampled every ``period`` [s], stable for it and for every robot in ``plants``.

    Raises :class:`ConfigError` naming the joint where given gains make Kd T / I_eff exceed the limit.
    """
    n = robot.n_joints
    ranges = [inertia_range(plant) for plant in (robot, *plants)]
    smallest = np.min([low for low, _ in ranges], axis=0)
    largest = np.max([high for _, high in ranges], axis=0)
    effort = np.where(np.isfinite(robot.effort_limits) & (robot.effort_limits > 0), robot.effort_limits, 1e3)

    def given(name: str, automatic: Array) -> Array:
        values = getattr(settings, name)
        require(
            len(values) in (0, n), f"controller.{name} holds {len(values)} gains; robot {robot.name} has {n} joints"
        )
        return np.asarray(values, float) if values else automatic

    kd = given("kd", settings.ratio * smallest / period)
    automatic = np.minimum(kd**2 / (4 * settings.damping_ratio**2 * largest), effort / settings.stiffest_error)
    kp = given("kp", automatic)
    ki = given("ki", settings.integral_rate * kp)
    ratio = kd * period / smallest
    worst = int(np.argmax(ratio))
    if ratio[worst] >= RATIO_LIMIT:
        raise ConfigError(
            f"controller.kd = {kd[worst]:.4g} N m s/rad of joint {robot.joint_names[worst]} with a control period of "
            f"{period:g} s is unstable: Kd T / I_eff = {ratio[worst]:.3g}, expected < {RATIO_LIMIT} "
            f"(I_eff = {smallest[worst]:.4g} kg m^2); lower the gain or the period"
        )
    return Controller(robot, period, kp, ki, kd, settings.integral_share * effort)


def effective_inertia(robot: Robot, q: Array) -> Array:
    """I_eff = 1/(M^-1)_jj (T, n) [kg m^2] at configurations (T, n) [rad], armature included."""
    configuration = robot._configuration(np.asarray(q, float))
    data = robot.model.createData()
    index = robot._v
    out = np.empty((len(q), robot.n_joints))
    for k in range(len(q)):
        out[k] = pin.computeMinverse(robot.model, data, configuration[:, k]).diagonal()[index]
    return 1.0 / out


def inertia_range(robot: Robot, samples: int = 1500, rounds: int = 40) -> tuple[Array, Array]:
    """Smallest I_eff and largest M_jj (n,) [kg m^2] found inside the joint limits.

    Random configurations, then a shrinking random search from each joint's best (the minimum, near a straight elbow
    for example, is narrow). Deterministic.
    """
    rng = np.random.default_rng(20130613)
    low, high = robot.position_limits
    low, high = np.maximum(low, -np.pi), np.minimum(high, np.pi)
    q = rng.uniform(low, high, (samples, robot.n_joints))
    inertia = effective_inertia(robot, q)
    smallest = inertia.min(axis=0)
    for j in range(robot.n_joints):
        best, width = q[np.argmin(inertia[:, j])], 0.3
        for _ in range(rounds):
            trial = np.clip(best + rng.normal(0, width, (12, robot.n_joints)) * (high - low), low, high)
            value = effective_inertia(robot, trial)[:, j]
            k = int(np.argmin(value))
            if value[k] < smallest[j]:
                smallest[j], best = value[k], trial[k]
            else:
                width *= 0.8
    zero, eye = np.zeros_like(q), np.eye(robot.n_joints)
    gravity = robot.inverse_dynamics(q, zero, zero)
    diagonal = [robot.inverse_dynamics(q, zero, zero + eye[j])[:, j] - gravity[:, j] for j in range(robot.n_joints)]
    return smallest, np.max(diagonal, axis=1)
