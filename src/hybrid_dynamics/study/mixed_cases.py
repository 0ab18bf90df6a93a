"""Blind cases of the own engine with any family of the catalogue, one to four at once, on logs of any kind."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import count
from typing import Any

import numpy as np

from hybrid_dynamics.effects import Effect, Motion, Term, family
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop.model import effect_to_json
from hybrid_dynamics.loop.process import derivative
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.controller import ControllerSettings, make_controller
from hybrid_dynamics.simulation.dataset import run_until_accepted
from hybrid_dynamics.simulation.planted import planted, sensors_for
from hybrid_dynamics.simulation.references import Reference, derive_seed, multi_sine
from hybrid_dynamics.simulation.rollout import SimulationSettings
from hybrid_dynamics.simulation.sensors import SensorSettings, record
from hybrid_dynamics.study.alone import alone, flat_columns
from hybrid_dynamics.study.blind import COUNTS, BlindCase, BlindSettings
from hybrid_dynamics.study.blind_logs import (
    VELOCITY_NOISE,
    LogSettings,
    log_settings,
    measured_level,
    noise_level,
    noisy,
)
from hybrid_dynamics.study.plausible import plausible
from hybrid_dynamics.types import Array

#: States of a planned motion from which sizes are drawn, about.
_ROWS = 2000
#: Draws of places and directions until sizes are physical and plausible.
_DRAWS = 200
#: Sets of effects that are drawn until one can be simulated.
_SIMULATIONS = 6
#: Share of an effect's torque that the others drawn with it must not be able to make.
_OWN_SHARE = 0.2
#: Slowest control loop [Hz]: a slower log takes every so many periods.
_CONTROL_RATE = 500.0


def plan_mixed(robot: Robot, settings: BlindSettings) -> list[tuple[str, ...]]:
    """Families of every case: all equally often; and cases in which nothing is hidden, in random order."""
    rng = np.random.default_rng(derive_seed("mixed plan", settings.seed, robot.name))
    names = list(settings.families)
    counts = rng.choice(COUNTS, size=settings.mixed)
    order = [names[k] for _ in range(int(counts.sum()) // len(names) + 2) for k in rng.permutation(len(names))]
    cases: list[tuple[str, ...]] = [()] * settings.bare
    for number in counts:
        own, order = order[:number], order[number:]
        cases.append(tuple(own))
    return [cases[k] for k in rng.permutation(len(cases))]


def generate_mixed(robot: Robot, settings: BlindSettings) -> Iterator[BlindCase]:
    """All such cases of one robot; same settings, same bytes."""
    for number, hidden in enumerate(plan_mixed(robot, settings), 1):
        yield make_mixed(robot, hidden, settings, f"{robot.name}_x{number:03d}")


def make_mixed(
    robot: Robot, hidden: Sequence[str], settings: BlindSettings, name: str, log: LogSettings | None = None
) -> BlindCase:
    """One case: effects of the ``hidden`` families, simulated under control; ``log`` is drawn where it is not given."""
    rng = np.random.default_rng(derive_seed("mixed case", settings.seed, name))
    log = log or log_settings(settings, rng)
    every = max(int(np.ceil(_CONTROL_RATE / log.rate)), 1)
    period = 1.0 / (log.rate * every)
    total = log.train + log.test

    def draw(rollout: int, attempt: int) -> Reference:
        seed = derive_seed("mixed run", settings.seed, name, rollout, attempt)
        return multi_sine(robot, log.reference, log.duration, period, seed)

    floor = noise_level(log, robot.effort_limits)
    motions = [planned(robot, draw(k, 0), period, _ROWS // log.train) for k in range(log.train)]
    simulation = SimulationSettings(log.duration, period, min(settings.substep, period), lockstep=total, attempts=5)
    for attempt in count(1):
        effects, sizes = draw_mixed(robot, hidden, motions, floor, settings, rng)
        changed, acting = planted(robot, effects)
        controller = make_controller(robot, ControllerSettings(), period, (changed,))
        try:
            done = run_until_accepted(list(range(total)), draw, changed, controller, simulation, acting)
            break
        except InputError:
            # No controller holds a light wrist that something starts at once: other effects of the same families.
            if attempt == _SIMULATIONS:
                raise
    plain = SensorSettings(
        record_every=every,
        encoder_bits=log.encoder_bits,
        velocity=log.velocity,
        velocity_noise=VELOCITY_NOISE,
    )
    sensors = sensors_for(plain, robot, effects)
    runs, clean = [], []
    for k in range(total):
        split = "train" if k < log.train else "test"
        run = record(done[k], robot, sensors, f"run_{k + 1}", split, derive_seed("mixed", settings.seed, name))
        noise = np.random.default_rng(derive_seed("mixed noise", settings.seed, name, k))
        clean.append(run["tau"])
        runs.append(run.with_signals(tau=noisy(run["tau"], log, robot.effort_limits, noise)))
    if log.noise == "quantised":
        logged = [run["tau"] for run in runs[: log.train]]
        floor = measured_level(clean[: log.train], logged, log, robot.effort_limits)
    truth: dict[str, Any] = {
        "case": name,
        "robot": robot.name,
        "engine": "own",
        "effects": [effect_to_json(e) for e in effects],
        "size_over_floor": min(sizes, default=0.0),
        "sizes": sizes,
        "noise": log.noise,
        "seconds": log.train * log.duration,
        "runs": log.train,
        "rate": log.rate,
        "velocity": log.velocity,
        "true_rmse": floor.tolist(),
    }
    return BlindCase(name, tuple(runs[: log.train]), tuple(runs[log.train :]), truth)


def planned(robot: Robot, reference: Reference, period: float, rows: int) -> Motion:
    """The motion that is asked for, thinned to about ``rows`` states."""
    time: Array = np.arange(len(reference.q), dtype=np.float64) * period
    thin = slice(None, None, max(len(time) // max(rows, 1), 1))
    ddq = derivative(reference.dq, period)
    return Motion(robot, time[thin], reference.q[thin], reference.dq[thin], ddq[thin])


def draw_mixed(
    robot: Robot,
    hidden: Sequence[str],
    motions: Sequence[Motion],
    floor: Array,
    settings: BlindSettings,
    rng: np.random.Generator,
) -> tuple[list[Effect], list[float]]:
    """Random effects, each as large as the size drawn for it, in floors of the torque that the others cannot make.

    Places and sizes are drawn again where that would take values that are not plausible (what is read a tenth of a
    second late) or where one effect can make most of another; with one effect less where that never ends.
    """
    moving = np.ones(robot.n_joints, bool)
    low, high = np.log(settings.smallest), np.log(settings.largest)
    for _ in range(_DRAWS):
        sizes = [float(np.exp(rng.uniform(low, high))) for _ in hidden]
        terms = [family(name).draw_term(robot, moving, rng) for name in hidden]
        directions = [term.family().draw(robot, term, rng) for term in terms]
        if len({term.place for term in terms}) < len(terms):
            continue
        columns = [flat_columns(term, motions, floor) for term in terms]
        scaled = []
        for k, x in enumerate(directions):
            torque = columns[k] @ x
            others = columns[:k] + columns[k + 1 :]
            own, all_of_it = alone(torque, others, robot.n_joints), alone(torque, [], robot.n_joints)
            if own < max(_OWN_SHARE * all_of_it, 1e-12):
                break
            scaled.append(x * sizes[k] / own)
        if len(scaled) < len(terms):
            continue
        effects = [_effect(robot, term, x) for term, x in zip(terms, scaled, strict=True)]
        if plausible(robot, effects):
            return effects, sizes
    if len(hidden) > 1:
        return draw_mixed(robot, hidden[:-1], motions, floor, settings, rng)
    raise InputError(
        f"robot {robot.name}: no plausible {hidden[0]} has {settings.smallest:g} floors or more; "
        "leave it out of families"
    )


def _effect(robot: Robot, term: Term, x: Array) -> Effect:
    joints = () if term.joint is None else (robot.joint_names[term.joint],)
    return Effect(term.effect, joints, term.family().parameters_of(x, robot, term), term.options)
