"""Blind cases: effects hidden in simulated logs, and the score of a diagnosis that never saw them.

Three separate functions so that three stages can be kept apart: :func:`generate_blind` writes logs and, elsewhere, the
truth; ``close_loop`` sees URDF and logs only; :func:`score_blind` reads the truth and the diagnosis.
"""

from __future__ import annotations

import csv
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from hybrid_dynamics.effects import Effect, Motion, family
from hybrid_dynamics.errors import require
from hybrid_dynamics.files import atomic_path
from hybrid_dynamics.loop.diagnosis import errors_of, moving_rms
from hybrid_dynamics.loop.model import Model, effect_from_json, effect_to_json
from hybrid_dynamics.loop.process import ProcessSettings, Run, derivative, hann_kernel, process
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.controller import ControllerSettings, make_controller
from hybrid_dynamics.simulation.dataset import run_until_accepted
from hybrid_dynamics.simulation.planted import planted, sensors_for
from hybrid_dynamics.simulation.references import Reference, ReferenceSettings, derive_seed, multi_sine
from hybrid_dynamics.simulation.rollout import SimulationSettings
from hybrid_dynamics.simulation.sensors import SensorSettings, record
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

FIRST_FAMILIES = (
    "viscous_friction",
    "coulomb_friction",
    "torque_offset",
    "armature",
    "payload",
    "link_inertia",
    "gravity_tilt",
)
COLUMNS = (
    "case",
    "robot",
    "engine",
    "hidden",
    "hidden_joints",
    "size_over_floor",
    "named",
    "named_joints",
    "named_right",
    "nothing_wrong_named",
    "verdict",
    "parameter_error",
    "rmse_before",
    "rmse_after",
    "rmse_true_model",
    "noise_floor",
    "joint",
    "rmse_after_all_rows",
    "rmse_true_model_all_rows",
    "floor_over_true_model",
    "noise",
    "seconds",
    "listed",
    "unknown_forms",
)


def _reference() -> ReferenceSettings:
    return ReferenceSettings(velocity_share=0.4, maximum_excursion=2.0, rest=0.3, ramp=1.5)


@dataclass(frozen=True)
class BlindSettings:
    """``single``, ``pairs``, ``nothing``: number of cases per robot; sizes are drawn between ``smallest`` and
    ``largest`` noise floors. Runs of ``duration`` [s] with a control period and log interval of ``period`` [s].
    ``foreign``: further cases from another engine (see :mod:`.foreign_cases`).
    """

    families: tuple[str, ...] = FIRST_FAMILIES
    single: int = 29
    pairs: int = 15
    nothing: int = 20
    foreign: int = 0
    train: int = 4
    test: int = 2
    duration: float = 16.0
    period: float = 2e-3
    substep: float = 5e-4
    smallest: float = 3.0
    largest: float = 12.0
    torque_noise_share: float = 0.003
    encoder_bits: int = 16
    seed: int = 0
    reference: ReferenceSettings = field(default_factory=_reference)

    def __post_init__(self) -> None:
        for name in self.families:
            family(name)
        for name in ("single", "pairs", "nothing", "foreign"):
            require(0 <= getattr(self, name) <= 10000, f"{name} is {getattr(self, name)}; expected 0 to 10000 cases")
        require(self.train >= 1, f"train is {self.train}; expected at least one run")
        require(self.test >= 1, f"test is {self.test}; expected at least one run")
        require(1 <= self.smallest <= self.largest, f"smallest is {self.smallest}; expected 1 <= smallest <= largest")
        require(0 < self.duration <= 600, f"duration is {self.duration}; expected 0 < duration <= 600 s")


@dataclass(frozen=True)
class BlindCase:
    """``name`` says nothing about the content; ``truth`` (JSON values) must stay where only the score may read it."""

    name: str
    train: tuple[Trajectory, ...]
    test: tuple[Trajectory, ...]
    truth: dict[str, Any]


def plan(robot: Robot, settings: BlindSettings) -> list[tuple[str, ...]]:
    """Families hidden in each case, in random order."""
    rng = np.random.default_rng(derive_seed("plan", settings.seed, robot.name))
    singles = [(settings.families[k % len(settings.families)],) for k in range(settings.single)]
    couples = list(combinations(settings.families, 2))
    couples = [couples[k] for k in rng.permutation(len(couples))]
    pairs = [couples[k % len(couples)] for k in range(settings.pairs)]
    cases: list[tuple[str, ...]] = [*singles, *pairs, *[()] * settings.nothing]
    return [cases[k] for k in rng.permutation(len(cases))]


def generate_blind(robot: Robot, settings: BlindSettings) -> Iterator[BlindCase]:
    """All cases of one robot, one after the other; same settings, same bytes."""
    for number, hidden in enumerate(plan(robot, settings)):
        yield make_case(robot, hidden, settings, f"{robot.name}_{number + 1:03d}", number)


def make_case(robot: Robot, hidden: Sequence[str], settings: BlindSettings, name: str, number: int) -> BlindCase:
    """Draw effects of the ``hidden`` families, simulate them under control, log with noise."""
    rng = np.random.default_rng(derive_seed("case", settings.seed, robot.name, number))
    total = settings.train + settings.test

    def draw(rollout: int, attempt: int) -> Reference:
        seed = derive_seed("run", settings.seed, robot.name, number, rollout, attempt)
        return multi_sine(robot, settings.reference, settings.duration, settings.period, seed)

    planned = [draw(k, 0) for k in range(total)]
    effects, size = draw_effects(robot, hidden, planned, settings, rng)
    changed, acting = planted(robot, effects)
    controller = make_controller(robot, ControllerSettings(), settings.period, (changed,))
    simulation = SimulationSettings(settings.duration, settings.period, settings.substep, lockstep=total)
    done = run_until_accepted(list(range(total)), draw, changed, controller, simulation, acting)
    plain = SensorSettings(encoder_bits=settings.encoder_bits, torque_noise_share=settings.torque_noise_share)
    sensors = sensors_for(plain, robot, effects)
    runs = []
    for k in range(total):
        split = "train" if k < settings.train else "test"
        runs.append(record(done[k], robot, sensors, f"run_{k + 1}", split, derive_seed(settings.seed, name)))
    truth = {
        "case": name,
        "robot": robot.name,
        "engine": "own",
        "effects": [effect_to_json(e) for e in effects],
        "size_over_floor": size,
    }
    return BlindCase(name, tuple(runs[: settings.train]), tuple(runs[settings.train :]), truth)


def draw_effects(
    robot: Robot, hidden: Sequence[str], planned: Sequence[Reference], settings: BlindSettings, rng: np.random.Generator
) -> tuple[list[Effect], float]:
    """Random effects, each scaled so that the torque it alone explains has the drawn size; the smallest size drawn."""
    motions = []
    for reference in planned:
        thin = slice(None, None, 5)
        ddq = derivative(reference.dq, settings.period)
        time: Array = np.arange(len(reference.q), dtype=np.float64) * settings.period
        motions.append(Motion(robot, time[thin], reference.q[thin], reference.dq[thin], ddq[thin]))
    cutoff = min(ProcessSettings().cutoff, ProcessSettings().cutoff_share / settings.period)
    kernel = hann_kernel(1.0 / cutoff, settings.period)
    floor = settings.torque_noise_share * robot.effort_limits * np.sqrt(np.sum(kernel**2))
    moving = np.ones(robot.n_joints, bool)
    terms, directions = [], []
    for name in hidden:
        kind = family(name)
        term = kind.draw_term(robot, moving, rng)
        terms.append(term)
        directions.append(kind.draw(robot, term, rng))
    torques = []
    for term, x in zip(terms, directions, strict=True):
        parts = []
        for motion in motions:
            columns = term.family().columns(motion, term)
            tau = np.zeros_like(motion.q)
            if columns.ndim == 3:
                tau += columns @ x
            else:
                tau[:, term.index] += columns @ x
            parts.append(tau)
        torques.append(np.concatenate(parts) / floor)
    effects, sizes = [], []
    for k, (term, x) in enumerate(zip(terms, directions, strict=True)):
        own = torques[k]
        others = [t.ravel() for i, t in enumerate(torques) if i != k]
        if others:
            basis = np.column_stack(others)
            flat = own.ravel()
            own = (flat - basis @ np.linalg.lstsq(basis, flat, rcond=None)[0]).reshape(own.shape)
        alone = float(np.sqrt(np.mean(own**2, axis=0)).max())
        size = float(np.exp(rng.uniform(np.log(settings.smallest), np.log(settings.largest))))
        scaled = x * size / alone
        joints = () if term.joint is None else (robot.joint_names[term.joint],)
        values = term.family().parameters_of(scaled, robot, term)
        effects.append(Effect(term.effect, joints, values, dict(term.settings)))
        sizes.append(size)
    return effects, min(sizes, default=0.0)


def true_model(robot: Robot, truth: Mapping[str, Any]) -> Model:
    """The model that the truth describes."""
    return Model(robot, tuple(effect_from_json(e) for e in truth["effects"]))


def score_blind(
    truth: Mapping[str, Any],
    diagnosis: Mapping[str, Any],
    robot: Robot,
    train: Sequence[Trajectory],
    test: Sequence[Trajectory],
    settings: ProcessSettings | None = None,
) -> dict[str, Any]:
    """One row of ``blind.csv``: what was named and confirmed, and the model without what was not.

    Errors are those of the joint whose error after is largest against the true model's.
    The noise floor is compared with the true model's error on the training runs it was estimated from: the worst joint
    counts.

    ``parameter_error`` is the largest relative error of the hidden effects (see :func:`parameter_errors`), None where
    they were not all named.
    """
    runs = [process(t, robot, settings or ProcessSettings()) for t in test]
    own = [process(t, robot, settings or ProcessSettings()) for t in train]
    confirmed = [e for e in diagnosis["effects"] if e["confirmed"]]
    hidden, named = _pairs(truth["effects"]), _pairs(confirmed)
    # Counted: a joint may have two harmonics.
    right = Counter(hidden) <= Counter(named)
    clean = Counter(named) <= Counter(hidden)
    unknown = truth.get("unknown_forms", [])
    listed = {n for e in confirmed for a in e["indistinguishable_from"] for n in _pairs(a["effects"])}
    model = true_model(robot, truth)
    exact, exact_all = moving_rms(model, runs), np.array(errors_of(model, runs)["rmse"])
    after = np.array(diagnosis["error_moving"]["test"]["after_confirmed"]["rmse"])
    before = np.array(diagnosis["error_moving"]["test"]["before"]["rmse"])
    after_all = np.array(diagnosis["error"]["test"]["after_confirmed"]["rmse"])
    floor = np.array(diagnosis["noise_floor"])
    ratio = floor / np.maximum(moving_rms(model, own), 1e-12)
    if unknown:  # no model of ours is the true one: the noise alone is what it would leave
        exact = exact_all = np.array(truth["true_rmse"])
        ratio = floor / np.maximum(exact, 1e-12)
    worst = int(np.argmax(after / np.maximum(exact, 1e-12)))
    errors = parameter_errors(truth, diagnosis, robot, runs) if right and hidden else []
    return {
        "case": truth["case"],
        "robot": truth["robot"],
        "engine": truth.get("engine", "own"),
        "hidden": " ".join(h[0] for h in hidden),
        "hidden_joints": " ".join((h[1] or ("-",))[0] for h in hidden),
        "size_over_floor": truth["size_over_floor"],
        "named": " ".join(n[0] for n in named),
        "named_joints": " ".join((n[1] or ("-",))[0] for n in named),
        "named_right": right,
        "nothing_wrong_named": clean,
        "verdict": diagnosis["verdict"],
        "parameter_error": max(errors) if errors else None,
        "rmse_before": before[worst],
        "rmse_after": after[worst],
        "rmse_true_model": exact[worst],
        "noise_floor": floor[worst],
        "joint": robot.joint_names[worst],
        "rmse_after_all_rows": after_all[worst],
        "rmse_true_model_all_rows": exact_all[worst],
        "floor_over_true_model": float(ratio[np.argmax(np.abs(np.log(np.maximum(ratio, 1e-12))))]),
        "noise": truth.get("noise", "white"),
        "seconds": truth.get("seconds", sum(t.time[-1] - t.time[0] for t in train)),
        "listed": all(h in named or h in listed for h in hidden),
        "unknown_forms": " ".join(u["form"].replace(" ", "_") for u in unknown),
    }


def _pairs(entries: Sequence[Mapping[str, Any]]) -> list[tuple[str, tuple[str, ...]]]:
    """Family and joints of every entry."""
    return [(e["effect"], tuple(e["joints"])) for e in entries]


def parameter_errors(
    truth: Mapping[str, Any], diagnosis: Mapping[str, Any], robot: Robot, runs: Sequence[Run]
) -> list[float]:
    """Relative error of every hidden effect: the largest of its parameters, see :meth:`Family.parameter_error`."""
    out = []
    motions = [run.motion for run in runs]
    named = [effect_from_json(e) for e in diagnosis["effects"] if e["confirmed"]]
    for entry in truth["effects"]:
        true = effect_from_json(entry)
        kind = family(true.effect)
        alike = [e for e in named if (e.effect, e.joints) == (true.effect, true.joints)]
        # Of two harmonics of one joint the nearer one is meant.
        out.append(min(max(kind.parameter_error(true, found, robot, motions).values()) for found in alike))
    return out


def write_blind(path: str | os.PathLike[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write ``blind.csv``: numbers with six significant digits, booleans as true/false."""

    def text(value: Any) -> str:
        if value is None:
            return ""
        if isinstance(value, bool | np.bool_):
            return "true" if value else "false"
        return f"{value:.6g}" if isinstance(value, float | np.floating) else str(value)

    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for row in rows:
            writer.writerow([text(row[c]) for c in COLUMNS])


__all__ = [
    "COLUMNS",
    "FIRST_FAMILIES",
    "BlindCase",
    "BlindSettings",
    "draw_effects",
    "generate_blind",
    "make_case",
    "parameter_errors",
    "plan",
    "score_blind",
    "true_model",
    "write_blind",
]
