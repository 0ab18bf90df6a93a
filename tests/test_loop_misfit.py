"""What the starting model is off by on other runs makes a change as uncertain as it scatters from run to run."""

import numpy as np
import pytest
from tests.two_links import two_links

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop.augment import model_of
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.process import ProcessSettings, process
from hybrid_dynamics.simulation.excitation import excitation
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

ROBOT = two_links()
VISCOUS, COULOMB = Term("viscous_friction", 1), Term("coulomb_friction", 1)
RIPPLE = Term("torque_ripple", 1, (("harmonic", 9.0),))
#: What was added [N m s/rad]; what the model is off by, and the noise, on the joint [N m].
ADDED, OFF, NOISE = 2.0, 0.5, 0.1


def drifting(log: Trajectory, seed: int) -> Trajectory:
    """``log`` with viscous friction, and with a little of every plain cause: :data:`OFF` in all, new on every run."""
    rng = np.random.default_rng(seed)
    q, dq = log["q"][:, 1], log["dq"][:, 1]
    shapes: list[Array] = [dq, np.sign(dq), np.ones_like(q), np.sin(q)]
    drift = sum(a * s / np.sqrt(np.mean(s**2)) for a, s in zip(rng.standard_normal(4), shapes, strict=True))
    drift *= OFF / np.sqrt(np.mean(drift**2))
    tau = log["tau"] + NOISE * rng.standard_normal(log["tau"].shape)
    tau[:, 1] += ADDED * dq + drift
    return Trajectory(log.name, "train", log.time, {"q": log["q"], "tau": tau})


def change(log: Trajectory, terms: list[Term], misfit: tuple[float, ...] | None) -> Effect:
    run = process(log, ROBOT, ProcessSettings())
    start = Model(ROBOT) if misfit is None else Model(ROBOT).with_misfit(misfit)
    evidence = Evidence.of(start, [run], terms, LoopSettings())
    return model_of(evidence, terms).effects[0]


@pytest.fixture(scope="module")
def motion() -> Trajectory:
    clean = excitation(ROBOT, [], duration=16.0, rate=250.0, torque_noise_share=0.0, encoder_bits=0, seed=1)
    rows = process(clean, ROBOT, ProcessSettings())
    dq = np.column_stack([np.interp(clean.time, rows.time, rows.dq[:, j]) for j in range(2)])
    return Trajectory(clean.name, "train", clean.time, {"q": clean["q"], "dq": dq, "tau": clean["tau"]})


def inside(motion: Trajectory, terms: list[Term], misfit: tuple[float, ...] | None) -> float:
    """Share of 40 runs whose friction lies within two of its standard errors."""
    found = [change(drifting(motion, seed), terms, misfit) for seed in range(40)]
    name = "viscous_coefficient"
    return float(np.mean([abs(e.parameters[name] - ADDED) < 2 * e.std_errors[name] for e in found]))


@pytest.mark.parametrize("terms", [[VISCOUS], [VISCOUS, COULOMB], [VISCOUS, RIPPLE]], ids=["alone", "two", "setting"])
def test_a_change_is_as_uncertain_as_the_start_is_off(motion: Trajectory, terms: list[Term]) -> None:
    # 40 draws of a share of .95: fewer than .85 once in 300.
    assert inside(motion, terms, (OFF, OFF)) >= 0.85


def test_without_what_is_known_of_the_start_it_is_taken_for_surer_than_it_is(motion: Trajectory) -> None:
    # Control: the scatter between blocks of one run does not show what is the same all the run long.
    assert inside(motion, [VISCOUS], None) < 0.6


def test_a_longer_run_does_not_make_it_surer(motion: Trajectory) -> None:
    half = motion.rows(slice(0, len(motion.time) // 2))
    long, short = (change(drifting(log, 0), [VISCOUS], (OFF, OFF)) for log in (motion, half))
    # Noise alone would shrink by the root of two; the motion of the halves differs by a few percent.
    assert long.std_errors["viscous_coefficient"] > 0.85 * short.std_errors["viscous_coefficient"]


def test_a_start_that_is_off_by_no_more_than_the_noise_costs_little(motion: Trajectory) -> None:
    log = drifting(motion, 0)
    known, unknown = change(log, [VISCOUS], (NOISE / 5, NOISE / 5)), change(log, [VISCOUS], None)
    assert known.std_errors["viscous_coefficient"] < 1.1 * unknown.std_errors["viscous_coefficient"]
