"""A completed model as CasADi functions: torque, residual, standard deviation, and the advance of what has a memory.

All of it comes from the same places as :meth:`Model.predict`: the laws of the effect families, evaluated on symbols,
and the numbers of the completed robot. C, Python and CasADi exports print these functions; no law is written twice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as cs
import numpy as np

from hybrid_dynamics.effects import Effect, State, family, readings, with_effects
from hybrid_dynamics.export.body import BodyNumbers
from hybrid_dynamics.export.rigid_body import inverse_dynamics
from hybrid_dynamics.export.rigid_body import symbols as body_symbols
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.uncertainty import uncertain_parameters
from hybrid_dynamics.types import Array

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
    """One state of the exported model: ``joint`` (None: elapsed time), its presliding ``displacement`` [rad] and the
    number of the ``law`` whose level follows the speed (None: it comes to 1)."""

    name: str
    joint: int | None = None
    displacement: float = 0.0
    law: int | None = None


class SymbolicModel:
    """CasADi functions of ``model``; inputs ``q dq ddq`` (n,), ``tau_model`` (n,), ``state`` (number of memories).

    ``left`` (n,) [N m] is what was left on held-out runs, ``correlation`` (P, P) that of the uncertain parameters.
    """

    def __init__(self, model: Model, left: Array | None = None, correlation: Array | None = None) -> None:
        self.model = model
        self.n = model.robot.n_joints
        self.left = np.zeros(self.n) if left is None else np.asarray(left, float)
        self.correlation = correlation
        self.q, self.dq, self.ddq, self.tau_model = (cs.SX.sym(s, self.n) for s in ("q", "dq", "ddq", "tau_model"))
        self.dt = cs.SX.sym("dt")
        self.laws = [(e, family(e.effect)) for e in model.effects if family(e.effect).has_law]
        self.memories = self._memories()
        self.state = cs.SX.sym("state", len(self.memories))

    def _memories(self) -> list[Memory]:
        """Friction states, one for each joint and displacement, or for a law whose level follows the speed, and the
        elapsed time where a law depends on it."""
        found: dict[Memory, None] = {}
        for k, (effect, kind) in enumerate(self.laws):
            rows = kind.rows(self.model.robot, effect.term(self.model.robot))
            found |= {memory: None for joint, _ in rows if (memory := self._memory(k, joint)) is not None}
        time, no_state = cs.SX.sym("time"), dict.fromkeys(found, cs.SX(0))
        torque = self._laws(self.q, self.tau_model, {}, no_state, time)
        return [*found, *([Memory(ELAPSED)] if cs.depends_on(torque, time) else [])]

    def _memory(self, k: int, joint: int) -> Memory | None:
        """The state that the k-th law has at ``joint``, or None."""
        effect, kind = self.laws[k]
        displacement = kind.presliding(effect.parameters, effect.settings)
        if displacement is None:
            return None
        level = kind.memory_level(Namespace, self.dq[joint], effect.parameters, effect.settings)
        own = None if cs.SX(level).is_constant() else k
        return Memory(f"z of {self.model.robot.joint_names[joint]}", joint, displacement, own)

    def _level(self, memory: Memory, parameters: Mapping[str, Any] | None = None) -> Any:
        """What the friction state comes to at the speed of its joint, with other ``parameters`` of its law if given."""
        if memory.law is None or memory.joint is None:
            return 1.0
        effect, kind = self.laws[memory.law]
        own = effect.parameters if parameters is None else parameters
        return kind.memory_level(Namespace, self.dq[memory.joint], own, effect.settings)

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
        """Standard deviation of measured minus predicted torque.

        Errors of the parameters (independent of one another where their correlation is not known) and what was left on
        held-out runs, as far as ``model.json`` holds them.
        """
        changes = cs.horzcat(cs.SX(self.n, 0), *self._sensitivities())
        correlation = np.eye(changes.size2()) if self.correlation is None else self.correlation
        variance = cs.sum2((changes @ cs.sparsify(cs.SX(correlation))) * changes)
        variance = cs.fmax(variance, 0.0) + cs.SX(self.left**2)
        return self._function("torque_std", self.inputs, cs.sqrt(variance))

    @property
    def deviation_words(self) -> str:
        """What :attr:`deviation` is made of, for the text of the exported file."""
        count = len(uncertain_parameters(self.model.effects))
        parts = ["standard errors of the parameters"] if count else []
        if count > 1:
            known = self.correlation is not None
            parts[0] += " with their correlations" if known else " (taken as independent of one another)"
        if np.any(self.left):
            parts.append("the error on held-out runs")
        return " and ".join(parts) or "zero, because the model holds neither standard errors nor a held-out error"

    @cached_property
    def advance(self) -> cs.Function:
        """The state after ``dt`` [s] at speeds ``dq``: exact for a speed that is constant meanwhile."""
        after = []
        for k, memory in enumerate(self.memories):
            if memory.joint is None:
                after.append(self.state[k] + self.dt)
                continue
            speed = self.dq[memory.joint]
            level = self._level(memory)
            goal = level * cs.sign(speed)
            left = cs.exp(-cs.fabs(speed) * self.dt / (memory.displacement * level))
            after.append(goal + (self.state[k] - goal) * left)
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
        z = {memory: self.state[k] for k, memory in enumerate(self.memories) if memory.joint is not None}
        time = next((self.state[k] for k, m in enumerate(self.memories) if m.joint is None), None)
        return (load + self._laws(q, load, changed or {}, z, time)) * cs.vertcat(*(cs.SX(g) for g in read["gain"]))

    def _laws(self, q: cs.SX, load: cs.SX, changed: Mapping[int, Any], z: Mapping[Any, Any], time: Any) -> cs.SX:
        """Sum of all laws; ``changed`` replaces the parameters of the k-th of them."""
        out = [cs.SX(0)] * self.n
        for k, (effect, kind) in enumerate(self.laws):
            parameters = changed.get(k, effect.parameters)
            for joint, partner in kind.rows(self.model.robot, effect.term(self.model.robot)):
                memory = self._memory(k, joint)
                state = None if memory is None else z[memory]
                if memory is not None and memory.law is not None and k in changed:
                    # The state has come to the level of the numbers as they are.
                    state = state * self._level(memory, parameters) / self._level(memory)
                at = State(q, self.dq, self.ddq, load, joint, partner, time, state)
                out[joint] = out[joint] + kind.law(Namespace, at, parameters, effect.settings)
        return cs.vertcat(*out)

    # -- uncertainty --------------------------------------------------------------------------------------------------
    def _sensitivities(self) -> list[cs.SX]:
        """Change of the torque (n,) with one standard error of each uncertain parameter, in the model's order."""
        symbols: list[cs.SX] = []
        values: list[float] = []
        changed: dict[int, dict[str, Any]] = {k: dict(effect.parameters) for k, (effect, _) in enumerate(self.laws)}
        directions: list[tuple[int | None, Any]] = []  # a law's symbol, or a direction of the body's numbers; size
        position = {id(effect): k for k, (effect, _) in enumerate(self.laws)}
        for k, key in uncertain_parameters(self.model.effects):
            effect = self.model.effects[k]
            spread = effect.std_errors[key]
            if id(effect) not in position:
                directions.append((None, self._tangent(k, key, spread)))
                continue
            directions.append((len(symbols), spread))
            symbols.append(cs.SX.sym(f"p{len(symbols)}"))
            values.append(effect.parameters[key])
            changed[position[id(effect)]][key] = symbols[-1]
        body, entries = body_symbols(self.n)
        reading = [cs.SX.sym(f"reading{k}") for k in range(2 * self.n)]
        torque = self._torque(body, {"offset": reading[: self.n], "gain": reading[self.n :]}, changed)
        held = cs.vertcat(*symbols, entries, *reading)
        at = cs.vertcat(*values, self._entries(self.model.effects))
        columns = []
        for symbol, size in directions:
            direction = np.zeros(held.numel())
            if symbol is None:
                direction[len(symbols) :] = size
            else:
                direction[symbol] = size
            column = cs.jtimes(torque, held, cs.sparsify(cs.SX(direction)))
            columns.append(cs.substitute(column, held, at))
        return columns

    def _tangent(self, k: int, key: str, spread: float) -> Array:
        """Change of body numbers and readings with one standard error of parameter ``key`` of the k-th effect."""
        sides = []
        for sign in (1.0, -1.0):
            effects = list(self.model.effects)
            values = {**effects[k].parameters, key: effects[k].parameters[key] + sign * _STEP * spread}
            effects[k] = replace(effects[k], parameters=values)
            sides.append(self._entries(effects))
        return (sides[0] - sides[1]) / (2 * _STEP)

    def _entries(self, effects: Sequence[Effect]) -> Array:
        read = readings(self.model.robot, effects)
        body = BodyNumbers.of(with_effects(self.model.robot, effects)[0])
        return np.concatenate([body.flat(), read.offset, read.gain])


def _is_zero(value: Any) -> bool:
    return isinstance(value, float | int) and value == 0
