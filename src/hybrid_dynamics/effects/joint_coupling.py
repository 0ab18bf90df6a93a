"""Torque of one joint that follows another: tau_j = c dq_k + d sign(s) + e ddq_k, k = setting ``from_joint``.

Setting ``sign_of``: s is ``partner`` dq_k, ``sum`` dq_j + dq_k or ``difference`` dq_j - dq_k. Setting ``rows``:
``own``, the torque acts on joint j alone; ``both``, a gear couples the two and the same law stands in both rows with
the roles exchanged (a motor that sees the sum of two joint speeds has its friction and its rotor's inertia in both:
c, d, e >= 0; one that sees the difference c, e <= 0, d >= 0).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.base import Family, Term, register
from hybrid_dynamics.effects.law import FROM_JOINT
from hybrid_dynamics.effects.sign import WIDTH, sign_of
from hybrid_dynamics.effects.state import Equivalence, Parameter, State
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

ROWS, SIGN_OF = "rows", "sign_of"
OWN, BOTH = "own", "both"
PARTNER, SUM, DIFFERENCE = "partner", "sum", "difference"
#: Joints further apart than this share no gear or belt.
_REACH = 2
#: Widths [rad/s] over which the sign of a gear's friction turns over: given a sharp one where it is smooth, viscous
#: friction of both joints makes up for it.
_WIDTHS = (0.0, 0.03)


@register
class JointCoupling(Family):
    name = "joint_coupling"
    scope = "joint"
    known_settings = (FROM_JOINT, ROWS, SIGN_OF, WIDTH)
    equation = (
        r"\tau_j = c\,\dot q_k + d\,\operatorname{sign}(s) + e\,\ddot q_k,"
        r"\quad s \in \{\dot q_k,\ \dot q_j + \dot q_k,\ \dot q_j - \dot q_k\}"
    )
    parameters = (
        Parameter("viscous_coefficient", "N m s/rad"),
        Parameter("coulomb_torque", "N m"),
        Parameter("armature", "kg m^2"),
    )
    size = 3
    searched = False
    beside = ("viscous_friction", "coulomb_friction", "armature")
    several = True
    drawn_against = "dq"
    shown_by = "the joint rests while its partner moves, and the other way round"
    equivalent_to = (
        Equivalence(
            ("viscous_friction", "coulomb_friction", "armature"),
            "where both joints always move together nothing tells whose motion the torque follows",
            "let each of the two joints rest while the other moves",
        ),
    )

    def terms(self, robot: Robot, moving: NDArray[np.bool_], options: Mapping[str, Any]) -> list[Term]:
        """Both rows of neighbours, and every joint's own row from those nearby.

        ``moving`` are the joints whose torque is asked about: a partner's own may be explained already.
        """
        out = []
        for j in range(robot.n_joints):
            for k in range(max(j - _REACH, 0), min(j + _REACH + 1, robot.n_joints)):
                if k == j + 1 and (moving[j] or moving[k]):
                    out += [self.at(robot, j, k, BOTH, sign, w) for sign in (SUM, DIFFERENCE) for w in _WIDTHS]
                if k != j and moving[j]:
                    out.append(self.at(robot, j, k, OWN, PARTNER))
        return out

    def at(self, robot: Robot, joint: int, partner: int, rows: str, sign: str, width: float = 0.0) -> Term:
        """The term of ``joint`` and ``partner`` (0-based)."""
        settings: dict[str, Any] = {FROM_JOINT: robot.joint_names[partner], ROWS: rows, SIGN_OF: sign}
        if width > 0:
            settings[WIDTH] = width
        return Term(self.name, joint, tuple(sorted(settings.items())))

    def is_wide(self, term: Term) -> bool:
        return term.options.get(ROWS) == BOTH

    def place(self, term: Term) -> tuple[Any, ...]:
        return (term.effect, term.joint, term.options[FROM_JOINT])

    def rows(self, robot: Robot, term: Term) -> list[tuple[int, int | None]]:
        partner = self.partner(robot, term.options)
        own = [(term.index, partner)]
        return [*own, (int(partner or 0), term.index)] if term.options.get(ROWS) == BOTH else own

    def law(self, xp: Any, at: State, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        speed = at.dq[at.partner]
        acceleration = 0.0 if at.ddq is None and parameters["armature"] == 0.0 else at.partner_ddq
        which = settings.get(SIGN_OF, PARTNER)
        if which not in (PARTNER, SUM, DIFFERENCE):
            raise InputError(f"effect {self.name}: {SIGN_OF} is {which!r}; expected {PARTNER}, {SUM} or {DIFFERENCE}")
        turning = speed if which == PARTNER else at.own_dq + speed if which == SUM else at.own_dq - speed
        return (
            parameters["viscous_coefficient"] * speed
            + parameters["coulomb_torque"] * sign_of(xp, turning, settings)
            + parameters["armature"] * acceleration
        )

    def parameters_of(self, x: Array, robot: Robot, term: Term) -> dict[str, float]:
        return super().parameters_of(self._turned(x, term), robot, term)

    def coordinates_of(self, parameters: Mapping[str, float], robot: Robot, term: Term) -> Array:
        return self._turned(super().coordinates_of(parameters, robot, term), term)

    def _turned(self, x: Array, term: Term) -> Array:
        """Coordinates from published numbers and back: of a motor that sees the difference of two speeds those of the
        partner's speed and acceleration are negative, f (dq_j - dq_k) in the row of j."""
        return 0.0 + x * np.array([-1.0, 1.0, -1.0]) if self._shared(term) == DIFFERENCE else x

    def _shared(self, term: Term) -> str:
        """Which of both speeds the one motor sees whose friction and rotor stand in both rows; empty where none is."""
        which = str(term.options.get(SIGN_OF, PARTNER))
        return which if term.options.get(ROWS) == BOTH and which != PARTNER else ""

    def lower_bounds(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        # Friction of a motor opposes the motion that it sees and its rotor resists it: seen against both joints, none
        # may drive. What one joint does to another may have any sign.
        return np.full(3, 0.0 if term is not None and self._shared(term) else -np.inf)

    def admissible(self, term: Term) -> str:
        if self._shared(term) != DIFFERENCE:
            return super().admissible(term)
        return "of a motor that sees a difference viscous_coefficient and armature <= 0, coulomb_torque >= 0"

    def draw_term(self, robot: Robot, moving: NDArray[np.bool_], rng: np.random.Generator) -> Term:
        j = int(rng.integers(0, robot.n_joints - 1))
        return self.at(robot, j, j + 1, BOTH, SUM) if rng.random() < 0.5 else self.at(robot, j, j + 1, OWN, PARTNER)

    def draw(self, robot: Robot, term: Term, rng: np.random.Generator) -> Array:
        return np.array([rng.uniform(0.3, 1.0), rng.uniform(0.3, 1.0), 0.0])
