"""Laws on top of the other engine: what MuJoCo lacks, and forms that the catalogue does not have.

Written here once more, from the literature, and not taken from ``effects/``: a blind study must not share its equations
with what it tests. All act on the motion of one run with rows in the order of time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from hybrid_dynamics.types import Array


@dataclass(frozen=True)
class Course:
    """One run: ``time`` (T,) [s], ``q dq ddq`` (T, n), ``load`` (T, n) [N m] the torque of the true rigid body."""

    time: Array
    q: Array
    dq: Array
    ddq: Array
    load: Array


#: ``law(course, joint, values) -> (T,)`` torque [N m] that the drive of ``joint`` must add.
Law = Callable[[Course, int, Mapping[str, float]], Array]


def offset(course: Course, joint: int, values: Mapping[str, float]) -> Array:
    """A constant torque."""
    return np.full(len(course.time), values["torque"])


def asymmetric(course: Course, joint: int, values: Mapping[str, float]) -> Array:
    """Coulomb friction that differs with the direction."""
    v = course.dq[:, joint]
    return np.where(v > 0, values["positive"], np.where(v < 0, -values["negative"], 0.0))


def stribeck(course: Course, joint: int, values: Mapping[str, float]) -> Array:
    """Bo and Pavelescu (1982): the catalogue has ``exponent`` 2 only."""
    v = course.dq[:, joint]
    bump = np.exp(-(np.abs(v / values["velocity"]) ** values.get("exponent", 2.0)))
    return np.sign(v) * (values["coulomb"] + (values["static"] - values["coulomb"]) * bump)


def load_friction(course: Course, joint: int, values: Mapping[str, float]) -> Array:
    """Friction in proportion to the joint's load."""
    return values["coefficient"] * np.abs(course.load[:, joint]) * np.sign(course.dq[:, joint])


def dahl(course: Course, joint: int, values: Mapping[str, float]) -> Array:
    """Dahl (1968): dF/dt = K (v - |v| F / Fc), exact for a velocity that is constant within a sample."""
    return _relaxed(course, joint, values["stiffness"], np.full(len(course.time), values["coulomb"]))[0]


def lugre(course: Course, joint: int, values: Mapping[str, float]) -> Array:
    """Canudas de Wit et al. (1995): F = s0 z + s1 dz/dt, dz/dt = v - s0 |v| z / g(v), with a Stribeck curve g."""
    v = course.dq[:, joint]
    bump = np.exp(-((v / values["velocity"]) ** 2))
    level = values["coulomb"] + (values["static"] - values["coulomb"]) * bump
    force, rate = _relaxed(course, joint, values["stiffness"], level)
    return force + values.get("micro_damping", 0.0) * rate


def tanh_coulomb(course: Course, joint: int, values: Mapping[str, float]) -> Array:
    """Coulomb friction that turns over within a speed."""
    return values["torque"] * np.tanh(course.dq[:, joint] / values["width"])


def gonthier(course: Course, joint: int, values: Mapping[str, float]) -> Array:
    """After Gonthier et al. (2004): dry friction that follows the speed with a lag (dwell time) and viscous damping."""
    dt = float(course.time[1] - course.time[0])
    wanted = np.tanh(course.dq[:, joint] / values["width"])
    share = 1.0 - np.exp(-dt / values["dwell"])
    out, state = np.empty_like(wanted), 0.0
    for k, w in enumerate(wanted):
        state += share * (w - state)
        out[k] = state
    return values["torque"] * out


def ripple(course: Course, joint: int, values: Mapping[str, float]) -> Array:
    """One harmonic, or with ``second`` another at twice the first."""
    angle = values["harmonic"] * course.q[:, joint] + values["phase"]
    return values["amplitude"] * (np.sin(angle) + values.get("second", 0.0) * np.sin(2 * angle + 1.0))


def cubic_spring(course: Course, joint: int, values: Mapping[str, float]) -> Array:
    """A spring that stiffens with the third power."""
    x = course.q[:, joint] - values["rest"]
    return values["stiffness"] * x + values["cubic"] * x**3


def two_joints(course: Course, joint: int, values: Mapping[str, float]) -> Array:
    """A law in the positions of two joints: neither column nor sum of columns of the catalogue."""
    return (
        values["torque"]
        * np.sin(course.q[:, joint] + course.q[:, int(values["partner"])])
        * np.cos(course.q[:, int(values["partner"])])
    )


def own_coupling(course: Course, joint: int, values: Mapping[str, float]) -> Array:
    """Friction of another joint's motion."""
    other = int(values["partner"])
    return values["viscous"] * course.dq[:, other] + values["coulomb"] * np.sign(course.dq[:, other])


def drift(course: Course, joint: int, values: Mapping[str, float]) -> Array:
    """Friction that grows over the run."""
    grown = 1.0 - np.exp(-(course.time - course.time[0]) / values["constant"])
    return np.asarray(values["torque"] * grown * np.sign(course.dq[:, joint]))


def contact(course: Course, joint: int, values: Mapping[str, float]) -> Array:
    """A push during part of the run."""
    time = course.time - course.time[0]
    return np.asarray(values["torque"] * ((time >= values["start"]) & (time <= values["end"])))


def _relaxed(course: Course, joint: int, stiffness: float, level: Array) -> tuple[Array, Array]:
    """Force K z and dz/dt with dz/dt = v - K |v| z / level, z = 0 before the run."""
    dt = float(course.time[1] - course.time[0])
    v = course.dq[:, joint]
    out, rate, z = np.empty_like(v), np.empty_like(v), 0.0
    for k in range(len(v)):
        middle = 0.5 * (v[k] + v[k - 1]) if k else 0.0
        goal = np.sign(middle) * level[k] / stiffness
        z = goal + (z - goal) * np.exp(-abs(middle) * dt * stiffness / level[k])
        out[k] = stiffness * z
        rate[k] = v[k] - stiffness * abs(v[k]) * z / level[k]
    return out, rate


#: Laws by name; what is in :data:`UNKNOWN` the catalogue does not have (or has in another form).
LAWS: dict[str, Law] = {
    "offset": offset,
    "asymmetric": asymmetric,
    "stribeck": stribeck,
    "load_friction": load_friction,
    "dahl": dahl,
    "lugre": lugre,
    "tanh_coulomb": tanh_coulomb,
    "gonthier": gonthier,
    "ripple": ripple,
    "cubic_spring": cubic_spring,
    "two_joints": two_joints,
    "own_coupling": own_coupling,
    "drift": drift,
    "contact": contact,
}
UNKNOWN = ("lugre", "gonthier", "cubic_spring", "two_joints", "tanh_coulomb")
#: Causes in what is read, not in what the robot does; ``lag`` is a drive's first-order low-pass of the torque.
READINGS = ("gain", "position_offset", "delay", "lag")
