"""Time stamps that are worse than the samples they belong to.

A logger that polls a controller writes down when it asked, not when the sample was taken: stamps jitter by a
controller's period, samples are repeated and skipped. Where position and velocity were sampled together they know
better: q[k+1] - q[k] = (dq[k] + dq[k+1]) / 2 * (number of ticks) * tick, and the number is whole.

A logger that waits for messages writes down when they came: the samples were taken evenly. The positions tell, since an
arm has no jitter: of the clocks that are possible the true one makes them smooth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.types import Array, Notify

#: Joint speed [rad/s, root of the sum of squares] below which a step says nothing of its duration.
SLOW = 0.03
#: A step counts as a whole number of ticks within this share of one.
WHOLE = 0.2
#: Least share of the steps in motion that must come out whole.
FEWEST_WHOLE = 0.9
#: Share of the mean square of accelerations, by differences of positions, that another clock may leave to be the true
#: one: then at least half of it was made by the stamps.
SMOOTHER = 0.5
#: Relative difference up to which two clocks are as smooth; steps by which a clock may go astray from the recorded
#: stamps, and one that is smooth over what was lost.
AS_SMOOTH, ASTRAY, ASTRAY_SMOOTHED = 0.1, 2.0, 1.0
#: Samples for which a clock is even that wanders.
FOR_A_WHILE = 25
#: Nowhere, in as many samples, may a clock be so many times as rough as the recorded stamps, the least that counts
#: being this share of the roughness of the whole: a sample that was lost, or a rate that changes, it would pass over.
WORST, SHARE_OF_WHOLE = 1.5, 0.5
#: Range of a joint [rad, m] beyond which it moves.
MOVES = 0.01


def even_stamps(time: Array) -> Array:
    """Stamps (T,) [s] of an even clock from the first to the last one."""
    return np.linspace(time[0], time[-1], len(time))


def ticked_stamps(time: Array) -> Array:
    """Stamps (T,) [s] of an even clock of which some samples were lost: every step takes a whole number of ticks."""
    steps = np.diff(time)
    ticks = np.concatenate([[0.0], np.cumsum(np.maximum(np.round(steps / np.median(steps)), 1.0))])
    return np.asarray(time[0] + (time[-1] - time[0]) * ticks / ticks[-1])


def smoothed_stamps(time: Array) -> Array:
    """Stamps (T,) [s] of a clock that is even for a while: ``time`` (T,) behind a moving straight line."""
    return np.asarray(savgol_filter(time, FOR_A_WHILE, 1))


def truer_stamps(time: Array, q: Array) -> Array:
    """Stamps (T,) [s] at which the positions ``q`` (T, n) [rad] were taken: the recorded ones ``time`` (T,), or those
    of an even clock, with samples lost or not, or of one that is even for a while, where these are by far smoother
    (:data:`SMOOTHER`, over all joints). Of those that are as smooth the plainest, as long as it stays by the recorded.
    """
    moving = np.ptp(q, axis=0) > MOVES
    if len(time) < FOR_A_WHILE or not moving.any():
        return time
    recorded, step = _roughness(time, q[:, moving]), float(np.median(np.diff(time)))
    clocks = []
    asked = (even_stamps(time), ASTRAY), (ticked_stamps(time), ASTRAY), (smoothed_stamps(time), ASTRAY_SMOOTHED)
    for stamps, astray in asked:
        off = stamps - time
        if np.any(np.diff(stamps) <= 0) or np.abs(off - np.median(off)).max() > astray * step:
            continue
        rough = _roughness(stamps, q[:, moving])
        if np.any(_by_parts(rough / recorded.mean(axis=0)) > WORST * _by_parts(recorded / recorded.mean(axis=0))):
            continue
        # Joints count alike, however fast they are.
        clocks.append((float(np.mean(np.log(rough.mean(axis=0) / recorded.mean(axis=0)))), stamps))
    best = min((gain for gain, _ in clocks), default=0.0)
    if best >= np.log(SMOOTHER):
        return time
    return next(stamps for gain, stamps in clocks if gain <= best + AS_SMOOTH)


def _by_parts(rough: Array) -> Array:
    """Means over joints and stretches of :data:`FOR_A_WHILE` samples, and no less than a share of the whole of them."""
    parts = np.add.reduceat(rough.mean(axis=1), np.arange(0, len(rough), FOR_A_WHILE)) / FOR_A_WHILE
    return np.asarray(np.maximum(parts, SHARE_OF_WHOLE))


def _roughness(time: Array, q: Array) -> Array:
    """(T - 2, n) squares [(rad/s^2)^2] of the second divided differences of ``q`` (T, n) at ``time`` (T,)."""
    speed = np.diff(q, axis=0) / np.diff(time)[:, None]
    span = 0.5 * (time[2:] - time[:-2])
    return np.asarray(np.maximum((np.diff(speed, axis=0) / span[:, None]) ** 2, 1e-300))


def stamps_from_velocity(
    name: str, time: Array, q: Array, dq: Array, tick: float, velocity_delay: float, notify: Notify
) -> tuple[Array, NDArray[np.intp]]:
    """True stamps [s] and the rows (of T) that hold a new sample; a repeated sample takes no time and is left out.

    ``time`` (T,) recorded stamps [s], ``q`` (T, n) [rad], ``dq`` (T, n) [rad/s], late by ``velocity_delay`` [s]. At
    rest the recorded stamps decide. Raises :class:`InputError` where the steps are no whole ticks.
    """
    shift = round(velocity_delay / tick)
    row = np.arange(len(q))
    ahead = dq[np.clip(row + shift, 0, len(q) - 1)]
    speed = (ahead[1:] + ahead[:-1]) / 2
    power = (speed**2).sum(axis=1)
    moving = power > SLOW**2
    if moving.sum() < 10:
        raise InputError(f"{name}: nothing moves; clock: velocity needs motion to tell the time from")
    steps = np.diff(time) / tick
    steps[moving] = ((np.diff(q, axis=0) * speed).sum(axis=1)[moving] / power[moving]) / tick
    whole = float((np.abs(steps[moving] - np.round(steps[moving])) < WHOLE).mean())
    if whole < FEWEST_WHOLE:
        raise InputError(
            f"{name}: only {whole:.0%} of the steps are whole ticks of {1e3 * tick:g} ms by position and velocity; "
            "give the controller's period as tick, or use clock: recorded"
        )
    ticks = np.maximum(np.round(steps), 0.0)
    stamps = time[0] + np.concatenate([[0.0], np.cumsum(ticks)]) * tick
    new = np.concatenate([[0], 1 + np.flatnonzero(ticks > 0)])
    notify(
        f"{name}: time told from position and velocity: {whole:.1%} of the steps in motion are whole ticks of "
        f"{1e3 * tick:g} ms, {len(time) - len(new)} samples are repeated, {int((ticks > 1).sum())} steps skip some; "
        f"stamps moved by up to {1e3 * float(np.abs(stamps - time).max()):.2g} ms"
    )
    return stamps[new], new
