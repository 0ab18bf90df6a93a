"""Known effects added to recorded logs: real noise, real misfit, and an answer that is known.

    tau' = tau + effect(q, dq, ddq)

with the motion of the log at the loop's bandwidth. As with the blind cases, what was added is kept where only the
score reads it. Asked is the model calibrated on other runs of the arm. Case ``..._000`` holds nothing: what is named
there is named for another reason.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from hybrid_dynamics.effects import Effect, Motion, Term, family
from hybrid_dynamics.errors import InputError, require
from hybrid_dynamics.loop.model import Model, effect_from_json, effect_to_json
from hybrid_dynamics.loop.process import ProcessSettings, Run, derivative, process
from hybrid_dynamics.loop.speeds import own_speeds
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.references import derive_seed
from hybrid_dynamics.study.plausible import plausible
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: Places and directions that are drawn until one is plausible in the size that is asked for.
_DRAWS = 30
#: Effect and joints.
Place = tuple[str, tuple[str, ...]]

#: Columns of ``added.csv``.
COLUMNS = (
    "case",
    "dataset",
    "hidden",
    "hidden_joints",
    "size_over_floor",
    "named",
    "named_joints",
    "detected",
    "named_right",
    "others",
    "others_without",
    "parameter",
    "true",
    "found",
    "std_error",
    "verdict",
    "rmse_before",
    "rmse_after",
)
FAMILIES = (
    "viscous_friction",
    "coulomb_friction",
    "torque_offset",
    "joint_spring",
    "torque_gain",
    "payload",
    "armature",
)


@dataclass(frozen=True)
class AddedSettings:
    """``families`` are added one at a time, each in sizes ``sizes`` [noise floors of the joint], ``repeats`` times."""

    families: tuple[str, ...] = FAMILIES
    sizes: tuple[float, ...] = (0.5, 1.0, 3.0, 10.0)
    repeats: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        for name in self.families:
            family(name)
        require(
            len(self.sizes) > 0 and all(0 < size <= 1000 for size in self.sizes),
            f"added.sizes is {list(self.sizes)}; expected one or more values from 0 to 1000 noise floors",
        )
        require(1 <= self.repeats <= 1000, f"added.repeats is {self.repeats}; expected 1 to 1000")


@dataclass(frozen=True)
class AddedCase:
    """``name`` says nothing of the content; ``truth`` (JSON values) must stay where only the score reads it."""

    name: str
    logs: tuple[Trajectory, ...]
    truth: dict[str, Any]


def generate_added(
    robot: Robot, base: Model, logs: Sequence[Trajectory], floor: Array, settings: AddedSettings, name: str
) -> Iterator[AddedCase]:
    """All cases of one arm: ``logs`` as they are (number 0), then with one effect each, in random order.

    ``base`` is the model calibrated on other runs, ``floor`` (n,) [N m] its noise floor.
    """
    plan = [(f, s) for f in settings.families for s in settings.sizes for _ in range(settings.repeats)]
    order = np.random.default_rng(derive_seed("added", settings.seed, name)).permutation(len(plan))
    yield AddedCase(f"{name}_000", tuple(logs), _truth(f"{name}_000", name, (), 0.0))
    for number, k in enumerate(order, 1):
        hidden, size = plan[k]
        rng = np.random.default_rng(derive_seed("added case", settings.seed, name, int(k)))
        effect = draw_added(robot, base, hidden, logs, floor, size, rng)
        case = f"{name}_{number:03d}"
        yield AddedCase(case, tuple(add_effects(base, [effect], logs)), _truth(case, name, (effect,), size))


def draw_added(
    robot: Robot,
    base: Model,
    hidden: str,
    logs: Sequence[Trajectory],
    floor: Array,
    size: float,
    rng: np.random.Generator,
    process_settings: ProcessSettings | None = None,
) -> Effect:
    """A random effect of the family ``hidden`` whose torque, smoothed as the loop does, has ``size`` floors.

    The root mean square over all rows of ``logs``, on the joint where it is largest against its ``floor`` (n,) [N m].
    """
    runs = [process(log, robot, process_settings or ProcessSettings()) for log in logs]
    moving = np.any([run.mask.sum(axis=0) >= 20 for run in runs], axis=0) & (floor > 0)
    if not moving.any():
        raise InputError(f"{hidden}: no joint moves in the logs it should be added to; give logs in motion")
    kind = family(hidden)
    for _ in range(_DRAWS):
        term = kind.draw_term(robot, moving, rng)
        direction = kind.draw(robot, term, rng)
        scale = 1.0
        for _ in range(12):
            # Not every torque is proportional to its coordinates (a spring's rest position): iterate on the size.
            now = _size(base, _effect(robot, term, direction * scale), runs, floor)
            if not now > 0:
                break
            if abs(now / size - 1) < 1e-3:
                if plausible(robot, [effect := _effect(robot, term, direction * scale)]):
                    return effect
                break
            scale *= size / now
    raise InputError(
        f"{hidden}: nowhere has a plausible one {size:g} noise floors on the motion of these logs; give other logs"
    )


def add_effects(base: Model, effects: Sequence[Effect], logs: Sequence[Trajectory]) -> list[Trajectory]:
    """``logs`` with the torque that ``effects`` add to ``base`` at the log's own motion.

    The log's torque stays in full, its noise and all that ``base`` misses included. A gain multiplies it.
    """
    out = []
    for log in logs:
        q, dq, ddq = motion_of(log)
        out.append(log.with_signals(tau=log["tau"] + _torque(base, effects, q, dq, ddq, log.time, log["tau"])))
    return out


def motion_of(log: Trajectory, settings: ProcessSettings | None = None) -> tuple[Array, Array, Array]:
    """``q dq ddq`` (T, n) of a log at the loop's bandwidth, filtered as :func:`process` does, every row kept.

    The speeds are those that the loop would take (:mod:`~hybrid_dynamics.loop.speeds`)."""
    settings = settings or ProcessSettings()
    (log,), _ = own_speeds([log], settings)
    low_pass = butter(4, min(settings.cutoff, settings.cutoff_share / log.dt), fs=1 / log.dt, output="sos")
    q = sosfiltfilt(low_pass, log["q"], axis=0)
    dq = sosfiltfilt(low_pass, log["dq"], axis=0) if "dq" in log else derivative(q, log.dt)
    return q, dq, derivative(dq, log.dt)


def _torque(
    base: Model, effects: Sequence[Effect], q: Array, dq: Array, ddq: Array, time: Array, recorded: Array
) -> Array:
    gains = [effect for effect in effects if effect.effect == "torque_gain"]
    others = [effect for effect in effects if effect.effect != "torque_gain"]
    more = base.adding(others).predict(q, dq, ddq, time) - base.predict(q, dq, ddq, time)
    factor = np.ones(base.robot.n_joints)
    for effect in gains:
        joint = effect.joint_index(base.robot)
        factor[slice(None) if joint is None else joint] *= effect.parameters["gain"]
    return np.asarray(factor * (recorded + more) - recorded)


def _effect(robot: Robot, term: Term, x: Array) -> Effect:
    joints = () if term.joint is None else (robot.joint_names[term.joint],)
    return Effect(term.effect, joints, term.family().parameters_of(x, robot, term), term.options)


def _size(base: Model, effect: Effect, runs: Sequence[Run], floor: Array) -> float:
    square, count = np.zeros(len(floor)), 0
    for run in runs:
        motion: Motion = run.motion
        own = base.predict(motion.q, motion.dq, motion.ddq, motion.time)
        torque = run.smooth(_torque(base, [effect], motion.q, motion.dq, motion.ddq, motion.time, own))
        square += (torque**2).sum(axis=0)
        count += len(torque)
    rms = np.sqrt(square / count)
    return float((rms[floor > 0] / floor[floor > 0]).max())


def _truth(case: str, dataset: str, effects: Sequence[Effect], size: float) -> dict[str, Any]:
    return {"case": case, "dataset": dataset, "effects": [effect_to_json(e) for e in effects], "size_over_floor": size}


def score_added(truth: Mapping[str, Any], diagnosis: Mapping[str, Any], control: Mapping[str, Any]) -> dict[str, Any]:
    """One row of ``added.csv``: ``diagnosis`` of the log with the effect, ``control`` of the same log without.

    ``detected``: something is named that is not named without it, or there with another value beyond two standard
    errors. ``named_right``: family and joint, or what the diagnosis itself says cannot be told from it. ``others``:
    how many further names there are; ``others_without``: how many of them stand there without anything added as well.
    ``parameter``: the one with the largest deviation in standard errors, its true and found value; found counts from
    the starting model, less what is found without anything added.
    """
    hidden = [(e["effect"], tuple(e["joints"])) for e in truth["effects"]]
    named = {(e["effect"], tuple(e["joints"])): e for e in diagnosis["effects"] if e.get("confirmed", True)}
    before = {(e["effect"], tuple(e["joints"])): e for e in control["effects"] if e.get("confirmed", True)}
    right = [key for key in named if any(_stands_for(key, named[key], h) for h in hidden)]
    others = [key for key in named if key not in right]
    row: dict[str, Any] = {
        "case": truth["case"],
        "dataset": truth["dataset"],
        "hidden": " ".join(h[0] for h in hidden),
        "hidden_joints": " ".join((h[1] or ("-",))[0] for h in hidden),
        "size_over_floor": truth["size_over_floor"],
        "named": " ".join(key[0] for key in named),
        "named_joints": " ".join((key[1] or ("-",))[0] for key in named),
        "detected": any(_changed(named[key], before.get(key)) for key in named),
        "named_right": bool(hidden) and bool(right) and any(_changed(named[k], before.get(k)) for k in right),
        "others": len(others),
        "others_without": sum(key in before for key in others),
        "parameter": "",
        "true": None,
        "found": None,
        "std_error": None,
        "verdict": diagnosis["verdict"],
        "rmse_before": _pooled(diagnosis, "before"),
        "rmse_after": _pooled(diagnosis, "after"),
    }
    worst = -1.0
    for entry in truth["effects"]:
        key = (entry["effect"], tuple(entry["joints"]))
        if key not in named:
            continue
        kind = effect_from_json(entry)
        found, own = _values(named[key]), _values(before[key]) if key in before else {}
        for name, value in kind.parameters.items():
            if name not in found or not found[name][1]:
                continue
            neutral = 1.0 if name == "gain" else 0.0
            less = own.get(name, (neutral, 0.0))
            change = found[name][0] - less[0] + neutral
            error = math.hypot(found[name][1] or 0.0, less[1] or 0.0)
            off = abs(change - value) / error
            if off > worst:
                worst = off
                row |= {"parameter": name, "true": value, "found": change, "std_error": error}
    return row


def _stands_for(key: Place, entry: Mapping[str, Any], hidden: Place) -> bool:
    """Whether the entry is the hidden effect, or says of itself that it cannot be told from it."""
    if key == hidden:
        return True
    alternatives = [other["effects"] for other in entry.get("indistinguishable_from", [])]
    return any(
        len(effects) == 1 and (effects[0]["effect"], tuple(effects[0]["joints"])) == hidden for effects in alternatives
    )


def _values(entry: Mapping[str, Any]) -> dict[str, tuple[float, float | None]]:
    return {p["name"]: (p["value"], p["std_error"]) for p in entry["parameters"]}


def _changed(entry: Mapping[str, Any], before: Mapping[str, Any] | None) -> bool:
    if before is None:
        return True
    old = _values(before)
    for name, (value, error) in _values(entry).items():
        was, was_error = old.get(name, (0.0, 0.0))
        if abs(value - was) > 2 * math.hypot(error or 0.0, was_error or 0.0):
            return True
    return False


def _pooled(diagnosis: Mapping[str, Any], when: str) -> float:
    return float(np.sqrt(np.mean(np.square(diagnosis["error"]["test"][when]["rmse"]))))
