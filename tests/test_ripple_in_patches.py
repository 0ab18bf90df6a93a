"""Ripples are found where the positions seen are patches shorter than a period, far from each other."""

from __future__ import annotations

import numpy as np
import pytest
from tests.small_arm import arm

from hybrid_dynamics.effects import family
from hybrid_dynamics.effects.state import Motion
from hybrid_dynamics.effects.torque_ripple import spectrum
from hybrid_dynamics.types import Array

ROBOT = arm()
#: Middles [rad] of the patches, half their width and the noise [N m].
MIDDLES, HALF, NOISE = (-1.6, -0.7, 0.2, 0.9, 1.8), 0.25, 0.05


def _motions(seed: int) -> list[Motion]:
    rng = np.random.default_rng(seed)
    out = []
    for middle in MIDDLES:
        time = np.arange(1500) / 100.0
        q = middle + HALF * np.sin(2 * np.pi * rng.uniform(0.1, 0.3) * time[:, None] + rng.uniform(0, 6, 2))
        out.append(Motion(ROBOT, time, q, np.gradient(q, 0.01, axis=0), np.zeros_like(q)))
    return out


def _proposed(motions: list[Motion], left: list[Array]) -> list[float]:
    kind, moving = family("torque_ripple"), np.array([True, False])
    terms = kind.propose([str(k) for k in range(len(motions))], motions, left, moving)
    return sorted(float(t.options["harmonic"]) for t in terms)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("harmonic", [6.0, 8.0, 11.0])
def test_a_wave_and_its_double_are_proposed_together(harmonic: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    motions = _motions(seed)
    phases = rng.uniform(0, 2 * np.pi, 2)
    assert 2 * np.pi / harmonic > 2 * HALF  # no patch holds a period
    for second in (0.0, 0.6):
        left = []
        for m in motions:
            angle = harmonic * m.q[:, 0]
            wave = np.sin(angle + phases[0]) + second * np.sin(2 * angle + phases[1])
            left.append(np.column_stack([wave, 0 * wave]) + NOISE * rng.normal(size=m.q.shape))
        found = np.array(_proposed(motions, left))
        for true in (harmonic, 2 * harmonic) if second else (harmonic,):
            # From one end of the range to the other by less than an eighth of a period.
            assert np.min(np.abs(found - true)) < 2 * np.pi / 8 / (MIDDLES[-1] - MIDDLES[0])


@pytest.mark.parametrize("seed", range(5))
def test_a_slow_curve_and_noise_are_no_wave_and_its_double(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motions = _motions(seed)
    left = [np.column_stack([0.5 * m.q[:, 0] ** 2] * 2) + NOISE * rng.normal(size=m.q.shape) for m in motions]
    found = _proposed(motions, left)
    assert not any(abs(b - 2 * a) < 0.2 for a in found for b in found)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("second", [0.0, 0.6])
def test_two_periods_within_the_range_are_a_ripple_and_fewer_are_none(second: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.arange(4000) / 100.0
    q = -1.0 + 0.72 * np.sin(2 * np.pi * np.array([0.11, 0.13]) * time[:, None] + rng.uniform(0, 6, 2))
    motion = Motion(ROBOT, time, q, np.gradient(q, 0.01, axis=0), np.zeros_like(q))
    least = 4 * np.pi / np.ptp(q[:, 0])
    phases = rng.uniform(0, 2 * np.pi, 2)

    def found(harmonic: float) -> list[float]:
        wave = np.sin(harmonic * q[:, 0] + phases[0]) + second * np.sin(2 * harmonic * q[:, 0] + phases[1])
        return _proposed([motion], [np.column_stack([wave, 0 * wave]) + NOISE * rng.normal(size=q.shape)])

    near = found(1.02 * least)
    for true in (1.02 * least, 2.04 * least) if second else (1.02 * least,):
        assert np.min(np.abs(np.array(near) - true)) < 0.02 * true
    # Control: what has fewer is the foot of something slower.
    assert not any(abs(n - 0.7 * least) < 0.2 * least for n in found(0.7 * least))


def test_what_stands_beside_a_large_wave_is_no_second_one() -> None:
    """The neighbours of a large wave in the spectrum stand above a smaller wave elsewhere."""
    time = np.arange(4000) / 100.0
    q = 1.2 * np.sin(2 * np.pi * np.array([0.11, 0.13]) * time[:, None])
    motion = Motion(ROBOT, time, q, np.gradient(q, 0.01, axis=0), np.zeros_like(q))
    wave = 2.0 * np.sin(12.0 * q[:, 0] + 0.4) + 0.8 * np.sin(31.0 * q[:, 0] + 1.0)
    assert _proposed([motion], [np.column_stack([wave, 0 * wave])]) == pytest.approx([12.0, 31.0], rel=0.02)


def test_a_sine_and_a_cosine_explain_no_less_than_one_of_them_where_they_are_nearly_one() -> None:
    """Of seven places a slow curve leaves two directions, and between some harmonics both waves turn into one."""
    rng = np.random.default_rng(1)
    places, torque = np.sort(rng.uniform(-1.0, 1.0, 7)), rng.normal(size=7)
    harmonics, share = spectrum(np.repeat(places, 20), np.repeat(torque, 20), asked=np.linspace(3.0, 40.0, 4000))
    slow = np.linalg.qr(np.vander(places, 5))[0]
    left, *waves = (
        v - (v @ slow) @ slow.T
        for v in (torque, np.sin(np.outer(harmonics, places)), np.cos(np.outer(harmonics, places)))
    )
    alone = [(w @ left) ** 2 / (np.sum(w**2, axis=1) * (left @ left)) for w in waves]
    # Positions are those of narrow bins, a few ten-thousandths of a radian off.
    assert (share > np.max(alone, axis=0) - 0.02).all()
    assert np.median(share) > 0.9999
