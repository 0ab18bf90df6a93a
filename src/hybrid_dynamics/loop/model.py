"""The model that is being completed: a rigid body and an ordered list of effects. Saved as ``model.json``."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib.resources import files
from typing import Any

import jsonschema
import numpy as np

from hybrid_dynamics.effects import Effect, Readings, StateTorque, Term, family, readings, split_key, with_effects
from hybrid_dynamics.effects.acting import acting_torques, predict_acting, recorded
from hybrid_dynamics.effects.base import ONLY_RUN, acts_in
from hybrid_dynamics.effects.sign import WIDTH
from hybrid_dynamics.effects.units import unit_of
from hybrid_dynamics.errors import HybridDynamicsError, InputError
from hybrid_dynamics.files import json_text, write_text
from hybrid_dynamics.loop.provenance import check_identity, identity_of
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.strict_json import read_json
from hybrid_dynamics.types import Array


@dataclass(frozen=True)
class Model:
    """Rigid body plus effects. ``predict`` takes the states (T, n) of a run and returns torque (T, n) [N m].

    >>> from hybrid_dynamics import Model, Robot
    >>> from hybrid_dynamics.effects import Effect
    >>> robot = Robot.from_urdf("robot.urdf")
    >>> grease = Effect("viscous_friction", ("elbow",), {"viscous_coefficient": 0.5})  # N m s/rad
    >>> q, dq, ddq = [[0.0, 0.0]], [[0.0, 2.0]], [[0.0, 0.0]]
    >>> (Model(robot, (grease,)).predict(q, dq, ddq) - Model(robot).predict(q, dq, ddq)).round(6)
    array([[0., 1.]])
    """

    robot: Robot
    effects: tuple[Effect, ...] = ()
    #: Effects that were found and that test runs contradict: kept on record, without a torque.
    inactive: tuple[Effect, ...] = ()
    #: (n,) [N m] by which the model was off on held-out runs, where that is known.
    misfit: tuple[float, ...] | None = None
    #: [Hz] up to which its logs could be compared, where that was less than asked for (:mod:`.bandwidth`).
    cutoff: float | None = None

    @cached_property
    def _acting(self) -> tuple[Robot, StateTorque]:
        return with_effects(self.robot, self._everywhere, along=True)

    @property
    def _everywhere(self) -> list[Effect]:
        """Effects that act in any run; what happened in one says nothing of another."""
        return [e for e in self.effects if ONLY_RUN not in e.settings]

    def in_run(self, name: str) -> Model:
        """The model of one run that was searched: effects that act in the run ``name`` alone act, too."""
        if len(self._everywhere) == len(self.effects):
            return self
        own = [e for e in self.effects if acts_in(e.settings, name)]
        effects = tuple(replace(e, settings={k: v for k, v in e.settings.items() if k != ONLY_RUN}) for e in own)
        return replace(self, effects=effects)

    @cached_property
    def predictions(self) -> dict[int, tuple[Any, Array]]:
        """Predictions already made, by whoever asks repeatedly for the same runs: the run, what was predicted."""
        return {}

    @property
    def completed_robot(self) -> Robot:
        """The rigid body with all effects that are part of it (inertia, rotor, gravity)."""
        return self._acting[0]

    @cached_property
    def readings(self) -> Readings:
        """What the log reads wrongly: position offsets, torque gains, a delay."""
        return readings(self.robot, self._everywhere)

    def predict(self, q: Array, dq: Array, ddq: Array, time: Array | None = None, began: float | None = None) -> Array:
        """Recorded torque (T, n) [N m] for one whole run, rows in the order of time.

        ``time`` (T,) [s] serves effects that depend on it; ``began`` [s] is when the run did, if not at ``time[0]``.
        What acted in one run alone (setting ``only_run``) is left out.
        """
        return predict_acting(*self._acting, self.readings, q, dq, ddq, time, began)

    def acting_torques(
        self,
        q: Array,
        dq: Array,
        ddq: Array,
        time: Array | None = None,
        rigid: Array | None = None,
        began: float | None = None,
    ) -> tuple[Array, Array]:
        """Torques (T, n) [N m] at work: of the rigid body, and of it and the effects, before what is read wrongly.

        ``rigid``: the first, where it is known (of a model with the same :attr:`rigid_body`).
        """
        return acting_torques(*self._acting, self.readings, q, dq, ddq, time, rigid, began)

    @cached_property
    def rigid_body(self) -> bytes:
        """What the rigid body's torque at a recorded motion follows from: equal of models that differ in nothing else
        but what acts beside it or is read of the torque."""
        return self.completed_robot.parameters_as_bytes + self.readings.offset.tobytes()

    def recorded(self, acting: Array, time: Array | None = None) -> Array:
        """What a log holds of the torque ``acting`` (T, n) [N m]: times its gain, and as late as it is recorded."""
        return recorded(acting, time, self.readings)

    def torque(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Torque (n,) [N m] at one state ``q dq ddq`` (n,), for a controller that asks at every tick.

        Friction with a memory counts as without one, and a delay is left out: both need the past. What changes over
        the run (drift, contacts) is refused (:class:`InputError`), and so are states of another number of joints.

        >>> from hybrid_dynamics import Model, Robot
        >>> Model(Robot.from_urdf("robot.urdf")).torque([0.1, 0.0], [0.0, 0.0], [0.0, 0.0]).shape
        (2,)
        """
        changed, law = self._momentary
        at = tuple(np.asarray(a, float).reshape(1, -1) for a in (q, dq, ddq))
        if wrong := [a.size for a in at if a.size != self.robot.n_joints]:
            raise InputError(f"a state holds {wrong[0]} values; expected {self.robot.n_joints} of q, dq and ddq each")
        now = Readings(self.readings.offset, self.readings.gain)
        return np.asarray(predict_acting(changed, law, now, at[0], at[1], at[2])[0])

    def turning(
        self,
        q: Array,
        dq: Array,
        ddq: Array,
        speed: float,
        joints: Sequence[int],
        time: Array | None = None,
        began: float | None = None,
    ) -> tuple[Array, Array]:
        """Recorded torques (T, k) [N m] of ``joints`` if each alone went forward and backward at ``speed`` [rad/s], by
        its effects, and for the rest of them as all moves in one run: their middle, and half their distance.

        Friction holds the second at rest, all of it: a sign that turns over slowly in motion has turned over here, and
        a partner that rests may be about to go either way, too.
        """
        rigid = self.completed_robot.inverse_dynamics(np.asarray(q, float) + self.readings.offset, dq, ddq)
        middle, half = np.zeros((2, *rigid.shape))
        rests = np.abs(dq) < speed
        for j in joints:
            law = self._sharp(j)
            low, high = np.full(len(rigid), np.inf), np.full(len(rigid), -np.inf)
            for partners in (speed, -speed):
                there = np.where(rests, partners, dq)
                for own in (speed, -speed):
                    there[:, j] = own
                    torque = acting_torques(
                        self.completed_robot, law, self.readings, q, there, ddq, time, rigid, began
                    )[1][:, j]
                    low, high = np.minimum(low, torque), np.maximum(high, torque)
            middle[:, j], half[:, j] = 0.5 * (low + high), 0.5 * (high - low)
        return self.recorded(middle, time)[:, joints], self.recorded(half, time)[:, joints]

    def _sharp(self, joint: int) -> StateTorque:
        """The torque of the effects that act on ``joint``, with signs that turn over at once."""
        own = []
        for effect in self._everywhere:
            kind = family(effect.effect)
            if kind.has_law and joint in (row for row, _ in kind.rows(self.robot, effect.term(self.robot))):
                own.append(replace(effect, settings={k: v for k, v in effect.settings.items() if k != WIDTH}))
        return with_effects(self.robot, own)[1]

    @cached_property
    def _momentary(self) -> tuple[Robot, StateTorque]:
        return with_effects(self.robot, self._everywhere)

    def load_derivative(self, q: Array, dq: Array, ddq: Array) -> Array:
        """How much the effects' torque grows with the rigid-body torque, (T, n): friction that follows the load."""
        robot, torque = self._acting
        rigid = robot.inverse_dynamics(q, dq, ddq)
        step = 1e-6 * np.maximum(np.abs(rigid), 1.0)
        still = np.zeros(len(q))
        up, down = (torque(q, dq, rigid + sign * step, ddq, still) for sign in (1, -1))
        return np.asarray((up - down) / (2 * step))

    def extrapolation_warnings(self, dq: Array) -> list[str]:
        """A line for every joint whose viscous terms would drive it at speeds within ``dq`` (T, n) [rad/s].

        They oppose the motion at all speeds the model was fitted on; beyond, a polynomial goes where it likes.
        """
        lines = []
        for j, name in enumerate(self.robot.joint_names):
            terms = [
                (power, x)
                for term, own in self._places()
                if term.joint == j
                for power, x in zip(term.family().viscous_powers, own, strict=False)
            ]
            speeds = np.linspace(0.0, np.abs(dq[:, j]).max(), 200)[1:]
            driven = sum((x * speeds ** (power - 1) for power, x in terms), np.zeros_like(speeds)) < -1e-9
            if driven.any():
                lines.append(
                    f"{name} moves at up to {speeds[-1]:.3g} rad/s, faster than where its friction was fitted: from "
                    f"{speeds[driven][0]:.3g} rad/s on the model's viscous friction would drive it; fit on faster runs"
                )
        return lines

    def _places(self) -> list[tuple[Term, Array]]:
        """Term and coordinates of every effect."""
        placed = [(e.term(self.robot), e) for e in self.effects]
        return [(term, term.family().coordinates_of(e.parameters, self.robot, term)) for term, e in placed]

    def adding(self, effects: Iterable[Effect]) -> Model:
        """A model with ``effects`` appended."""
        return Model(self.robot, (*self.effects, *effects))

    def with_inactive(self, effects: Iterable[Effect]) -> Model:
        """The same model that also lists ``effects`` without letting them act."""
        return replace(self, inactive=tuple(effects))

    def with_misfit(self, misfit: Iterable[float], cutoff: float | None = None) -> Model:
        """The same model with its error on held-out runs, (n,) [N m], below ``cutoff`` [Hz] where that was lowered."""
        return replace(self, misfit=tuple(float(v) for v in misfit), cutoff=cutoff)

    def save(self, path: str | os.PathLike[str]) -> None:
        """See :func:`save_model`."""
        save_model(path, self)

    @classmethod
    def load(cls, path: str | os.PathLike[str], robot: Robot) -> Model:
        """See :func:`load_model`."""
        return load_model(path, robot)


def effect_to_json(effect: Effect, slides: Collection[str] = ()) -> dict[str, Any]:
    """One entry of ``effects`` in model.json and diagnosis.json; ``slides`` are the prismatic joints.

    A parameter keyed ``"joint/name"`` (one body a link) becomes name and joint.
    """
    kind = family(effect.effect)
    own = effect.joints[0] if effect.joints else None
    entries = []
    for key in kind.published(effect.settings):
        joint, name = split_key(key)
        error = effect.std_errors.get(key)
        entries.append(
            {
                "name": name,
                "joint": own if joint is None else joint,
                "value": float(effect.parameters[key]),
                "std_error": None if error is None else float(error),
                "unit": unit_of(effect, key, slides),
            }
        )
    return {
        "effect": effect.effect,
        "joints": list(effect.joints),
        "settings": json.loads(json.dumps(dict(effect.settings))),
        "parameters": entries,
    }


#: The schema of model.json and diagnosis.json that is written; older ones are read.
SCHEMA = 2
#: No number of a robot, in SI units, is as large.
LARGEST = 1e9
#: Names in files that version 0.1 wrote.
_OLD_SETTINGS = {"sign_travel": "sign_displacement"}


def effect_from_json(entry: Mapping[str, Any]) -> Effect:
    """Inverse of :func:`effect_to_json`."""
    values, errors = {}, {}
    for p in entry["parameters"]:
        key = p["name"] if p["joint"] is None or entry["joints"] else f"{p['joint']}/{p['name']}"
        values[key] = float(p["value"])
        if p["std_error"] is not None:
            errors[key] = float(p["std_error"])
    settings = {_OLD_SETTINGS.get(name, name): value for name, value in entry["settings"].items()}
    return Effect(entry["effect"], tuple(entry["joints"]), values, settings, errors)


def load_schema(name: str) -> dict[str, Any]:
    """A JSON schema shipped beside this module."""
    return dict(json.loads(files("hybrid_dynamics.loop").joinpath(f"{name}.schema.json").read_text(encoding="utf-8")))


@cache
def _validator(name: str) -> Any:
    schema = load_schema(name)
    return jsonschema.validators.validator_for(schema)(schema)


def check_schema(value: Any, name: str) -> None:
    """Raise ``jsonschema.ValidationError`` where ``value`` breaks the schema ``name`` (a test checks the schema itself:
    at run time that takes longer than everything else about it)."""
    error = jsonschema.exceptions.best_match(_validator(name).iter_errors(value))
    if error is not None:
        raise error


def save_model(path: str | os.PathLike[str], model: Model, record: Mapping[str, Any] | None = None) -> None:
    """Write ``model.json``: names and numbers only, with the dynamics of the robot it was made for.

    ``record`` holds the optional blocks ``provenance`` and ``uncertainty``.
    """
    value = {
        "schema": 2,
        "robot": model.robot.name,
        "joints": list(model.robot.joint_names),
        "effects": [
            *({**effect_to_json(e, model.robot.prismatic), "active": True} for e in model.effects),
            *({**effect_to_json(e, model.robot.prismatic), "active": False} for e in model.inactive),
        ],
        **identity_of(model.robot),
        **(record or {}),
    }
    if model.misfit is not None:
        value["misfit"] = list(model.misfit)
    if model.cutoff is not None:
        value["cutoff"] = model.cutoff
    check_schema(value, "model")
    write_text(path, json_text(value))


def read_model(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The content of ``model.json``, checked against its schema; :class:`InputError` says what is wrong with it."""
    value = read_json(path, "the model.json that close-loop wrote")
    refuse_newer(value, path)
    try:
        check_schema(value, "model")
    except jsonschema.ValidationError as error:
        where = "/".join(str(p) for p in error.absolute_path) or "top level"
        message = error.message if len(error.message) <= 200 else f"{error.message[:197]}..."
        raise InputError(f"{path}: {where}: {message}; give the model.json that close-loop wrote") from None
    return dict(value)


def refuse_newer(value: Any, path: str | os.PathLike[str]) -> None:
    """Raise :class:`InputError` where the file ``path`` holds a ``value`` of a schema that came after this version."""
    schema = value.get("schema") if isinstance(value, dict) else None
    if isinstance(schema, int) and not isinstance(schema, bool) and schema > SCHEMA:
        raise InputError(
            f"{path}: has schema {schema}, written by a newer version; this one reads up to {SCHEMA}: update "
            "hybrid-dynamics, or run close-loop again"
        )


def load_model(path: str | os.PathLike[str], robot: Robot) -> Model:
    """Read ``model.json`` for ``robot``; :class:`InputError` says what does not fit, another robot by what differs.

    >>> from hybrid_dynamics import Model, Robot, load_model
    >>> robot = Robot.from_urdf("robot.urdf")
    >>> Model(robot).save("nothing_added.json")
    >>> load_model("nothing_added.json", robot).effects
    ()
    """
    value = read_model(path)
    if tuple(value["joints"]) != robot.joint_names:
        raise InputError(
            f"{path}: made for joints {', '.join(value['joints'])}; the robot has {', '.join(robot.joint_names)}; "
            "give the URDF the model was made with (--lock as then), or run close-loop for this robot"
        )
    check_identity(value, robot, path)
    try:
        active, inactive = (
            tuple(effect_from_json(e) for e in value["effects"] if e.get("active", True) is kept)
            for kept in (True, False)
        )
        misfit = value.get("misfit")
        if misfit is not None and len(misfit) != robot.n_joints:
            raise InputError(f"misfit holds {len(misfit)} numbers; expected {robot.n_joints}, one a joint")
        model = Model(robot, active, inactive, None if misfit is None else tuple(misfit), value.get("cutoff"))
        _check_physics(model)
        _ = model.completed_robot
    except HybridDynamicsError as error:
        raise InputError(f"{path}: {error}; give the model.json that close-loop wrote") from None
    return model


def _check_physics(model: Model) -> None:
    """Raise :class:`InputError` for what physics forbids, such as friction that drives.

    A later effect may lessen an earlier one at the same place: their sum counts.
    """
    for effect in (*model.effects, *model.inactive):
        for key, value in effect.parameters.items():
            if abs(value) > LARGEST:
                where = effect.joints[0] if effect.joints else "the robot"
                raise InputError(
                    f"effect {effect.effect} of {where}: {key} = {value:g}; expected less than {LARGEST:g}"
                )
        if forbidden := family(effect.effect).forbidden(effect.parameters, effect.settings):
            shown = ", ".join(f"{k} = {v:g}" for k, v in effect.parameters.items())
            raise InputError(f"effect {effect.effect} of {', '.join(effect.joints)}: {shown}; {forbidden}")
    sums: dict[Term, Array] = {}
    for term, own in model._places():
        # What is estimated beside the names (held) and what is named stand at one place.
        sums[term.as_finding] = sums.get(term.as_finding, np.zeros(len(own))) + own
    for term, total in sums.items():
        kind = term.family()
        if np.any(total < kind.lower_bounds(model.robot, term) - 1e-9):
            where = "the robot" if term.joint is None else model.robot.joint_names[term.joint]
            shown = ", ".join(f"{k} = {v:g}" for k, v in kind.parameters_of(total, model.robot, term).items())
            raise InputError(f"effect {term.effect} of {where}: {shown}; expected {kind.admissible(term)}, all in all")
