"""Blind cases from another engine: drawn, sized, logged; the truth beside them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hybrid_dynamics.loop.model import effect_to_json
from hybrid_dynamics.simulation.references import derive_seed
from hybrid_dynamics.study.blind import COUNTS, BlindCase, BlindSettings
from hybrid_dynamics.study.blind_logs import LogSettings, log_settings, measured_level, noise_level
from hybrid_dynamics.study.engine import Engine, Hidden, read_text, robot_of
from hybrid_dynamics.study.foreign import KNOWN, RECIPES, UNKNOWN, scaled
from hybrid_dynamics.study.mujoco_log import make_mujoco_log, motions_of, read
from hybrid_dynamics.study.plausible import plausible
from hybrid_dynamics.types import Array

#: Draws of size and joint until a cause is plausible; the last one stands.
_DRAWS = 8


def plan_foreign(settings: BlindSettings, robot: str) -> list[tuple[str, ...]]:
    """Names of the recipes of every case: known forms, in ``unknown`` of them one of :data:`UNKNOWN`, and none."""
    rng = np.random.default_rng(derive_seed("foreign plan", settings.seed, robot))
    known = [r.name for r in KNOWN]
    order = [known[k] for _ in range(settings.foreign) for k in rng.permutation(len(known))]
    cases: list[tuple[str, ...]] = []
    for k in range(settings.foreign):
        count = int(rng.choice(COUNTS))
        names = list(dict.fromkeys(order[k * 4 : k * 4 + count]))
        # Evenly spread over the cases.
        if (k + 1) * settings.unknown // settings.foreign > k * settings.unknown // settings.foreign:
            names[0] = UNKNOWN[int(rng.integers(len(UNKNOWN)))].name
        cases.append(tuple(names))
    if settings.bare:
        cases += [()] * settings.bare
        cases = [cases[k] for k in rng.permutation(len(cases))]
    return cases


def generate_foreign(text: str, settings: BlindSettings) -> Iterator[BlindCase]:
    """All cases of the robot in URDF ``text``; same settings, same numbers."""
    robot = robot_of(read_text(text))
    name = Engine(read_text(text)).robot.name
    for number, recipes in enumerate(plan_foreign(settings, name)):
        yield make_foreign(text, recipes, settings, f"{name}_m{number + 1:03d}", robot.name)


def make_foreign(
    text: str,
    recipes: Sequence[str],
    settings: BlindSettings,
    name: str,
    robot_name: str,
    log: LogSettings | None = None,
) -> BlindCase:
    """One case: every recipe on a joint of its own, sized by the torque that it adds to a short motion.

    Without ``log`` its length, rate and noise are drawn (:func:`log_settings`).
    """
    text = read_text(text)
    robot = robot_of(text)
    rng = np.random.default_rng(derive_seed("foreign case", settings.seed, name))
    log = log or log_settings(settings, rng)
    floor = noise_level(log, robot.effort_limits)
    joints = rng.permutation(robot.n_joints)
    short = replace(log, train=1, test=0, duration=min(log.duration, 8.0), noise="none", encoder_bits=0)
    plain = recorded(text, [], short)
    hidden: list[Hidden] = []
    sizes: list[float] = []
    taken: set[tuple[str, tuple[str, ...]]] = set()
    for k, recipe in enumerate(recipes):
        largest = settings.largest
        for attempt in range(_DRAWS):
            size = float(np.exp(rng.uniform(np.log(settings.smallest), np.log(largest))))
            make = RECIPES[recipe].draw(rng)
            # Where the first joint would need what no arm has, another one and less.
            joint = int(joints[(k + attempt) % robot.n_joints])

            def added(h: Hidden) -> Array:
                return (recorded(text, [h], short) - plain) / floor

            cause, _ = scaled(lambda s, make=make, joint=joint: make(robot, joint, s), added, size)  # type: ignore[misc]
            effects = RECIPES[recipe].truth(robot, cause)
            # Two of a kind on one joint are one: a gear is viscous on both of its joints, too.
            own = {(e.effect, e.joints) for e in effects}
            if plausible(robot, effects) and not own & taken:
                break
            largest = max(size, settings.smallest)
        taken |= own
        hidden.append(cause)
        sizes.append(size)
    seed = derive_seed("foreign runs", settings.seed, name)
    runs = make_mujoco_log(text, hidden, seed=seed, settings=log)
    if log.noise == "quantised":
        clean = make_mujoco_log(text, hidden, seed=seed, settings=replace(log, noise="none"))
        plain_tau, logged = ([run["tau"] for run in own[: log.train]] for own in (clean, runs))
        floor = measured_level(plain_tau, logged, log, robot.effort_limits)
    effects = [e for r, h in zip(recipes, hidden, strict=True) for e in RECIPES[r].truth(robot, h)]
    unknown = [(r, h) for r, h in zip(recipes, hidden, strict=True) if not RECIPES[r].known]
    truth: dict[str, Any] = {
        "case": name,
        "robot": robot_name,
        "engine": "mujoco",
        "effects": [effect_to_json(e) for e in effects],
        "unknown_forms": [
            {"form": r, "of": RECIPES[r].of, "joints": [] if h.joint is None else [robot.joint_names[h.joint]]}
            for r, h in unknown
        ],
        "size_over_floor": min(sizes, default=0.0),
        "noise": log.noise,
        "seconds": log.train * log.duration,
        "runs": log.train,
        "rate": log.rate,
        "velocity": log.velocity,
        "sizes": sizes,
        "true_rmse": floor.tolist(),
    }
    return BlindCase(name, tuple(runs[: log.train]), tuple(runs[log.train :]), truth)


def recorded(text: str, hidden: Sequence[Hidden], settings: LogSettings) -> Array:
    """Recorded torque (T, n) less what the plain robot needs for the recorded motion: what a model has to add."""
    ((course, tau),) = motions_of(text, hidden, settings, 0)
    robot = robot_of(text)
    signals = read(course, tau, hidden, settings, np.zeros(robot.n_joints), np.random.default_rng(0))
    return np.asarray(signals["tau"] - robot.inverse_dynamics(signals["q"], course.dq, course.ddq))
