"""A curve over one variable is seen where it leaves little; noise of any colour is not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

from hybrid_dynamics.loop.binned import binned_prediction
from hybrid_dynamics.loop.blackbox import shift_test
from hybrid_dynamics.types import Array

ROWS, FOLDS = 3000, 6


def _run(seed: int) -> tuple[Array, Array, Array]:
    """Position, speed and acceleration of a motion of several frequencies over 30 s."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0, 30, ROWS)
    w, phase = 2 * np.pi * np.array([0.11, 0.23, 0.41, 0.67]), rng.uniform(0, 6, 4)
    angle = w * time[:, None] + phase
    return np.sin(angle).sum(axis=1), (w * np.cos(angle)).sum(axis=1), -(w**2 * np.sin(angle)).sum(axis=1)


def _p_value(seed: int, law: Array, noise: Array) -> tuple[float, float]:
    """p-value and share of what the bins over speed and branch learn of ``law`` + ``noise``."""
    _, dq, ddq = _run(seed)
    keep, fold = np.ones(ROWS, bool), np.arange(ROWS) * FOLDS // ROWS
    target = law + noise
    prediction = binned_prediction(dq, (dq * ddq > 0).astype(int), target, keep, fold)
    share = 1 - np.sum((target - prediction) ** 2) / np.sum(target**2)
    return shift_test([prediction], [target], [keep]), share


@pytest.mark.parametrize("seed", range(4))
def test_a_curve_of_half_the_noise_is_seen(seed: int) -> None:
    noise = np.random.default_rng(seed).normal(size=ROWS)
    _, dq, _ = _run(seed)
    law = np.exp(-((dq / 1.5) ** 2)) * np.sign(dq)  # at a fifth of the speeds: what another friction law leaves, say
    law *= 0.5 / law.std()
    p, share = _p_value(seed, law, noise)
    true = float(np.mean(law**2) / np.mean((law + noise) ** 2))
    assert p < 0.001
    # Bins of about 60 rows: their own noise costs one sixtieth, the jump inside the middle one some of the rest.
    assert share > 0.6 * true - 1 / 60


@pytest.mark.parametrize("memory", [0.0, 0.95])
def test_noise_of_any_colour_is_no_curve(memory: float) -> None:
    rng = np.random.default_rng(7)
    found = [
        _p_value(seed, 0.0 * np.ones(ROWS), lfilter([1], [1, -memory], rng.normal(size=ROWS))) for seed in range(40)
    ]
    # At 1 % forty logs give two or more with probability .06, three or more with .007.
    assert sum(p < 0.01 for p, _ in found) <= 2


def test_rows_that_nobody_uses_change_nothing() -> None:
    rng = np.random.default_rng(3)
    value, target = rng.normal(size=200), rng.normal(size=200)
    fold = np.arange(200) % 4
    keep = rng.random(200) < 0.8
    gap = rng.random(200) < 0.1
    branch = np.zeros(200, int)
    used = np.where(gap, -1, fold)
    other = np.where(keep & ~gap, target, 1e6)
    one, two = (binned_prediction(value, branch, t, keep, used) for t in (target, other))
    np.testing.assert_array_equal(one, two)
    assert np.all(one[gap] == 0.0)


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_an_alarm_is_as_rare_as_it_says_however_many_rows_stand_still(share: float) -> None:
    # Standing rows do not count. As zeros in place they met moving ones under every alignment but the true one.
    rng = np.random.default_rng(0)
    keep = np.zeros(1000, bool)
    keep[round(500 * (1 - share)) : round(500 * (1 + share))] = True

    def smooth(width: float) -> list[Array]:
        return [gaussian_filter1d(rng.normal(size=1000), width) for _ in range(2)]

    chances = np.array([shift_test(smooth(10.0), smooth(4.0), [keep, keep]) for _ in range(600)])
    for level in (0.001, 0.01, 0.1):
        # Three standard deviations of a share out of 600.
        assert np.mean(chances < level) <= level + 3 * np.sqrt(level * (1 - level) / 600)
    # Control: what follows the motion, of about the size of the noise, is seen from the same rows.
    law = smooth(10.0)
    assert shift_test(law, [2 * a + b for a, b in zip(law, smooth(4.0), strict=True)], [keep, keep]) < 0.001
