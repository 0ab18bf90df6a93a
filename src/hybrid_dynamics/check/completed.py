"""What is taken for known before a log is looked at: a robot as described, or a model with effects and readings.

What the log reads wrongly (position offsets, gains, a late torque) is undone at once; what acts beside the rigid body
is a column of its own, so that neither a spring nor friction that the model knows looks like a fault of the log.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from hybrid_dynamics.check.samples import Stretch, stretches
from hybrid_dynamics.effects.acting import Readings, delayed
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array


class Completed(Protocol):
    """A model: a rigid body that may differ from the URDF's, effects beside it, and what the log reads wrongly."""

    @property
    def completed_robot(self) -> Robot:
        """The robot with the effects of the body in it."""

    @property
    def readings(self) -> Readings:
        """What the log reads wrongly."""

    def acting_torques(self, q: Array, dq: Array, ddq: Array, time: Array) -> tuple[Array, Array]:
        """Torques (T, n) [N m] at work where ``q`` is read: of the rigid body, and of it and the effects together."""


def body_of(model: Robot | Completed) -> Robot:
    """The rigid body."""
    return model if isinstance(model, Robot) else model.completed_robot


def true_stretches(model: Robot | Completed, runs: Sequence[Trajectory]) -> list[Stretch]:
    """:func:`stretches` of ``runs`` (``q tau`` on uniform grids), what ``model`` says is read wrongly undone."""
    if isinstance(model, Robot) or model.readings.plain:
        return stretches(runs)
    return stretches([_true(model.readings, run) for run in runs])


def _true(read: Readings, run: Trajectory) -> Trajectory:
    tau = run["tau"]
    if read.lag:
        tau = tau + read.lag * np.gradient(tau, run.dt, axis=0)
    tau = delayed(tau, run.time, -read.delay)
    return replace(run, signals={**run.signals, "q": run["q"] + read.offset, "tau": tau / read.gain})


def beside_body(model: Robot | Completed, parts: Sequence[Stretch], q: Array, dq: Array, ddq: Array) -> Array:
    """Torque (K, n) [N m] of the effects that are no part of the rigid body, at true states ``q dq ddq`` (K, n) of all
    ``parts``, one after the other; zero of a robot as described."""
    if isinstance(model, Robot):
        return np.zeros_like(q)
    out = np.empty_like(q)
    begun = 0
    for part in parts:
        rows = slice(begun, begun + len(part.q))
        rigid, acting = model.acting_torques(q[rows] - model.readings.offset, dq[rows], ddq[rows], part.time)
        out[rows] = acting - rigid
        begun = rows.stop
    return out
