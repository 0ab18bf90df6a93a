"""What every effect of the catalogue offers: equation, regressor columns, constraints, inverse, and the registry.

An effect is the torque the drive must ADD to what the model already has. It is linear in its *coordinates* x (p,):
``torque = columns @ x``; the coordinates become the published parameters (names and units of the catalogue) by
:meth:`Family.parameters_of`. Where the torque is not exactly linear (a tilted base), the columns are its derivative
at zero and the loop iterates with the exact torque of :func:`hybrid_dynamics.effects.plant`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.robots import Robot

Array = NDArray[np.float64]
Settings = tuple[tuple[str, Any], ...]
Scope = Literal["joint", "link", "robot"]
StateTorque = Callable[..., Array]


@dataclass(frozen=True)
class Parameter:
    """Name and unit of a published parameter."""

    name: str
    unit: str


@dataclass(frozen=True)
class Motion:
    """States of a run: ``time`` (T,) [s], ``q dq ddq`` (T, n), and the robot whose rigid body moves.

    ``given_load`` (T, n) [N m] replaces the robot's own rigid-body torque where the model has changed it.
    """

    robot: Robot
    time: Array
    q: Array
    dq: Array
    ddq: Array
    given_load: Array | None = None

    @cached_property
    def load(self) -> Array:
        """Rigid-body torque (T, n) [N m]: what the drive delivers beyond its own friction."""
        if self.given_load is not None:
            return self.given_load
        return self.robot.inverse_dynamics(self.q, self.dq, self.ddq)

    @cached_property
    def regressor(self) -> Array:
        """Inertial regressor (T, n, 10 n), see :meth:`Robot.regressor`."""
        return self.robot.regressor(self.q, self.dq, self.ddq)


@dataclass(frozen=True, order=True)
class Slot:
    """A place an effect can take: family, joint (0-based; None for the whole robot), settings (sorted pairs)."""

    effect: str
    joint: int | None = None
    settings: Settings = ()

    def family(self) -> Family:
        """The catalogue's entry."""
        return family(self.effect)

    @property
    def index(self) -> int:
        """The joint's index, for an effect that sits at one."""
        if self.joint is None:
            raise InputError(f"effect {self.effect} acts on the whole robot; it has no joint")
        return self.joint


@dataclass(frozen=True)
class Effect:
    """An effect with values: as it stands in ``model.json`` and ``diagnosis.json``.

    ``parameters`` and ``std_errors`` map the published names to SI values; ``joints`` holds joint names, none for a
    whole-robot effect.
    """

    effect: str
    joints: tuple[str, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    std_errors: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = family(self.effect)
        names = [p.name for p in known.parameters]
        if sorted(self.parameters) != sorted(names):
            raise InputError(
                f"effect {self.effect}: parameters are {', '.join(sorted(self.parameters)) or 'none'}; "
                f"expected {', '.join(names)}"
            )
        expected = 0 if known.scope == "robot" else 1
        if len(self.joints) != expected:
            raise InputError(f"effect {self.effect}: {len(self.joints)} joints are named; expected {expected}")

    def joint_index(self, robot: Robot) -> int | None:
        """0-based index of the effect's joint in ``robot``."""
        if not self.joints:
            return None
        if self.joints[0] not in robot.joint_names:
            raise InputError(
                f"effect {self.effect}: robot {robot.name} has no joint {self.joints[0]!r}; its joints are "
                f"{', '.join(robot.joint_names)}"
            )
        return robot.joint_names.index(self.joints[0])

    def slot(self, robot: Robot) -> Slot:
        return Slot(self.effect, self.joint_index(robot), tuple(sorted(self.settings.items())))


class Family(ABC):
    """One entry of the catalogue. Subclasses are registered by :func:`register` under ``name``."""

    name: ClassVar[str]
    scope: ClassVar[Scope]
    parameters: ClassVar[tuple[Parameter, ...]]
    #: Free numbers of the effect: its price when two explanations are as good.
    size: ClassVar[int] = 1
    #: True where the torque is not exactly linear in the coordinates.
    nonlinear: ClassVar[bool] = False
    #: True where the torque depends on the rigid-body torque of the joint, and so on all other effects of the body.
    uses_load: ClassVar[bool] = False
    #: Powers of the speed, one for each coordinate, where the effect is a viscous torque x |dq|^power sign(dq).
    viscous_powers: ClassVar[tuple[int, ...]] = ()
    #: True where the torque follows sign(dq); how that turns over is a setting (see ``effects/sign.py``).
    turns_sign: ClassVar[bool] = False
    #: True where the effect changes the rigid body.
    changes_body: ClassVar[bool] = False
    #: What motion shows this effect as itself (one clause, follows "a motion in which").
    shown_by: ClassVar[str] = ""

    def slots(self, robot: Robot, moving: NDArray[np.bool_], options: Mapping[str, Any]) -> list[Slot]:
        """The places where this effect could sit; ``moving`` (n,) tells which joints move in the data."""
        if self.scope == "robot":
            return [Slot(self.name)]
        return [Slot(self.name, j) for j in range(robot.n_joints) if moving[j]]

    @abstractmethod
    def columns(self, motion: Motion, slot: Slot) -> Array:
        """Regressor: (T, p) for the torque of ``slot.joint``, or (T, n, p) where it acts on several joints."""

    def lower_bounds(self) -> Array:
        """Smallest admissible coordinates (p,)."""
        return np.full(self.size, -np.inf)

    def prior_scale(self) -> Array:
        """Order of magnitude (p,) beyond which a coordinate is implausible; only regularises what data leaves open."""
        return np.full(self.size, 1e6)

    def inertial_offset(self, robot: Robot, slot: Slot) -> Array | None:
        """(10,) the inertia to which the coordinates are added and that must stay physical, or None."""
        return None

    def parameters_of(self, x: Array, robot: Robot, slot: Slot) -> dict[str, float]:
        """Published parameters of coordinates ``x`` (p,)."""
        return {p.name: float(v) for p, v in zip(self.parameters, x, strict=True)}

    def coordinates_of(self, parameters: Mapping[str, float], robot: Robot, slot: Slot) -> Array:
        """Inverse of :meth:`parameters_of`."""
        return np.array([parameters[p.name] for p in self.parameters])

    def change(self, robot: Robot, effect: Effect) -> None:  # noqa: B027 (most effects leave the rigid body alone)
        """Enter ``robot.model`` (changed in place), where the effect is part of the rigid body."""

    def torque(self, effect: Effect, q: Array, dq: Array, load: Array | None = None) -> Array | None:
        """Torque (T,) [N m] that the drive of the effect's joint must add at joint states ``q dq`` (T,), or None.

        ``load`` (T,) [N m] is the joint's rigid-body torque, for effects that use it. Rows are states in any order.
        """
        return None

    def torque_along(self, effect: Effect, q: Array, dq: Array, load: Array | None = None) -> Array | None:
        """The same where the rows are one run in the order of time, for torques that depend on the past."""
        return self.torque(effect, q, dq, load)

    def jacobian(self, x: Array, robot: Robot, slot: Slot) -> Array:
        """Derivative of the published parameters with respect to the coordinates, (number of parameters, p)."""
        step = 1e-6
        out = np.empty((len(self.parameters), len(x)))
        for k in range(len(x)):
            h = step * max(1.0, abs(x[k]))
            up, down = x.copy(), x.copy()
            up[k] += h
            down[k] -= h
            plus, minus = self.parameters_of(up, robot, slot), self.parameters_of(down, robot, slot)
            out[:, k] = [(plus[p.name] - minus[p.name]) / (2 * h) for p in self.parameters]
        return out


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


def catalogue() -> tuple[str, ...]:
    """Names of all registered families, sorted."""
    return tuple(sorted(_REGISTRY))
