"""A completed model as CasADi functions: torque, residual, standard deviation, and the advance of what has a memory.

All of it comes from the same places as :meth:`Model.predict`: the laws of the effect families, evaluated on symbols, and
the numbers of the completed robot. C, Python and CasADi exports print these functions; no law is written twice.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Effect, State, family, plant, readings
from hybrid_dynamics.export.rigid_body import BodyNumbers, inverse_dynamics
from hybrid_dynamics.loop.model import Model

Array = NDArray[np.float64]

#: Step of the central differences of body parameters, relative to their standard errors.
_STEP = 1e-3
#: Name of the state that counts the time since the start [s].
ELAPSED = "elapsed"


class Namespace:
    """The array namespace of laws (see :mod:`hybrid_dynamics.effects.base`) over CasADi's symbols."""

    sin, cos, exp, tanh, sqrt, sign = (staticmethod(f) for f in (cs.sin, cs.cos, cs.exp, cs.tanh, cs.sqrt, cs.sign))
    abs, where, minimum, maximum = (staticmethod(f) for f in (cs.fabs, cs.if_else, cs.fmin, cs.fmax))


@dataclass(frozen=True)
class Memory:
    """One state of the exported model: ``joint`` (None: the elapsed time) and the ``travel`` [rad] of its friction."""

    name: str
    joint: int | None = None
    travel: float = 0.0


class SymbolicModel:
    """CasADi functions of ``model``; inputs ``q dq ddq`` (n,), ``tau_model`` (n,), ``state`` (number of memories)."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.n = model.robot.n_joints
        self.q, self.dq, self.ddq, self.tau_model = (cs.SX.sym(s, self.n) for s in ("q", "dq", "ddq", "tau_model"))
        self.dt = cs.SX.sym("dt")
        self.laws = [(e, family(e.effect)) for e in model.effects if family(e.effect).has_law]
        self.memories = self._memories()
        self.state = cs.SX.sym("state", len(self.memories))

    def _memories(self) -> list[Memory]:
        """Friction states, one for each joint and travel, and the elapsed time where a law depends on it."""
        found: dict[tuple[int, float], Memory] = {}
        for effect, kind in self.laws:
            travel = kind.travel(effect.parameters, effect.settings)
            for joint, _ in kind.rows(self.model.robot, effect.slot(self.model.robot)):
                if travel is not None:
                    found[joint, travel] = Memory(f"z of {self.model.robot.joint_names[joint]}", joint, travel)
        time, no_state = cs.SX.sym("time"), dict.fromkeys(found, cs.SX(0))
        torque = self._laws(self.q, self.tau_model, {}, no_state, time)
        return [*found.values(), *([Memory(ELAPSED)] if cs.depends_on(torque, time) else [])]

    @property
    def inputs(self) -> dict[str, cs.SX]:
        """What a torque depends on; the state only where something has a memory."""
        own = {"q": self.q, "dq": self.dq, "ddq": self.ddq}
        return own | ({"state": self.state} if self.memories else {})

    # -- the functions ------------------------------------------------------------------------------------------------
    @cached_property
    def rigid_body(self) -> cs.Function:
        """Rigid-body torque of the starting robot: the ``tau_model`` that ``residual`` adds to."""
        start = BodyNumbers.of(self.model.robot)
        torque = inverse_dynamics(self.model.robot, start, self.q, self.dq, self.ddq)
        return self._function("rigid_body", {"q": self.q, "dq": self.dq, "ddq": self.ddq}, torque)

    @cached_property
    def torque(self) -> cs.Function:
        """Drive torque of the completed model."""
        return self._function("torque", self.inputs, self._torque(self._body(), self._numbers()))

    @cached_property
    def residual(self) -> cs.Function:
        """What the drive must add to ``tau_model``, the rigid-body torque of the starting robot."""
        inputs = {"q": self.q, "dq": self.dq, "ddq": self.ddq, "tau_model": self.tau_model}
        inputs |= {"state": self.state} if self.memories else {}
        load = self.tau_model
        before, after = BodyNumbers.of(self.model.robot), self._body()
        offset = self._numbers()["offset"]
        if not np.array_equal(before.flat(), after.flat()) or any(not _is_zero(o) for o in offset):
            args = (self.dq, self.ddq)
            load = load + inverse_dynamics(self.model.robot, after, self.q + cs.vertcat(*offset), *args)
            load = load - inverse_dynamics(self.model.robot, before, self.q, *args)
        return self._function("residual", inputs, self._read(load, self._numbers()) - self.tau_model)

    @cached_property
    def deviation(self) -> cs.Function:
        """Standard deviation of ``torque``: standard errors of the parameters (taken as independent of one another)
        and the error on held-out runs, as far as ``model.json`` holds them."""
        columns = self._sensitivities()
        misfit = np.zeros(self.n) if self.model.misfit is None else np.array(self.model.misfit)
        variance = cs.SX(misfit**2)
        for column in columns:
            variance += column**2
        return self._function("torque_std", self.inputs, cs.sqrt(variance))

    @cached_property
    def advance(self) -> cs.Function:
        """The state after ``dt`` [s] at speeds ``dq``: exact for a speed that is constant meanwhile."""
        after = []
        for k, memory in enumerate(self.memories):
            if memory.joint is None:
                after.append(self.state[k] + self.dt)
                continue
            speed = self.dq[memory.joint]
            way = cs.sign(speed)
            after.append(way + (self.state[k] - way) * cs.exp(-cs.fabs(speed) * self.dt / memory.travel))
        out = cs.vertcat(*after) if after else cs.SX(0, 1)
        return self._function("advance", {"dq": self.dq, "dt": self.dt, "state": self.state}, out)

    def _function(self, name: str, inputs: Mapping[str, cs.SX], out: cs.SX) -> cs.Function:
        whole = cs.cse(cs.densify(out))
        return cs.Function(name, list(inputs.values()), [whole], list(inputs), ["out"])

    # -- what they are made of ----------------------------------------------------------------------------------------
    def _body(self) -> BodyNumbers:
        return BodyNumbers.of(self.model.completed_robot)

    def _numbers(self) -> dict[str, Any]:
        """Offsets and gains of the readings, one a joint."""
        read = readings(self.model.robot, self.model.effects)
        return {"offset": list(read.offset), "gain": list(read.gain)}

    def _torque(self, body: BodyNumbers, read: Mapping[str, Any], changed: Mapping[int, Any] | None = None) -> cs.SX:
        q = self.q + cs.vertcat(*(cs.SX(o) for o in read["offset"]))
        load = inverse_dynamics(self.model.robot, body, q, self.dq, self.ddq)
        return self._read(load, read, changed)

    def _read(self, load: cs.SX, read: Mapping[str, Any], changed: Mapping[int, Any] | None = None) -> cs.SX:
        """Recorded torque where the rigid body needs ``load``."""
        q = self.q + cs.vertcat(*(cs.SX(o) for o in read["offset"]))
        z = {(m.joint, m.travel): self.state[k] for k, m in enumerate(self.memories) if m.joint is not None}
        time = next((self.state[k] for k, m in enumerate(self.memories) if m.joint is None), None)
        return (load + self._laws(q, load, changed or {}, z, time)) * cs.vertcat(*(cs.SX(g) for g in read["gain"]))

    def _laws(self, q: cs.SX, load: cs.SX, changed: Mapping[int, Any], z: Mapping[Any, Any], time: Any) -> cs.SX:
        """Sum of all laws; ``changed`` replaces the parameters of the k-th of them."""
        out = [cs.SX(0)] * self.n
        for k, (effect, kind) in enumerate(self.laws):
            parameters = changed.get(k, effect.parameters)
            travel = kind.travel(effect.parameters, effect.settings)
            for joint, partner in kind.rows(self.model.robot, effect.slot(self.model.robot)):
                memory = None if travel is None else z[joint, travel]
                at = State(q, self.dq, self.ddq, load, joint, partner, time, memory)
                out[joint] = out[joint] + kind.law(Namespace, at, parameters, effect.settings)
        return cs.vertcat(*out)

    # -- uncertainty --------------------------------------------------------------------------------------------------
    def _sensitivities(self) -> list[cs.SX]:
        """Change of the torque (n,) with one standard error of each parameter."""
        symbols, values, steps = [], [], []
        changed: dict[int, dict[str, Any]] = {}
        for k, (effect, _) in enumerate(self.laws):
            known = {key: s for key, s in effect.std_errors.items() if s > 0}
            changed[k] = dict(effect.parameters)
            for key, spread in known.items():
                symbol = cs.SX.sym(f"p{len(symbols)}")
                changed[k][key] = symbol
                symbols.append(symbol)
                values.append(effect.parameters[key])
                steps.append(spread)
        body = BodyNumbers.symbols(self.n)
        names = [f"{quantity}{j}" for quantity in ("offset", "gain") for j in range(self.n)]
        read_symbols = [cs.SX.sym(s) for s in names]
        read = {"offset": read_symbols[: self.n], "gain": read_symbols[self.n :]}
        torque = self._torque(body, read, changed)
        numbers = self._numbers()
        held = cs.vertcat(*symbols, body.flat(), *read_symbols)
        at = cs.vertcat(*values, self._body().flat(), *numbers["offset"], *numbers["gain"])
        first = len(symbols)
        directions = []
        for k, step in enumerate(steps):
            direction = np.zeros(held.numel())
            direction[k] = step
            directions.append(direction)
        for tangent in self._tangents():
            direction = np.zeros(held.numel())
            direction[first:] = tangent
            directions.append(direction)
        columns = []
        for direction in directions:
            column = cs.jtimes(torque, held, cs.sparsify(cs.SX(direction)))
            columns.append(cs.substitute(column, held, at))
        return columns

    def _tangents(self) -> list[Array]:
        """Change of body numbers, offsets and gains with one standard error of each parameter that enters them."""
        out = []
        for k, effect in enumerate(self.model.effects):
            kind = family(effect.effect)
            if kind.has_law:
                continue
            for key, spread in effect.std_errors.items():
                if spread <= 0:
                    continue
                up, down = (self._entries(self._moved(k, effect, key, sign * _STEP * spread)) for sign in (1.0, -1.0))
                out.append((up - down) / (2 * _STEP))
        return out

    def _moved(self, k: int, effect: Effect, key: str, step: float) -> list[Effect]:
        values = {**effect.parameters, key: effect.parameters[key] + step}
        return [replace(e, parameters=values) if i == k else e for i, e in enumerate(self.model.effects)]

    def _entries(self, effects: list[Effect]) -> Array:
        read = readings(self.model.robot, effects)
        body = BodyNumbers.of(plant(self.model.robot, effects)[0])
        return np.concatenate([body.flat(), read.offset, read.gain])


def _is_zero(value: Any) -> bool:
    return isinstance(value, float | int) and value == 0


