"""Nonlinear parameters are as uncertain as they scatter when the noise is drawn again."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from tests.two_links import two_links

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop.augment import effects_of
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.process import ProcessSettings, process
from hybrid_dynamics.loop.tangents import covariance_with_settings
from hybrid_dynamics.simulation.excitation import excitation
from hybrid_dynamics.trajectory import Trajectory

ROBOT = two_links()
ELBOW = ("elbow",)
TRUTH = Effect("torque_ripple", ELBOW, {"amplitude": 0.5, "harmonic": 9.0, "phase": 0.4})
NOISE = 0.3


def fitted(seed: int, clean: Trajectory) -> Effect:
    """The ripple fitted to one draw of the noise, its harmonic by a search of its own."""
    noise = NOISE * np.random.default_rng(seed).standard_normal(clean["tau"].shape)
    log = Trajectory(clean.name, "train", clean.time, {"q": clean["q"], "tau": clean["tau"] + noise})
    run = process(log, ROBOT, ProcessSettings())
    evidence = Evidence.of(Model(ROBOT), [run], [], LoopSettings())

    def at(harmonic: float) -> Term:
        return Term("torque_ripple", 1, (("harmonic", float(harmonic)),))

    def loss(harmonic: float) -> float:
        own = evidence.adding([at(harmonic)])
        return float(own.errors([at(harmonic)], own.fit([at(harmonic)])).sum())

    best = at(minimize_scalar(loss, bounds=(8.8, 9.2), method="bounded", options={"maxiter": 12}).x)
    evidence = evidence.adding([best])
    x = evidence.fit([best])
    return effects_of(evidence, [best], x, covariance_with_settings(evidence, [best], x))[0]


@pytest.fixture(scope="module")
def fits() -> list[Effect]:
    clean = excitation(ROBOT, [TRUTH], duration=12.0, rate=250.0, torque_noise_share=0.0, encoder_bits=0, seed=1)
    return [fitted(seed, clean) for seed in range(24)]


@pytest.mark.parametrize("name", ["amplitude", "harmonic", "phase"])
def test_standard_errors_match_the_scatter(fits, name):
    values = np.array([e.parameters[name] for e in fits])
    claimed = np.array([e.std_errors[name] for e in fits])
    # 24 draws: the scatter itself is known to 15 %, the sandwich of a few dozen blocks to as much.
    assert 0.55 < np.sqrt(np.mean(claimed**2)) / values.std(ddof=1) < 1.7
    z = (values - TRUTH.parameters[name]) / claimed
    assert np.mean(np.abs(z) < 2) >= 0.75
