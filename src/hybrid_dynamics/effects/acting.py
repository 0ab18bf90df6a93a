"""Effects entering dynamics and readings: the inverse of finding them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import lfilter

from hybrid_dynamics.effects.base import Effect, StateTorque, family
from hybrid_dynamics.effects.state import State
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: Setting of a late torque: as it was before (delay), or behind a low-pass (lag).
RESPONSE, DELAY, LAG = "response", "delay", "lag"


@dataclass(frozen=True)
class Readings:
    """What a log holds of the truth: q_true = q_read + ``offset`` (n,) [rad]; recorded torque = ``gain`` (n,) times the
    true one, recorded ``delay`` [s] late behind a first-order low-pass of time constant ``lag`` [s]."""

    offset: Array
    gain: Array
    delay: float = 0.0
    lag: float = 0.0

    @property
    def plain(self) -> bool:
        """True where the log holds the truth."""
        return bool(np.all(self.offset == 0) and np.all(self.gain == 1) and self.delay == self.lag == 0)


def readings(robot: Robot, effects: Iterable[Effect]) -> Readings:
    """All effects on what is read, composed: offsets, delays and lags add up, gains multiply."""
    offset, gain, times = np.zeros(robot.n_joints), np.ones(robot.n_joints), {DELAY: 0.0, LAG: 0.0}
    for effect in effects:
        if not family(effect.effect).changes_reading:
            continue
        joint = effect.joint_index(robot)
        where = slice(None) if joint is None else joint
        offset[where] += effect.parameters.get("offset", 0.0)
        gain[where] *= effect.parameters.get("gain", 1.0)
        times[effect.settings.get(RESPONSE, DELAY)] += effect.parameters.get("delay", 0.0)
    return Readings(offset, gain, times[DELAY], times[LAG])


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
                    time,
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
    changed: Robot,
    torque: StateTorque,
    read: Readings,
    q: Array,
    dq: Array,
    ddq: Array,
    time: Array | None = None,
    began: float | None = None,
) -> Array:
    """:func:`predict` for effects that are planted already."""
    return recorded(acting_torques(changed, torque, read, q, dq, ddq, time, began=began)[1], time, read)


def acting_torques(
    changed: Robot,
    torque: StateTorque,
    read: Readings,
    q: Array,
    dq: Array,
    ddq: Array,
    time: Array | None = None,
    rigid: Array | None = None,
    began: float | None = None,
) -> tuple[Array, Array]:
    """Torques (T, n) [N m] at work where ``q`` is read: of the rigid body, and of it and the effects together.

    ``rigid``: the first, where it is known; ``began``: the time stamp [s] of the run's beginning, where that is not the
    first of ``time``.
    """
    q, dq, ddq = (np.asarray(a, float) for a in (q, dq, ddq))
    q = q + read.offset
    if rigid is None:
        rigid = changed.inverse_dynamics(q, dq, ddq)
    since = None if time is None else np.asarray(time) - (time[0] if began is None else began)
    return rigid, rigid + torque(q, dq, rigid, ddq, since)


def recorded(acting: Array, time: Array | None, read: Readings) -> Array:
    """What a log holds of the torque ``acting`` (T, n) [N m]; ``time`` (T,) [s]."""
    return late(acting * read.gain, time, read)


def late(signal: Array, time: Array | None, read: Readings) -> Array:
    """``signal`` (T, ...) as late as ``read`` says it is recorded; ``time`` (T,) [s]."""
    return delayed(lagged(signal, time, read.lag), time, read.delay)


def delayed(signal: Array, time: Array | None, delay: float) -> Array:
    """``signal`` (T, ...) as it was ``delay`` [s] before: cubic spline, held at the ends of the run."""
    if delay == 0:
        return signal
    time = _stamps(time)
    at = np.clip(time - delay, time[0], time[-1])
    return np.asarray(make_interp_spline(time, signal, k=3, axis=0)(at))


def lagged(signal: Array, time: Array | None, lag: float) -> Array:
    """``signal`` (T, ...) behind a low-pass lag dy/dt + y = signal, exact where the signal is linear between samples.

    Stamps that are not even are resampled first. At the beginning y follows as if the signal had risen before as it
    does then.
    """
    if lag == 0:
        return signal
    time = _stamps(time)
    steps = np.diff(time)
    step = float(np.median(steps))
    if np.any(np.abs(steps - step) > 1e-3 * step):
        even = np.linspace(time[0], time[-1], max(int(np.ceil((time[-1] - time[0]) / step)), 1) + 1)
        inside = lagged(np.asarray(make_interp_spline(time, signal, k=1, axis=0)(even)), even, lag)
        return np.asarray(make_interp_spline(even, inside, k=1, axis=0)(time))
    keep = float(np.exp(-step / lag))
    share = (1.0 - keep) * lag / step
    new, old = 1.0 - share, share - keep
    first = signal[:1] - lag / step * (signal[1:2] - signal[:1])
    # The filter's state is what the sample before leaves to the first one.
    return np.asarray(lfilter([new, old], [1.0, -keep], signal, axis=0, zi=first - new * signal[:1])[0])


def _stamps(time: Array | None) -> Array:
    if time is None:
        raise InputError("effect time_delay shifts the torque in time, and no time stamps are given; give time")
    return time
