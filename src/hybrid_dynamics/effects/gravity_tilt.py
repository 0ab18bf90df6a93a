"""The base is not level: R_base = Ry(pitch) Rx(roll), so gravity in the base frame is R_base^T (0, 0, -g).

Any angle: roll in (-pi, pi], pitch in [-pi/2, pi/2] reach every direction. Torque is linear in the gravity vector, so
the coordinates are its change (3,) [m/s^2] in the base frame, exact for a base on the wall or the ceiling too; that its
length stays g is :meth:`GravityTilt.settle`. The published angles are those of the base against the level, whatever the
model held before: two tilts, one found after the other, are one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hybrid_dynamics.effects.base import Effect, Family, Term, register
from hybrid_dynamics.effects.state import Equivalence, Motion, Parameter
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: A wall and a ceiling are upright to this angle [rad].
UPRIGHT = np.deg2rad(0.5)
#: Change of gravity [m/s^2] in the frame of a base that may stand anyhow.
ANYWHERE = 5.0


def base_rotation(roll: float, pitch: float) -> Array:
    """Ry(pitch) Rx(roll)."""
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    about_y: Array = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_x: Array = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return np.asarray(about_y @ about_x)


def base_angles(gravity: Array) -> tuple[float, float]:
    """Roll and pitch of the base in which gravity (3,) points along ``gravity``; inverse of :func:`tilted_gravity`."""
    size = max(float(np.linalg.norm(gravity)), 1e-300)
    x, y, z = np.asarray(gravity) / size
    # On a wall along x roll turns nothing; adding zero takes the sign from a zero, which would be half a turn less.
    roll = 0.0 if np.hypot(y, z) < 1e-9 else float(np.arctan2(0.0 - y, 0.0 - z))
    return roll, float(np.arcsin(np.clip(x, -1.0, 1.0)))


def tilted_gravity(roll: float, pitch: float, size: float) -> Array:
    """Gravity (3,) [m/s^2] of ``size`` in the frame of a tilted base."""
    return np.asarray(base_rotation(roll, pitch).T @ np.array([0.0, 0.0, -size]))


def is_along_an_axis(gravity: Array) -> bool:
    """Whether ``gravity`` (3,) points along an axis of the base, up to rounding."""
    return bool(np.max(np.abs(gravity)) > np.linalg.norm(gravity) * (1 - 1e-12))


def mounted(gravity: Array) -> Effect:
    """The effect by which gravity points along ``gravity`` (3,) in the frame of the base."""
    roll, pitch = base_angles(gravity)
    return Effect(GravityTilt.name, (), {"roll": roll, "pitch": pitch})


@register
class GravityTilt(Family):
    name = "gravity_tilt"
    scope = "robot"
    between_runs = ("the arm was mounted otherwise", ("roll", "pitch"))
    equation = (
        r"g_\text{base} = R_\text{base}^\top (0, 0, -g)^\top,\quad R_\text{base} = R_y(\text{pitch})\,R_x(\text{roll})"
    )
    parameters = (Parameter("roll", "rad"), Parameter("pitch", "rad"))
    size = 3
    changes_body = True
    uses_body = True
    on_surface = True
    drawn_against = "q"
    shown_by = "the first joint carries the stretched arm slowly all the way round"
    equivalent_to = (
        Equivalence(
            ("position_offset",),
            "about an axis that is parallel to a joint's a wrong zero turns the arm as a tilted base does",
            "turn the joints before it: the tilt's torque changes with them",
        ),
    )

    def columns(self, motion: Motion, term: Term) -> Array:
        still = np.zeros_like(motion.q)
        robot = motion.robot.copy()
        out = np.empty((*motion.q.shape, 3))
        for k in range(3):
            robot.model.gravity.linear = np.eye(3)[k]
            out[:, :, k] = robot.inverse_dynamics(motion.q, still, still)
        return out

    def prior_scale(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        own = np.zeros(3) if robot is None else np.asarray(robot.model.gravity.linear)
        size = float(np.linalg.norm(own))
        # A base that the search has put on a wall or under a ceiling; of one on the floor anything may be found.
        turned = size > 0 and is_along_an_axis(own) and own[2] >= -0.5 * size
        return np.full(3, UPRIGHT * size if turned else ANYWHERE)

    def open_scale(self, robot: Robot, term: Term) -> Array:
        return np.full(3, ANYWHERE)

    def surface(self, x: Array, robot: Robot, term: Term) -> tuple[Array, float]:
        # Gravity turns and keeps its size: a size of its own would be a gain that no angle can publish.
        own = np.asarray(robot.model.gravity.linear)
        normal = (own + x) / max(float(np.linalg.norm(own + x)), 1e-12)
        return normal, float(np.linalg.norm(own) - normal @ own)

    def parameters_of(self, x: Array, robot: Robot, term: Term) -> dict[str, float]:
        roll, pitch = base_angles(np.asarray(robot.model.gravity.linear) + x)
        return {"roll": roll, "pitch": pitch}

    def jacobian(self, x: Array, robot: Robot, term: Term) -> Array:
        # By hand: of a base on a wall along x the pitch is at its end and roll turns nothing. The pitch has its slope
        # there all the same; that of roll grows until a wall's own uncertainty leaves it open all the way round.
        gravity = np.asarray(robot.model.gravity.linear) + x
        roll, pitch = base_angles(gravity)
        cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
        about = max(cp, UPRIGHT / np.pi)
        rows = np.array([[0.0, -cr / about, sr / about], [cp, sp * sr, sp * cr]])
        return np.asarray(rows / max(float(np.linalg.norm(gravity)), 1e-300))

    def coordinates_of(self, parameters: Mapping[str, float], robot: Robot, term: Term) -> Array:
        own = np.asarray(robot.model.gravity.linear)
        return np.asarray(tilted_gravity(parameters["roll"], parameters["pitch"], float(np.linalg.norm(own))) - own)

    def change(self, robot: Robot, effect: Effect) -> None:
        size = float(np.linalg.norm(robot.model.gravity.linear))
        robot.model.gravity.linear = tilted_gravity(effect.parameters["roll"], effect.parameters["pitch"], size)

    def draw(self, robot: Robot, term: Term, rng: np.random.Generator) -> Array:
        angle = float(rng.uniform(0, 2 * np.pi))
        return np.array([np.cos(angle), np.sin(angle), 0.0])

    def parameter_error(
        self, true: Effect, found: Effect, robot: Robot, motions: Sequence[Motion] = ()
    ) -> dict[str, float]:
        """Angle between the two directions of gravity, relative to the angle between the true one and the model's."""
        own = np.asarray(robot.model.gravity.linear)
        term = true.term(robot)
        a, b = (own + self.coordinates_of(e.parameters, robot, term) for e in (true, found))
        return {"tilt": float(np.linalg.norm(a - b) / max(float(np.linalg.norm(a - own)), 1e-300))}
