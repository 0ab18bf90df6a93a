"""What a law of an effect sees, and the plain data around it: parameters, motions, equivalences."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

Settings = tuple[tuple[str, Any], ...]
Scope = Literal["joint", "link", "robot"]
Variable = Literal["time", "q", "dq", "ddq", "load"]


@dataclass(frozen=True)
class Parameter:
    """Name and unit of a published parameter, at a joint that turns; ``angle``: one also where the joint slides."""

    name: str
    unit: str
    angle: bool = field(default=False, repr=False)


@dataclass(frozen=True)
class Refined:
    """A nonlinear parameter that stands as a number in a term's settings: refined within ``low`` to ``high``.

    ``log``: searched on a logarithmic scale.
    """

    name: str
    low: float
    high: float
    log: bool = True


@dataclass(frozen=True)
class Equivalence:
    """Families that together can make the same torque, ``why``, and what would tell them apart.

    ``always``: no motion of this robot can tell.
    """

    effects: tuple[str, ...]
    why: str
    remedy: str
    always: bool = False


@dataclass(frozen=True)
class State:
    """What a law sees: ``q dq ddq load`` of every joint, indexed by joint from 0; the effect's own joint and partner.

    ``load`` is the rigid-body torque; ``time`` [s] since the beginning of the run; ``z`` the memory of dry friction
    (None: as if it had none). Entries are arrays (T,), numbers or symbols.
    """

    q: Any
    dq: Any
    ddq: Any = None
    load: Any = None
    joint: int = 0
    partner: int | None = None
    time: Any = None
    z: Any = None

    @property
    def own_q(self) -> Any:
        return self.q[self.joint]

    @property
    def own_dq(self) -> Any:
        return self.dq[self.joint]

    @property
    def own_ddq(self) -> Any:
        if self.ddq is None:
            raise InputError("the effect follows accelerations, and none are given; give ddq")
        return self.ddq[self.joint]

    @property
    def partner_ddq(self) -> Any:
        if self.ddq is None:
            raise InputError("the effect follows accelerations, and none are given; give ddq")
        return self.ddq[self.partner]

    @property
    def own_load(self) -> Any:
        if self.load is None:
            raise InputError("the effect follows the joint's rigid-body torque, and none is given; give it as load")
        return self.load[self.joint]


@dataclass(frozen=True)
class Motion:
    """States of a run: ``time`` (T,) [s], ``q dq ddq`` (T, n), and the robot whose rigid body moves (that of the model
    so far, for effects with ``uses_body``). ``began`` [s]: when the run did, where that is not the first of ``time``.

    ``given_load`` (T, n) [N m] replaces the robot's own rigid-body torque where the model has changed it;
    ``given_torque`` (T, n) [N m] is the torque of the whole model (rigid body and effects, without those that only
    change what is read) as late as it is recorded, for effects with ``uses_torque``, and ``given_lag`` [s] the time
    constant of the low-pass in that. ``given_regressor`` (K, n, 10 n) is the inertial regressor
    after smoothing, for effects with ``by_regressor``.
    """

    robot: Robot
    time: Array
    q: Array
    dq: Array
    ddq: Array
    given_load: Array | None = None
    given_torque: Array | None = None
    given_lag: float = 0.0
    given_regressor: Array | None = None
    began: float | None = None

    @cached_property
    def load(self) -> Array:
        """Rigid-body torque (T, n) [N m]: what the drive delivers beyond its own friction."""
        if self.given_load is not None:
            return self.given_load
        return self.robot.inverse_dynamics(self.q, self.dq, self.ddq)

    @property
    def torque(self) -> Array:
        """Torque (T, n) [N m] of the model so far; its rigid-body torque where no more is given."""
        return self.load if self.given_torque is None else self.given_torque

    @cached_property
    def regressor(self) -> Array:
        """Inertial regressor (T, n, 10 n), see :meth:`Robot.regressor`."""
        if self.given_regressor is not None:
            return self.given_regressor
        return self.robot.regressor(self.q, self.dq, self.ddq)

    def state(self, joint: int, partner: int | None = None, load: bool = False) -> State:
        """What a law at ``joint`` sees; the rigid-body torque only where ``load`` asks for it."""
        return State(
            self.q.T,
            self.dq.T,
            self.ddq.T,
            self.load.T if load else None,
            joint,
            partner,
            self.time - (self.time[0] if self.began is None else self.began),
        )
