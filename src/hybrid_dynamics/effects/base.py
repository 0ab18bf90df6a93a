"""What every effect of the catalogue offers: places, regressor columns, constraints, inverse; its law: :mod:`.law`.

An effect is the torque the drive must ADD to what the model already has. Given its *settings* it is linear in its
*coordinates* x (p,): ``torque = columns @ x``; coordinates and settings together become the published parameters (names
and units of the catalogue) by :meth:`Family.parameters_of`. Where the torque is not exactly linear (a shifted centre of
mass), the columns are its derivative at zero and the loop iterates with the exact torque of
:mod:`hybrid_dynamics.effects.acting`.

**Nonlinear parameters** are numbers in the term's settings, declared as :class:`Refined`: the loop starts from the
small grid that :meth:`Family.terms` offers and refines them; they are published as parameters, with standard errors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects.keys import central_difference, hashable, joint_number
from hybrid_dynamics.effects.law import Law
from hybrid_dynamics.effects.settings import check_refined, check_settings
from hybrid_dynamics.effects.state import Motion, Refined, Settings
from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: ``torque(q, dq, load=None, ddq=None, time=None) -> (T, n)`` [N m].
StateTorque = Callable[..., Array]

#: Setting of an effect that acts in one run only, or in some: its name, or theirs (:func:`acts_in`).
ONLY_RUN = "only_run"
#: Setting of an effect that acts for a while only: pairs (start, end) [s since the run began].
INTERVALS = "intervals"
#: Setting of an effect that is estimated beside others and is no finding: the size that its parameter is expected
#: within; of bodies the share of what is plausible of each of their numbers.
HELD = "held_within"


def acts_in(settings: Mapping[str, Any], run: str) -> bool:
    """True where an effect with ``settings`` acts in the ``run`` of that name."""
    only = settings.get(ONLY_RUN)
    return only is None or (run == only if isinstance(only, str) else run in only)


def whole_of(term: Term) -> Term:
    """``term`` in all runs."""
    return replace(term, settings=tuple(s for s in term.settings if s[0] != ONLY_RUN))


@dataclass(frozen=True, order=True)
class Term:
    """A place an effect can take: family, joint (0-based; None for the whole robot), settings (sorted pairs)."""

    effect: str
    joint: int | None = None
    settings: Settings = ()

    def __hash__(self) -> int:
        return self._hash

    def __reduce__(self) -> tuple[type[Term], tuple[Any, ...]]:
        # What is kept beside the fields holds for this process only: the hash of a string changes.
        return Term, (self.effect, self.joint, self.settings)

    @cached_property
    def _hash(self) -> int:
        # Searches look terms up by the million.
        return hash((self.effect, self.joint, self.settings))

    def family(self) -> Family:
        """The catalogue's entry."""
        return family(self.effect)

    @property
    def index(self) -> int:
        """The joint's index, for an effect that sits at one."""
        if self.joint is None:
            raise InputError(f"effect {self.effect} acts on the whole robot; it has no joint")
        return self.joint

    @cached_property
    def size(self) -> int:
        """Number of coordinates."""
        return self.family().size_of(self)

    @cached_property
    def place(self) -> tuple[Any, ...]:
        """What at most one effect of a model may have: two terms of one place exclude each other."""
        return self.family().place(self)

    @property
    def is_finding(self) -> bool:
        """False for what is estimated beside others only (:data:`HELD`)."""
        return HELD not in self.options

    @property
    def as_finding(self) -> Term:
        """The same place as it is named: what is estimated beside others only is no finding (:data:`HELD`)."""
        return replace(self, settings=tuple(s for s in self.settings if s[0] != HELD))

    @property
    def options(self) -> dict[str, Any]:
        """The settings as a dictionary."""
        return dict(self.settings)

    def prior_scale(self, robot: Robot) -> Array:
        """(size,) what its coordinates may plausibly be: the family's, or within what it is :data:`HELD`; of a body
        that is a share of the family's."""
        held = self.options.get(HELD)
        if held is None:
            return self.family().prior_scale(robot, self)
        if self.family().is_body:
            return float(held) * self.family().prior_scale(robot, self)
        return np.full(self.size, float(held))

    def refined(self, **values: float) -> Term:
        """The same place with other values of nonlinear parameters."""
        known = {r.name for r in self.family().refined_at(self)}
        if unknown := set(values) - known:
            raise InputError(f"effect {self.effect} has no nonlinear parameter {', '.join(sorted(unknown))}")
        return replace(self, settings=tuple(sorted({**self.options, **values}.items())))


@dataclass(frozen=True)
class Effect:
    """An effect with values: as it stands in ``model.json`` and ``diagnosis.json``.

    ``parameters`` and ``std_errors`` map the published names to SI values; a parameter that a whole-robot effect has
    once per link is called ``"joint/name"``. ``joints`` holds joint names, none for a whole-robot effect. ``settings``
    is what is not a number that was identified; nonlinear parameters given among them are taken out, since they are
    parameters.
    """

    effect: str
    joints: tuple[str, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    std_errors: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = family(self.effect)
        nonlinear = {r.name for r in known.nonlinear_settings}
        settings = {k: hashable(v) for k, v in self.settings.items() if k not in nonlinear}
        object.__setattr__(self, "settings", settings)
        check_settings(self.effect, settings, (*known.known_settings, ONLY_RUN, HELD))
        names = known.published(settings)
        if sorted(self.parameters) != sorted(names):
            raise InputError(
                f"effect {self.effect}: parameters are {', '.join(sorted(self.parameters)) or 'none'}; "
                f"expected {', '.join(names) or 'none'}"
            )
        check_refined(self.effect, known.nonlinear_of(settings), known.setting_values, self.parameters)
        expected = (0,) if known.scope == "robot" else (0, 1) if known.shared else (1,)
        if len(self.joints) not in expected:
            raise InputError(f"effect {self.effect}: {len(self.joints)} joints are named; expected {expected[-1]}")

    @property
    def is_finding(self) -> bool:
        """False for what is estimated beside other effects only so that they come out right."""
        return HELD not in self.settings

    def joint_index(self, robot: Robot) -> int | None:
        """0-based index of the effect's joint in ``robot``."""
        return joint_number(robot, self.joints[0], f"effect {self.effect}") if self.joints else None

    def term(self, robot: Robot) -> Term:
        """The place it takes in ``robot``, nonlinear parameters among its settings."""
        numbers = family(self.effect).setting_values(self.parameters)
        settings = {**self.settings, **numbers}
        return Term(self.effect, self.joint_index(robot), tuple(sorted(settings.items())))


class Family(Law):
    """One entry of the catalogue. Subclasses are registered by :func:`register` under ``name``.

    >>> from hybrid_dynamics import Family
    >>> from hybrid_dynamics.effects import catalogue, family
    >>> viscous = family("viscous_friction")
    >>> isinstance(viscous, Family), viscous.scope, viscous.parameters
    (True, 'joint', (Parameter(name='viscous_coefficient', unit='N m s/rad'),))
    >>> "coulomb_friction" in catalogue()
    True
    """

    # -- where it can sit ---------------------------------------------------------------------------------------------
    def terms(self, robot: Robot, moving: NDArray[np.bool_], options: Mapping[str, Any]) -> list[Term]:
        """The places where this effect could sit; ``moving`` (n,) tells which joints move in the data.

        Nonlinear parameters stand at the few values of :meth:`grid`.
        """
        joints: list[int | None] = [None] if self.scope == "robot" else [j for j in range(robot.n_joints) if moving[j]]
        return [Term(self.name, j, settings) for j in joints for settings in self.grid(options)]

    def grid(self, options: Mapping[str, Any]) -> list[Settings]:
        """Settings to start from, the same on every joint."""
        return [()]

    def propose(
        self, names: Sequence[str], motions: Sequence[Motion], residuals: Sequence[Array], moving: NDArray[np.bool_]
    ) -> list[Term]:
        """Terms suggested by what a model leaves: ``residuals`` (T, n) [N m], one for each of ``motions`` (runs)."""
        return []

    def surface(self, x: Array, robot: Robot, term: Term) -> tuple[Array, float]:
        """Tangent plane ``normal @ y = value``, near ``x``, of the surface that coordinates lie on."""
        raise InputError(f"effect {self.name}: its coordinates lie on no surface")

    def forms(self, term: Term) -> list[Term]:
        """Laws of the same place whose columns are the same at zero: only the laws themselves tell them apart."""
        return []

    def richer(self, own: Sequence[Term]) -> list[Term]:
        """Laws of this family, all of one place, of more numbers than are asked for unnamed, that effects ``own`` of a
        joint may stand for: starts, from where these are."""
        return []

    def plainer(self, term: Term) -> Term | None:
        """What a richer law at ``term`` (:meth:`richer`) is where it needs none of its further numbers."""
        return None

    def is_known(self, effect: Effect) -> bool:
        """Whether the further numbers of a richer law (:meth:`richer`) are known, from their standard errors."""
        return True

    def is_wide(self, term: Term) -> bool:
        """True where ``term`` shows in several joints' torques: only looked for with every joint's own effects in."""
        return self.scope != "joint"

    def size_of(self, term: Term) -> int:
        """Number of coordinates at ``term``."""
        return self.size

    def place(self, term: Term) -> tuple[Any, ...]:
        """See :attr:`Term.place`."""
        return (term.effect, term.joint)

    def covers(self, term: Term, special: Term) -> bool:
        """True where ``term`` holds ``special`` as a special case."""
        return special.effect in self.contains and special.joint == term.joint

    def joints_of(self, robot: Robot, term: Term) -> list[int]:
        """0-based joints on which ``term`` holds the families that it contains."""
        return [] if term.joint is None else [term.joint]

    def twin(self, term: Term, robot: Robot) -> Term | None:
        """The term of another family that is structurally the same as ``term``, whatever the motion."""
        return None

    def inseparable(self, term: Term, other: Term) -> str:
        """Why no motion of a robot tells ``term`` from ``other``, one sentence; empty where one does."""
        return ""

    def rows(self, robot: Robot, term: Term) -> list[tuple[int, int | None]]:
        """(joint, partner) of every row of the torque in which the law stands."""
        return [(term.index, self.partner(robot, term.options))]

    # -- the regressor ------------------------------------------------------------------------------------------------
    def at_term(self, term: Term, x: Array, robot: Robot) -> tuple[dict[str, float], dict[str, Any]]:
        """Published parameters and settings of coordinates ``x``, as the law takes them."""
        return self.parameters_of(x, robot, term), term.options

    def columns(self, motion: Motion, term: Term) -> Array:
        """Regressor: (T, p) for the torque of ``term.joint``, or (T, n, p) where it acts on several joints.

        The law at each unit coordinate; families whose published parameters do not exist there have their own.
        """
        rows = self.rows(motion.robot, term)
        units = np.eye(self.size_of(term))
        out = np.zeros((len(motion.time), motion.robot.n_joints if len(rows) > 1 else 1, len(units)))
        for k, unit in enumerate(units):
            parameters, settings = self.at_term(term, unit, motion.robot)
            for joint, partner in rows:
                at = motion.state(joint, partner, self.uses_load)
                out[:, joint if len(rows) > 1 else 0, k] = self.along(at, parameters, settings)
        return out if len(rows) > 1 else out[:, 0]

    def refined_at(self, term: Term) -> tuple[Refined, ...]:
        """Numbers among the settings of ``term`` that were fitted: what they leave open the parameters share."""
        return self.nonlinear_of(term.options)

    def setting_columns(self, motion: Motion, term: Term, x: Array) -> Array:
        """Derivative of the torque at ``x`` with respect to :meth:`refined_at`: as :meth:`columns`, (..., m)."""
        parts = []
        for r in self.refined_at(term):
            value = float(term.options[r.name])
            h = 1e-4 * (abs(value) if r.log else max(r.high - r.low, 1e-12))
            up, down = (self.columns(motion, term.refined(**{r.name: value + s * h})) @ x for s in (1, -1))
            parts.append((up - down) / (2 * h))
        return np.stack(parts, axis=-1)

    # -- what physics demands -----------------------------------------------------------------------------------------
    def lower_bounds(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        """Smallest admissible coordinates (p,)."""
        return np.full(self.size if term is None else term.size, -np.inf)

    def admissible(self, term: Term) -> str:
        """:meth:`lower_bounds` in words."""
        return ">= 0"

    def prior_scale(self, robot: Robot | None = None, term: Term | None = None) -> Array:
        """Order of magnitude (p,) beyond which a coordinate is implausible; only regularises what data leaves open."""
        return np.full(self.size if term is None else term.size, 1e6)

    def open_scale(self, robot: Robot, term: Term) -> Array:
        """Spread (p,) of what nothing is known of: the prior's, unless that is knowledge itself."""
        return term.prior_scale(robot)

    def opposes_motion(self, term: Term) -> bool:
        """True where ``term`` is friction: it may take energy, never give it."""
        return self.is_friction

    def inertial_bodies(self, robot: Robot, term: Term) -> list[tuple[int, Array]]:
        """Bodies that must stay physical: first of ten coordinates, and the inertia (10,) they are added to."""
        return []

    def inertial_changes(self, x: Array, robot: Robot, term: Term) -> list[Array]:
        """By how much coordinates ``x`` (p,) change single bodies, (10,) each: of these there is a most that can be."""
        return []

    def is_none(self, x: Array, term: Term, dry_friction: float) -> bool:
        """True where coordinates ``x`` (p,) within their bounds are still no such effect, on a joint that in motion has
        ``dry_friction`` [N m] in all, its own included: it stands for another."""
        return False

    def summed(self, x: Array) -> Array:
        """Coordinates (p,) of one effect that does what several at its place do, of coordinates ``x`` (m, p)."""
        return np.asarray(x.sum(axis=0))

    # -- published parameters -----------------------------------------------------------------------------------------
    def parameters_of(self, x: Array, robot: Robot, term: Term) -> dict[str, float]:
        """Published parameters of coordinates ``x`` (p,) at ``term``; nonlinear ones come from its settings."""
        linear = [p.name for p in self.parameters if p.name not in {r.name for r in self.nonlinear_settings}]
        values = {name: float(v) for name, v in zip(linear, x, strict=True)}
        return values | {r.name: float(term.options[r.name]) for r in self.nonlinear_settings}

    def coordinates_of(self, parameters: Mapping[str, float], robot: Robot, term: Term) -> Array:
        """Inverse of :meth:`parameters_of`."""
        refined = {r.name for r in self.nonlinear_settings}
        return np.array([parameters[p.name] for p in self.parameters if p.name not in refined])

    def left_open(self, term: Term, loose: NDArray[np.bool_]) -> list[str]:
        """Keys of the published parameters that the ``loose`` coordinates (p,), left to the prior, leave open."""
        keys = self.published(term.options)
        refined = {r.name for r in self.nonlinear_settings}
        linear = [key for key in keys if key not in refined]
        if len(linear) == len(loose):
            return [key for key, is_open in zip(linear, loose, strict=True) if is_open]
        return list(keys) if bool(np.any(loose)) else []

    def jacobian(self, x: Array, robot: Robot, term: Term) -> Array:
        """Derivative of the published parameters with respect to the coordinates, (number of parameters, p)."""

        def values(y: Array) -> Array:
            return np.array(list(self.parameters_of(y, robot, term).values()))

        return central_difference(values, x, 1e-6 * np.maximum(1.0, np.abs(x)))

    def setting_jacobian(self, x: Array, robot: Robot, term: Term) -> Array:
        """Derivative of the published parameters with respect to :meth:`refined_at`, (number of parameters, m)."""
        names = [r.name for r in self.refined_at(term)]

        def values(s: Array) -> Array:
            moved = term.refined(**dict(zip(names, (float(v) for v in s), strict=True)))
            return np.array(list(self.parameters_of(x, robot, moved).values()))

        at = np.array([float(term.options[name]) for name in names])
        return central_difference(values, at, 1e-6 * np.maximum(np.abs(at), 1e-6))

    # -- the inverse --------------------------------------------------------------------------------------------------
    def change(self, robot: Robot, effect: Effect) -> None:
        """Enter ``robot.model`` (changed in place), where the effect is part of the rigid body."""

    # -- what a study needs -------------------------------------------------------------------------------------------
    def draw(self, robot: Robot, term: Term, rng: np.random.Generator) -> Array:
        """Random coordinates (p,) up to a positive factor."""
        if np.all(self.lower_bounds(robot, term) >= 0):
            return rng.uniform(0.3, 1.0, self.size_of(term))
        direction = rng.normal(size=self.size_of(term))
        return np.asarray(direction / np.linalg.norm(direction))

    def draw_term(self, robot: Robot, moving: NDArray[np.bool_], rng: np.random.Generator) -> Term:
        """A random place for a hidden effect: nonlinear parameters anywhere between their bounds."""
        places = self.terms(robot, moving, {"sign_widths": (0.0,)})
        term = places[int(rng.integers(len(places)))]
        values = {}
        for r in self.nonlinear_of(term.options):
            u = float(rng.uniform(0.1, 0.9))
            values[r.name] = float(r.low * (r.high / r.low) ** u) if r.log else r.low + u * (r.high - r.low)
        return term.refined(**values) if values else term

    def parameter_error(
        self, true: Effect, found: Effect, robot: Robot, motions: Sequence[Motion] = ()
    ) -> dict[str, float]:
        """Relative error of every published parameter; those of one unit are measured by the largest of them.

        A unit in which nothing is hidden has no relative error and is left out.
        """
        keys = self.published(true.settings)
        largest: dict[str, float] = {}
        for key in keys:
            unit = self.unit(key, true.settings)
            largest[unit] = max(largest.get(unit, 0.0), abs(true.parameters[key]))
        return {
            key: abs(found.parameters[key] - true.parameters[key]) / largest[self.unit(key, true.settings)]
            for key in keys
            if largest[self.unit(key, true.settings)] > 0
        }


_REGISTRY: dict[str, Family] = {}


def register(cls: type[Family]) -> type[Family]:
    """Class decorator: put the family into the catalogue under its name."""
    if cls.name in _REGISTRY:
        raise ConfigError(f"effect {cls.name!r} is registered twice; give the family its own name")
    _REGISTRY[cls.name] = cls()
    return cls


def family(name: str) -> Family:
    """The family of that name; :class:`ConfigError` names those that exist."""
    try:
        return _REGISTRY[name]
    except KeyError:
        raise ConfigError(f"effect {name!r} is unknown; known are {', '.join(sorted(_REGISTRY))}") from None


def catalogue(everything: bool = False) -> tuple[str, ...]:
    """Names of the families that are sought by default, sorted; with ``everything`` of all registered ones."""
    return tuple(sorted(name for name, kind in _REGISTRY.items() if everything or kind.searched))
