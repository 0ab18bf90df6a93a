"""An effect with numbers, as files and exports know it: its law over published parameters and settings.

**One law.** A family that is not part of the rigid body writes its torque once, as :meth:`Family.law`, over an array
namespace ``xp``: columns, prediction, forward simulation and every export come from it. ``xp`` offers ``sin cos exp
tanh abs sign sqrt where minimum maximum`` (NumPy does; for CasADi or C a small object with these names does). What the
law sees is a :class:`State`: quantities of all joints, indexed by joint, as arrays (T,) or as symbols.

**Memory.** Friction that follows the distance since the last reversal has one state z, dz/dt = (dq - abs(dq) z / g) / s
(Dahl 1968 with g = 1, scaled to abs(z) <= 1; Canudas de Wit et al. 1995 with a g that falls with the speed);
:meth:`Family.presliding` gives the presliding displacement s [rad], or None without memory, :meth:`Family.memory_level`
the level g; the law reads ``at.z``.
"""

from __future__ import annotations

from abc import ABC
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from hybrid_dynamics.effects.declared import Declared
from hybrid_dynamics.effects.keys import joint_number, split_key
from hybrid_dynamics.effects.sign import presliding_sign
from hybrid_dynamics.effects.state import Refined, State
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array

#: Setting that names the other joint of an effect between two.
FROM_JOINT = "from_joint"


class Law(Declared, ABC):
    """What a :class:`~hybrid_dynamics.effects.base.Family` does with published parameters, wherever they come from."""

    # -- the law ------------------------------------------------------------------------------------------------------
    @property
    def has_law(self) -> bool:
        """False where the effect is part of the rigid body or of what is read."""
        return not (self.changes_body or self.changes_reading)

    def law(self, xp: Any, at: State, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        """Torque [N m] of joint ``at.joint``, over the array namespace ``xp``; see the module's first lines."""
        raise InputError(f"effect {self.name} has no law of its own: it is part of the rigid body or of the reading")

    def presliding(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> float | None:
        """Distance s [rad] of the memory that ``at.z`` holds, or None where the law has none."""
        return None

    def memory_level(self, xp: Any, dq: Any, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Any:
        """Level g >= 0 that the memory comes to while the joint goes on at ``dq``, over the namespace ``xp``."""
        return 1.0

    def along(self, at: State, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> Array:
        """The law (T,) over one run, rows in the order of time: its memory runs along."""
        displacement = self.presliding(parameters, settings)
        if displacement is not None:
            level = self.memory_level(np, at.own_dq, parameters, settings)
            own = None if np.ndim(level) == 0 else level
            at = replace(at, z=presliding_sign(at.own_q, displacement, own, _begun(at, displacement, level)))
        return np.broadcast_to(self.law(np, at, parameters, settings), np.shape(at.own_dq)).astype(float)

    def partner(self, robot: Robot, settings: Mapping[str, Any]) -> int | None:
        """0-based index of the other joint of an effect between two."""
        name = settings.get(FROM_JOINT)
        return None if name is None else joint_number(robot, str(name), f"effect {self.name}, setting {FROM_JOINT}")

    # -- published parameters -----------------------------------------------------------------------------------------
    def published(self, settings: Mapping[str, Any]) -> tuple[str, ...]:
        """Keys of the published parameters of an effect with ``settings``, in order."""
        return tuple(p.name for p in self.parameters)

    def unit(self, key: str, settings: Mapping[str, Any]) -> str:
        """Unit of the published parameter ``key`` (``"name"`` or ``"joint/name"``)."""
        return {p.name: p.unit for p in self.parameters}[split_key(key)[1]]

    def setting_values(self, parameters: Mapping[str, float]) -> dict[str, float]:
        """Nonlinear parameters of published ones, as they stand in a term's settings."""
        return {r.name: float(parameters[r.name]) for r in self.nonlinear_settings}

    def nonlinear_of(self, settings: Mapping[str, Any]) -> tuple[Refined, ...]:
        """Those of :attr:`nonlinear_settings` that an effect with ``settings`` has."""
        return self.nonlinear_settings

    def forbidden(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> str:
        """What physics asks of these parameters beyond the bounds of single ones, where they do not keep to it; else
        nothing."""
        return ""

    def price(self, settings: Mapping[str, Any]) -> int:
        """What it costs beside an explanation that is as good: its published numbers."""
        return len(self.published(settings))

    def in_descriptions(self, parameters: Mapping[str, float], settings: Mapping[str, Any]) -> dict[str, float]:
        """In the terms of robot description formats (``export/terms.py``), each with its value."""
        return {"law": 1.0}


def _begun(at: State, displacement: float, level: Any) -> float:
    """The memory at the first row of a run that began before it (a filter has cut its edges off): as if the joint had
    gone at its speed there ever since. 0 where it is the first row, or the joint stands."""
    if at.time is None or not len(at.own_dq):
        return 0.0
    most, gone = float(np.ravel(level)[0]), float(at.own_dq[0]) * max(float(at.time[0]), 0.0)
    return float(np.sign(gone) * most * -np.expm1(-abs(gone) / (displacement * most)))
