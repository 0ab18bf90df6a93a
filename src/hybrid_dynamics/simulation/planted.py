"""Effects of the catalogue entering a forward simulation: from the same law as everywhere else, integrated as it needs.

Dry friction whose sign turns over at once is solved as true sticking (:mod:`.friction`); friction with a memory carries
its state; viscous friction is taken at the middle of the sub-step; what turns over within a speed is linearised at
standstill so that it stays stable; the rest is explicit. What is part of the rigid body changes the robot, what only
changes the readings goes to the sensors (:func:`sensors_for`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid_dynamics.effects import Effect, Family, State, family, readings, with_effects
from hybrid_dynamics.effects.sign import SIGN_DISPLACEMENT, WIDTH
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.effects import JointEffects
from hybrid_dynamics.simulation.sensors import SensorSettings
from hybrid_dynamics.types import Array

_TINY = 1e-9
#: Width [rad/s] over which a sign of another joint's speed, or of a sum, turns over: no stick is solved for it.
_PARTNER_WIDTH = 0.01


@dataclass(frozen=True)
class _Row:
    """One row in which the law of ``effect`` stands."""

    kind: Family
    effect: Effect
    joint: int
    partner: int | None
    settings: dict[str, Any]

    def __call__(self, q: Array, dq: Array, load: Array | None = None, time: float = 0.0, z: Any = None) -> Array:
        """Torque (R,) [N m] at states (R, n)."""
        own = None if load is None else load.T
        at = State(q.T, dq.T, None, own, self.joint, self.partner, np.full(len(q), time), z)
        return np.broadcast_to(self.kind.law(np, at, self.effect.parameters, self.settings), (len(q),))

    def at_speed(self, q: Array, dq: Array, load: Array, time: float, way: float) -> Array:
        """The same as if the joint moved in direction ``way``, at its present speed."""
        moved = dq.copy()
        moved[:, self.joint] = way * np.maximum(np.abs(dq[:, self.joint]), _TINY)
        return self(q, moved, load, time)

    def alone(self, values: Array, n: int) -> Array:
        """(R, n) with ``values`` (R,) on the row's joint."""
        out = np.zeros((len(values), n))
        out[:, self.joint] = values
        return out


@dataclass(frozen=True)
class _Presliding:
    """Memory of friction that follows the way since the last reversal; z (R, n) in the joint's column."""

    row: _Row
    displacement: float
    n: int

    def torque(self, z: Array, q: Array, dq: Array, time: float) -> Array:
        return self.row.alone(self.row(q, dq, None, time, z[:, self.row.joint]), self.n)

    def advance(self, z: Array, q: Array, dq: Array, h: float) -> Array:
        # Exact for a velocity that is constant over the sub-step.
        level = self.row.kind.memory_level(np, dq, self.row.effect.parameters, self.row.settings)
        goal = level * np.sign(dq)
        return np.asarray(goal + (z - goal) * np.exp(-np.abs(dq) * h / (self.displacement * level)))


def planted(robot: Robot, effects: Iterable[Effect]) -> tuple[Robot, JointEffects]:
    """The changed robot and what acts on its joints in :func:`simulate`.

    Raises :class:`InputError` for laws that follow accelerations: the integrator would need their inverse.
    """
    own = list(effects)
    changed, _ = with_effects(robot, own)
    total = JointEffects()
    for effect in own:
        kind = family(effect.effect)
        if not kind.has_law:
            continue
        for joint, partner in kind.rows(robot, effect.term(robot)):
            row = _Row(kind, effect, joint, partner, dict(effect.settings))
            total = total + _acting(row, robot.n_joints)
    return changed, total


def _acting(row: _Row, n: int) -> JointEffects:
    """One row of one effect, integrated as it needs."""
    kind, parameters, settings = row.kind, row.effect.parameters, row.settings
    _refuse_accelerations(row, n)
    displacement = kind.presliding(parameters, settings)
    if displacement is not None:
        if kind.uses_load:
            raise InputError(
                f"effect {kind.name} with {SIGN_DISPLACEMENT} follows the load as well; simulate it with a sharp sign"
            )
        return JointEffects(memory=(_Presliding(row, displacement, n),))
    if row.partner is not None:
        smooth = replace(row, settings={WIDTH: _PARTNER_WIDTH, **settings})
        return JointEffects(torque=(lambda q, dq, time: smooth.alone(smooth(q, dq, None, time), n),))
    if _jumps(row, n):
        return JointEffects(dry=(_dry(row, n),))
    if kind.uses_load:
        raise InputError(f"effect {kind.name} with {WIDTH}: simulate it with a sharp sign")
    return _explicit(row, n)


def _jumps(row: _Row, n: int) -> bool:
    """True where the torque jumps at standstill, sooner or later in the run."""
    q, load = np.zeros((1, n)), np.ones((1, n))
    ways = [[row.at_speed(q, q, load, time, way) for way in (-1.0, 1.0)] for time in (0.0, 1.0, 1e4)]
    return bool(max(np.abs(forth - back).max() for back, forth in ways) > 1e-6)


def _dry(row: _Row, n: int) -> Any:
    """Bounds of sticking friction, each way."""

    def law(q: Array, dq: Array, load: Array, time: float) -> tuple[Array, Array]:
        back, forth = (row.at_speed(q, dq, load, time, way) for way in (-1.0, 1.0))
        return row.alone(-back, n), row.alone(forth, n)

    return law


def _explicit(row: _Row, n: int) -> JointEffects:
    """What is continuous in the state: its slope at standstill as damping, the rest as the sub-step finds it."""
    still, creeping = np.zeros((1, n)), np.full((1, n), 1e-6)
    slope = float((row(still, creeping) - row(still, still))[0] / 1e-6)
    damping = np.zeros(n)
    damping[row.joint] = max(slope, 0.0)

    def rest(q: Array, dq: Array, time: float) -> Array:
        return row.alone(row(q, dq, None, time), n) - damping * dq

    return JointEffects(damping=damping, torque=(rest,))


def _refuse_accelerations(row: _Row, n: int) -> None:
    state = np.zeros((1, n))
    try:
        row(state, state, state)
    except InputError as error:
        raise InputError(f"effect {row.kind.name} cannot be simulated forward: {error}") from None


def sensors_for(settings: SensorSettings, robot: Robot, effects: Sequence[Effect]) -> SensorSettings:
    """``settings`` with the gains, position offsets, delay and lag of ``effects``."""
    read = readings(robot, effects)
    return replace(
        settings,
        torque_gain=tuple(read.gain.tolist()),
        position_offset=tuple(read.offset.tolist()),
        delay=settings.delay + read.delay,
        lag=settings.lag + read.lag,
    )
