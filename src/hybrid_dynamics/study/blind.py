"""Blind cases: effects of the catalogue hidden in simulated logs, and how many cases a study has.

Three stages are kept apart: one writes logs and, elsewhere, the truth; ``close_loop`` sees URDF and logs only;
:mod:`.blind_score` reads the truth and the diagnosis. Here cases of few families, all logged alike; in
:mod:`.mixed_cases` any family on logs of any kind; in :mod:`.foreign_cases` those of another engine.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from hybrid_dynamics.effects import Effect, Motion, family
from hybrid_dynamics.errors import require
from hybrid_dynamics.loop.model import effect_to_json
from hybrid_dynamics.loop.process import ProcessSettings, derivative, hann_kernel
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
#: Of how many hidden causes a case consists, drawn evenly.
COUNTS = (1, 1, 2, 3, 4)


def _reference() -> ReferenceSettings:
    return ReferenceSettings(velocity_share=0.4, maximum_excursion=2.0, rest=0.3, ramp=1.5)


@dataclass(frozen=True)
class BlindSettings:
    """``single``, ``pairs``, ``nothing``: number of cases per robot; sizes are drawn between ``smallest`` and
    ``largest`` noise floors. Runs of ``duration`` [s] with a control period and log interval of ``period`` [s].

    Further cases have one to four causes, and a length, rate and noise that are drawn (``blind_logs.log_settings``;
    with ``short_logs`` short ones, too): ``mixed`` of any of the families (:mod:`.mixed_cases`); ``foreign`` from
    another engine (:mod:`.foreign_cases`), of which ``unknown`` hold a form that the catalogue does not have; ``bare``
    of either engine in which nothing is missing.
    """

    families: tuple[str, ...] = FIRST_FAMILIES
    single: int = 29
    pairs: int = 15
    nothing: int = 20
    mixed: int = 0
    foreign: int = 0
    unknown: int = 0
    bare: int = 0
    short_logs: bool = False
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
        for name in ("single", "pairs", "nothing", "mixed", "foreign", "unknown", "bare"):
            require(0 <= getattr(self, name) <= 10000, f"{name} is {getattr(self, name)}; expected 0 to 10000 cases")
        require(
            self.unknown <= self.foreign,
            f"unknown is {self.unknown}; expected at most the number of foreign cases ({self.foreign})",
        )
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


__all__ = [
    "COUNTS",
    "FIRST_FAMILIES",
    "BlindCase",
    "BlindSettings",
    "draw_effects",
    "generate_blind",
    "make_case",
    "plan",
]
