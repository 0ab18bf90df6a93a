"""How much inertia a log's torque has: before noise in accelerations is weighed by the mass matrix of a URDF, whose
links can be of any inertia and which seldom has rotors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.differentiate.butterworth import lowpass
from hybrid_dynamics.loop.process import ProcessSettings, derivative
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: Share of the asked bandwidth in which inertia is heard: beyond it accelerations may be noise.
_BAND = 0.25
#: Share of the inertial torque that a joint's torque must vary by: less, and its sensor is dead or in another unit.
_ALIVE = 0.05
#: Samples that are looked at in a period of that band.
_SAMPLES = 8
#: Least and most share of the links' inertia; of a column's size beside all others below which nothing is known of it.
_LEAST, _MOST, _OPEN = 0.01, 4.0, 1e-4


@dataclass(frozen=True)
class Heard:
    """``links`` (n,): share of the links' inertial torque that the torque has; ``rotors`` (n,) [kg m^2]: what follows
    the joint's own acceleration beyond; ``alive`` (n,): joints whose torque can have the motion at all."""

    links: Array
    rotors: Array
    alive: NDArray[np.bool_]

    def inertial(self, torque: Array, ddq: Array) -> Array:
        """Inertial torque (N, n) [N m] as heard, of what the links alone ask for and accelerations (N, n)."""
        return np.asarray(self.links * torque + self.rotors * ddq)


def as_heard(robot: Robot, runs: Sequence[Trajectory], settings: ProcessSettings) -> Heard:
    """The inertia in the torque of ``runs`` (``q tau``, perhaps ``dq``), beside weight, springs and friction of any
    size: a weight that is not as described is no inertia."""
    parts = [_columns(robot, run, _BAND * settings.cutoff_at(run.dt)) for run in runs]
    moments = sum(np.einsum("jta,jtb->jab", columns, columns) for columns in parts)
    links, rotors, alive = np.ones(robot.n_joints), np.zeros(robot.n_joints), np.zeros(robot.n_joints, bool)
    for j, own in enumerate(np.asarray(moments)):
        size = np.maximum(np.sqrt(np.diag(own)), 1e-100)
        alive[j] = size[-1] > _ALIVE * size[0]
        scaled = own / np.outer(size, size)
        x = np.linalg.pinv(scaled[:-1, :-1], rcond=_OPEN, hermitian=True) @ scaled[:-1, -1] * size[-1] / size[:-1]
        links[j], rotors[j] = min(max(float(x[0]), _LEAST), _MOST), max(float(x[1]), 0.0)
    return Heard(links, rotors, alive)


def _columns(robot: Robot, run: Trajectory, cutoff: float) -> Array:
    """(n, T, p) per joint what its torque may consist of, its links' inertial torque first and its own acceleration
    next, and that torque, below ``cutoff`` [Hz] and without their means."""
    q, tau = (lowpass(run[name], run.dt, cutoff) for name in ("q", "tau"))
    dq = lowpass(run["dq"], run.dt, cutoff) if "dq" in run else derivative(q, run.dt)
    ddq = derivative(dq, run.dt)
    thin = slice(None, None, max(round(1.0 / (_SAMPLES * cutoff * run.dt)), 1))
    q, dq, ddq, tau = q[thin], dq[thin], ddq[thin], tau[thin]
    rest = robot.inverse_dynamics(q, dq, np.zeros_like(ddq))
    inertial = robot.inverse_dynamics(q, dq, ddq) - rest
    columns = np.stack([inertial, ddq, rest, q, np.sin(q), np.cos(q), dq, np.sign(dq), tau])
    return np.asarray(np.moveaxis(columns - columns.mean(axis=1, keepdims=True), 2, 0).swapaxes(1, 2))
