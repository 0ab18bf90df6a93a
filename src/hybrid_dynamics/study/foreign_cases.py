"""Blind cases from another engine: drawn, sized, logged; the truth beside them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hybrid_dynamics.loop.model import effect_to_json
from hybrid_dynamics.loop.process import ProcessSettings, hann_kernel
from hybrid_dynamics.simulation.references import derive_seed
from hybrid_dynamics.study.blind import BlindCase, BlindSettings
from hybrid_dynamics.study.engine import Engine, Hidden, read_text, robot_of
from hybrid_dynamics.study.foreign import KNOWN, RECIPES, UNKNOWN, scaled
from hybrid_dynamics.study.mujoco_log import LogSettings, coloured, make_mujoco_log, motions_of, read
from hybrid_dynamics.types import Array

#: Of how many hidden causes a case consists (drawn evenly), and the colours, rates and lengths it may have.
_COUNTS = (1, 1, 2, 3, 4)
_NOISES = ("white", "white", "ar1", "lowpass", "quantised")
_RATES = (100.0, 250.0, 500.0, 1000.0)
#: Forms that the catalogue does not have: one in every so many cases holds one of them.
_UNKNOWN_EVERY = 3


def plan_foreign(settings: BlindSettings, robot: str) -> list[tuple[str, ...]]:
    """Names of the recipes of every case: known forms, and in every third one unknown form."""
    rng = np.random.default_rng(derive_seed("foreign plan", settings.seed, robot))
    known = [r.name for r in KNOWN]
    order = [known[k] for _ in range(settings.foreign) for k in rng.permutation(len(known))]
    cases = []
    for k in range(settings.foreign):
        count = int(rng.choice(_COUNTS))
        names = list(dict.fromkeys(order[k * 4 : k * 4 + count]))
        if k % _UNKNOWN_EVERY == _UNKNOWN_EVERY - 1:
            names[0] = UNKNOWN[int(rng.integers(len(UNKNOWN)))].name
        cases.append(tuple(names))
    return cases


def generate_foreign(text: str, settings: BlindSettings) -> Iterator[BlindCase]:
    """All cases of the robot in URDF ``text``; same settings, same numbers."""
    robot = robot_of(read_text(text))
    name = Engine(read_text(text)).robot.name
    for number, recipes in enumerate(plan_foreign(settings, name)):
        yield make_foreign(text, recipes, settings, f"{name}_m{number + 1:03d}", robot.name)


def log_settings(settings: BlindSettings, rng: np.random.Generator) -> LogSettings:
    """How one case is logged: 1 to 6 runs of 5 to 30 s, 30 s of training or more where there are several."""
    train = int(rng.integers(1, 7))
    duration = float(np.round(np.clip(rng.uniform(30, 60) / train, 5.0, 30.0), 1))
    return LogSettings(
        train=train,
        test=max(settings.test, 1),
        duration=duration,
        rate=float(rng.choice(_RATES)),
        noise=str(rng.choice(_NOISES)),
        noise_share=settings.torque_noise_share,
        encoder_bits=settings.encoder_bits,
        velocity=bool(rng.random() < 0.5),
        reference=settings.reference,
    )


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
    for k, recipe in enumerate(recipes):
        size = float(np.exp(rng.uniform(np.log(settings.smallest), np.log(settings.largest))))
        make = RECIPES[recipe].draw(rng)
        joint = int(joints[k])

        def added(h: Hidden) -> Array:
            return (recorded(text, [h], short) - plain) / floor

        cause, _ = scaled(lambda s, make=make, joint=joint: make(robot, joint, s), added, size)  # type: ignore[misc]
        hidden.append(cause)
        sizes.append(size)
    seed = derive_seed("foreign runs", settings.seed, name)
    runs = make_mujoco_log(text, hidden, seed=seed, settings=log)
    effects = [e for r, h in zip(recipes, hidden, strict=True) for e in RECIPES[r].truth(robot, h)]
    unknown = [(r, h) for r, h in zip(recipes, hidden, strict=True) if not RECIPES[r].known]
    truth: dict[str, Any] = {
        "case": name,
        "robot": robot_name,
        "engine": "mujoco",
        "effects": [effect_to_json(e) for e in effects],
        "unknown_forms": [
            {"form": r, "joints": [] if h.joint is None else [robot.joint_names[h.joint]]} for r, h in unknown
        ],
        "size_over_floor": min(sizes, default=0.0),
        "noise": log.noise,
        "seconds": log.train * log.duration,
        "true_rmse": floor.tolist(),
    }
    return BlindCase(name, tuple(runs[: log.train]), tuple(runs[log.train :]), truth)


def recorded(text: str, hidden: Sequence[Hidden], settings: LogSettings) -> Array:
    """Recorded torque (T, n) less what the plain robot needs for the recorded motion: what a model has to add."""
    ((course, tau),) = motions_of(text, hidden, settings, 0)
    robot = robot_of(text)
    signals = read(course, tau, hidden, settings, np.zeros(robot.n_joints), np.random.default_rng(0))
    return np.asarray(signals["tau"] - robot.inverse_dynamics(signals["q"], course.dq, course.ddq))


def noise_level(log: LogSettings, effort: Array) -> Array:
    """Standard deviation (n,) [N m] of the torque noise behind the loop's filter."""
    dt = 1.0 / log.rate
    process = ProcessSettings()
    kernel = hann_kernel(1.0 / min(process.cutoff, process.cutoff_share * log.rate), dt)
    kind = "white" if log.noise == "quantised" else log.noise
    sample = coloured(kind, (20000, 1), dt, log.colour, np.random.default_rng(0))[:, 0]
    share = float(np.convolve(sample, kernel, mode="valid").std()) if kind != "none" else 0.0
    return np.asarray(log.noise_share * effort * share)
