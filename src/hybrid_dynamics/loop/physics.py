"""What physics demands of coordinates: bounds, bodies that can exist, friction that opposes the motion, in the end too.

Friction takes energy (the second law). Of one effect its bounds see to that; a viscous curve may bend down only as far
as the joint's other viscous terms carry it, beyond the speeds of the logs as far as all its friction does, and friction
that becomes less as the joint warms up ends above zero: what grows without end over the time of a short log would drive
the joint in a longer one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.base import ONLY_RUN
from hybrid_dynamics.effects.inertia import in_ball
from hybrid_dynamics.effects.sign import with_sign
from hybrid_dynamics.effects.state import State
from hybrid_dynamics.loop.solve import Constraints
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: Shares of a joint's fastest speed at which its viscous terms, or all its friction once warm, must oppose the motion;
#: and viscous terms near rest. (A curve that was left alone had a square of less than nothing, and drove there.)
_SPEEDS, _NEAR_REST = np.linspace(0.1, 1.0, 10), 1e-3
#: Beyond that speed all friction of a joint with a curve must oppose the motion up to the speed the URDF allows, at
#: these shares; at most :data:`FAR` times the fastest of the logs, since a curve through these is no curve of all
#: speeds. A limit from :data:`BELIEVABLE` [rad/s, m/s] on is a place-holder: :data:`BEYOND` times the fastest then.
FAR, BEYOND, BELIEVABLE, _BETWEEN = 4.0, 2.0, 10.0, np.linspace(0.25, 1.0, 4)


def physical_constraints(
    terms: Sequence[Term],
    starts: Sequence[int],
    total: int,
    base: Mapping[Term, Array],
    robot: Robot,
    fastest: Array,
    reach_of_links: Array | None = None,
) -> Constraints:
    """Constraints on the ``total`` coordinates of ``terms``, those of each beginning at ``starts``.

    ``base`` holds the coordinates of effects that the starting model has already: they may become less, the sum must
    stay physical. ``fastest`` (n,) [rad/s] is the highest speed seen of each joint; ``reach_of_links`` (n,) [m] how far
    from its joint the matter of each link may lie where all are identified (:func:`~.inertia.radii`, as described;
    None: anywhere).
    """
    least_of = [s.family().lower_bounds(robot, s) - base.get(s.as_finding, 0.0) for s in terms]
    lower = np.concatenate(least_of or [np.zeros(0)])
    bodies: list[tuple[int, Array]] = []
    for term, start in zip(terms, starts, strict=True):
        bodies += [(start + first, offset) for first, offset in term.family().inertial_bodies(robot, term)]
    at = list(zip(terms, starts, strict=True))
    rows, least = [], []
    for term, start in at:
        if not term.family().all_links or reach_of_links is None:
            continue
        links = zip(term.family().inertial_bodies(robot, term), term.family().joints_of(robot, term), strict=True)
        for (first, own), link in links:
            if np.isfinite(reach_of_links[link]):
                rows.append(np.zeros(total))
                within = in_ball(float(reach_of_links[link]))
                rows[-1][start + first : start + first + 10] = within
                # A link of the starting model that reaches farther need not be mended, only not be made worse.
                least.append(min(-float(within @ own), 0.0))

    def started(joint: int, speeds: Array, kind: Callable[[Term], bool], unit: Callable[[Term, Array], Array]) -> Array:
        own = [np.array([row @ x for row in unit(s, speeds)]) for s, x in base.items() if s.joint == joint and kind(s)]
        return np.asarray(sum(own, np.zeros(len(speeds))))

    def oppose(joint: int, speeds: Array, kind: Callable[[Term], bool], unit: Callable[[Term, Array], Array]) -> None:
        """What terms of that ``kind`` make together at ``joint``, ``unit`` of each coordinate, takes energy."""
        together = np.zeros((len(speeds), total))
        for term, start in at:
            if term.joint == joint and kind(term):
                together[:, start : start + term.size] = unit(term, speeds)
        rows.extend(together)
        # All that the starting model brakes with may go. One that drives at the speeds of this log (it was made at
        # others) need not be mended, only not be made worse.
        least.extend(np.minimum(-started(joint, speeds, kind, unit), 0.0))

    def brakes(term: Term, speeds: Array) -> Array:
        return _brakes(term, robot, speeds)

    reach = speeds_to_oppose(robot, fastest)
    both = np.array([[-1.0], [1.0]])
    # Also where only the starting model is curved: less of a viscous term could let the rest drive.
    for j in _joints(terms, base, _is_viscous, lambda s: s.family().viscous_powers != (1,)):
        powers = {p for t in (*terms, *base) if t.joint == j and _is_viscous(t) for p in t.family().viscous_powers}
        if min(powers) > 1:
            oppose(j, np.array([float(min(powers))]), _is_viscous, _alone)
        oppose(j, np.array([_NEAR_REST, *_SPEEDS]) * fastest[j], _is_viscous, _per_speed)
        beyond = np.ravel(both * (fastest[j] + _BETWEEN * (reach[j] - fastest[j])))
        # A starting model that drives where these logs do not reach, or was made on slower ones, says nothing there.
        if reach[j] > fastest[j] and np.all(started(j, beyond, _is_lasting, brakes) >= 0):
            oppose(j, beyond, _is_lasting, brakes)
    for j in _joints(terms, base, _is_lasting, lambda s: s.family().follows_time):
        oppose(j, np.ravel(both * _SPEEDS * fastest[j]), _is_lasting, brakes)
    return Constraints(lower, tuple(bodies), np.array(rows).reshape(len(least), total), np.array(least))


def speeds_to_oppose(robot: Robot, fastest: Array) -> Array:
    """Speeds (n,) [rad/s, m/s] up to which friction must oppose the motion, of joints seen at ``fastest`` (n,).

    A joint will move faster than in these logs, and a curve that fits them need not care what comes after.
    """
    limit = robot.velocity_limits
    believed = (limit > 0) & (limit < BELIEVABLE)
    return np.maximum(fastest, np.where(believed, np.minimum(limit, FAR * fastest), BEYOND * fastest))


def _per_speed(term: Term, speeds: Array) -> Array:
    """Viscous torque (S, p) at ``speeds`` (S,) [rad/s], divided by them, of one unit of each coordinate of ``term``."""
    return np.asarray(speeds[:, None] ** (np.array(term.family().viscous_powers) - 1))


def _alone(term: Term, powers: Array) -> Array:
    """Where a joint is about to stand, of its viscous terms the lowest of ``powers`` (S,) of the speed alone is left:
    (S, p)."""
    return np.asarray(np.array(term.family().viscous_powers) == powers[:, None], dtype=float)


def _joints(
    terms: Sequence[Term], base: Mapping[Term, Array], kind: Callable[[Term], bool], special: Callable[[Term], bool]
) -> list[int]:
    """Joints with a term of that ``kind`` where one of them, or one of the starting model, is ``special``."""
    own = {s.index for s in terms if kind(s)}
    return sorted(own & {s.index for s in (*terms, *base) if kind(s) and special(s)})


def _is_viscous(term: Term) -> bool:
    """True for a torque of powers of the speed."""
    return bool(term.family().viscous_powers)


def _is_lasting(term: Term) -> bool:
    """True for friction that acts in every run."""
    return term.family().opposes_motion(term) and ONLY_RUN not in term.options


def _brakes(term: Term, robot: Robot, speeds: Array) -> Array:
    """Torque (S, p) against a motion at ``speeds`` (S,) [rad/s], without load and long after the beginning, of one unit
    of each coordinate of ``term``; how a sign turns over does not matter, heights are compared."""
    kind, own = term.family(), term.index
    if kind.turns_sign:
        term = replace(term, settings=with_sign(term.settings, ()))
    still = np.zeros(len(speeds))
    at = State(q={own: still}, dq={own: speeds}, load={own: still}, joint=own, time=np.full(len(speeds), np.inf))
    units = [kind.at_term(term, unit, robot) for unit in np.eye(term.size)]
    torques = [np.broadcast_to(kind.law(np, at, *unit), speeds.shape) for unit in units]
    return np.asarray(np.sign(speeds)[:, None] * np.column_stack(torques))
