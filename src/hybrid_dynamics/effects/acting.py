"""Effects entering dynamics and readings: the inverse of finding them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from hybrid_dynamics.effects.base import Effect, StateTorque, family
from hybrid_dynamics.effects.state import State
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array


@dataclass(frozen=True)
class Readings:
    """What a log holds of the truth: q_true = q_read + ``offset`` (n,) [rad]; recorded torque = ``gain`` (n,) times the
    true one, recorded ``delay`` [s] late."""

    offset: Array
    gain: Array
    delay: float

    @property
    def plain(self) -> bool:
        """True where the log holds the truth."""
        return bool(np.all(self.offset == 0) and np.all(self.gain == 1) and self.delay == 0)


def readings(robot: Robot, effects: Iterable[Effect]) -> Readings:
    """All effects on what is read, composed: offsets and delays add up, gains multiply."""
    offset, gain, delay = np.zeros(robot.n_joints), np.ones(robot.n_joints), 0.0
    for effect in effects:
        if not family(effect.effect).changes_reading:
            continue
        joint = effect.joint_index(robot)
        where = slice(None) if joint is None else joint
        offset[where] += effect.parameters.get("offset", 0.0)
        gain[where] *= effect.parameters.get("gain", 1.0)
        delay += effect.parameters.get("delay", 0.0)
    return Readings(offset, gain, delay)


def with_effects(robot: Robot, effects: Iterable[Effect], along: bool = False) -> tuple[Robot, StateTorque]:
    """The robot with ``effects``: a changed copy, and the torque its drives must add.

    The second is ``torque(q, dq, load=None, ddq=None, time=None)`` of joint states (T, n), giving (T, n) [N m]: under
    drive torque tau the changed robot accelerates as if it were given ``tau - torque(...)``. ``load`` (T, n) is the
    rigid-body torque of the changed robot, ``time`` (T,) [s] since the run began; both, and ``ddq``, are asked for by
    effects that depend on them (:class:`InputError`). With ``along`` the rows must be one run in the order of time
    (friction may depend on the past); without, they are states in any order. Effects that only change what is read
    (gain, position offset, delay) are not in it, see :func:`predict`.
    """
    changed = robot.copy()
    laws = []
    for effect in effects:
        kind = family(effect.effect)
        kind.change(changed, effect)
        if kind.has_law:
            laws.append((kind, effect, kind.rows(robot, effect.term(robot))))

    def torque(
        q: Array, dq: Array, load: Array | None = None, ddq: Array | None = None, time: Array | None = None
    ) -> Array:
        out = np.zeros_like(dq)
        for kind, effect, rows in laws:
            for joint, partner in rows:
                at = State(
                    q.T,
                    dq.T,
                    None if ddq is None else ddq.T,
                    None if load is None else load.T,
                    joint,
                    partner,
                    None if time is None else time - time[0],
                )
                if along:
                    out[:, joint] += kind.along(at, effect.parameters, effect.settings)
                else:
                    out[:, joint] += kind.law(np, at, effect.parameters, effect.settings)
        return out

    return changed, torque


def predict(
    robot: Robot, effects: Sequence[Effect], q: Array, dq: Array, ddq: Array, time: Array | None = None
) -> Array:
    """Recorded torque (T, n) [N m] that ``robot`` with ``effects`` needs for the recorded motion of one whole run.

    ``time`` (T,) [s] is needed by a delay and by effects that change over the run (:class:`InputError`).
    """
    changed, torque = with_effects(robot, effects, along=True)
    return predict_acting(changed, torque, readings(robot, effects), q, dq, ddq, time)


def predict_acting(
    changed: Robot, torque: StateTorque, read: Readings, q: Array, dq: Array, ddq: Array, time: Array | None = None
) -> Array:
    """:func:`predict` for effects that are planted already."""
    q, dq, ddq = (np.asarray(a, float) for a in (q, dq, ddq))
    q = q + read.offset
    rigid = changed.inverse_dynamics(q, dq, ddq)
    own = (rigid + torque(q, dq, rigid, ddq, time)) * read.gain
    return delayed(own, time, read.delay)


def delayed(signal: Array, time: Array | None, delay: float) -> Array:
    """``signal`` (T, ...) as it was ``delay`` [s] before: cubic spline, held at the ends of the run."""
    if delay == 0:
        return signal
    if time is None:
        raise InputError("effect time_delay shifts the torque in time, and no time stamps are given; give time")
    at = np.clip(time - delay, time[0], time[-1])
    return np.asarray(make_interp_spline(time, signal, k=3, axis=0)(at))
