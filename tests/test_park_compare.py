"""The loop beside least squares: worse, as good or better, told from made-up residuals whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid_dynamics.study.park.compare import AS_GOOD, BETTER, WORSE, Comparison, compare
from hybrid_dynamics.types import Array

RATE, SECONDS, BLOCK, CHANCE = 100.0, 40.0, 0.5, 0.025
TIME = np.arange(int(RATE * SECONDS)) / RATE


def noise(seed: int, colour: float = 0.0) -> Array:
    """(K, 2) of unit spread; ``colour`` is the correlation of neighbours."""
    rng = np.random.default_rng(seed)
    white = rng.normal(size=(len(TIME), 2))
    out = np.empty_like(white)
    out[0] = white[0]
    for k in range(1, len(white)):
        out[k] = colour * out[k - 1] + np.sqrt(1 - colour**2) * white[k]
    return out


def lacking(size: float) -> Array:
    """What a model leaves out on the first joint: mean square ``size``; nothing on the second."""
    return np.sqrt(2 * size) * np.stack([np.sin(2 * np.pi * 0.7 * TIME), np.zeros_like(TIME)], axis=1)


def judged(one: Array, other: Array, runs: int = 2) -> tuple[list[Comparison], Comparison]:
    cut = [np.array_split(part, runs) for part in (one, other, TIME)]
    return compare(cut[0], cut[1], cut[2], BLOCK, CHANCE)


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_a_difference_is_told_with_its_size_and_where_it_is(colour: float) -> None:
    e = noise(1, colour)
    joints, arm = judged(e, e + lacking(0.5))
    assert [j.verdict for j in joints] == [BETTER, AS_GOOD]
    # Of 1.5 the one lacks a half; e is the same in both, so that only its correlation with the difference is random.
    assert joints[0].relative == pytest.approx(-0.5 / 1.5, abs=3 * joints[0].error)
    assert (joints[1].relative, joints[1].error) == (0.0, 0.0)
    assert arm.relative == pytest.approx(-0.5 / 2.5, abs=3 * arm.error)
    # Seen from the other side it is worse, by as many standard errors.
    back, _ = judged(e + lacking(0.5), e)
    assert [j.verdict for j in back] == [WORSE, AS_GOOD]
    assert back[0].relative / back[0].error == pytest.approx(-joints[0].relative / joints[0].error)


def test_nothing_between_them_is_as_good_as_often_as_promised() -> None:
    """Two models off by as much, each in its own way: which is better on one log is chance."""
    verdicts = []
    for seed in range(100):
        e = noise(seed, 0.8)
        one, other = (0.3 * noise(1000 * k + seed, 0.95) for k in (1, 2))
        joints, arm = judged(e + one, e + other)
        verdicts += [*(j.verdict for j in joints), arm.verdict]
    wrong = sum(v != AS_GOOD for v in verdicts)
    # Twice CHANCE of 300; three standard deviations of a binomial count that is dependent in threes beyond that.
    assert wrong <= 2 * CHANCE * 300 + 3 * np.sqrt(3 * 2 * CHANCE * 300)


def test_a_standard_error_is_the_scatter_over_logs() -> None:
    found = [judged(e, e + lacking(0.2))[0][0] for e in (noise(seed, 0.9) for seed in range(200))]
    scatter = float(np.std([f.relative for f in found]))
    # The share's denominator is random too, by less; 200 logs tell a scatter to a twentieth.
    assert np.median([f.error for f in found]) == pytest.approx(scatter, rel=0.25)


def test_a_sure_difference_of_no_size_is_none() -> None:
    e = noise(3)
    joints, _ = judged(e, e + lacking(0.004))
    assert joints[0].verdict == AS_GOOD


def test_one_short_run_is_compared_too() -> None:
    e = noise(5)[:60]
    joints, arm = compare([e], [e + lacking(9.0)[:60]], [TIME[:60]], BLOCK, CHANCE)
    assert np.isfinite([joints[0].relative, joints[0].error, arm.relative]).all()
