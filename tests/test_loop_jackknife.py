"""Standard errors from blocks of time: true to the scatter of estimates, with few blocks and coloured noise too."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from hybrid_dynamics.loop.jackknife import covariance_of
from hybrid_dynamics.types import Array

ROWS, BLOCKS, COLUMNS = 600, 12, 6
#: A weak prior, as every fit of the loop has one.
PRIOR = 1e-6 * np.eye(COLUMNS)


def _fit(design: Array, target: Array) -> tuple[Array, Array, Array, Array]:
    """Coordinates, the normal matrix, each block's part of it and its scores."""
    parts = np.array([d.T @ d for d in np.split(design, BLOCKS)])
    normal = parts.sum(axis=0) + PRIOR
    x = np.linalg.solve(normal, design.T @ target)
    scores = np.array(
        [d.T @ (t - d @ x) for d, t in zip(np.split(design, BLOCKS), np.split(target, BLOCKS), strict=True)]
    )
    return x, normal, parts, scores


def _design(rng: np.random.Generator) -> Array:
    """Slow columns, as motions make them."""
    time = np.linspace(0, 1, ROWS)
    waves = [np.sin(2 * np.pi * (k + 1) * time + rng.uniform(0, 6)) for k in range(COLUMNS)]
    return np.column_stack(waves)


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_errors_have_the_size_of_the_scatter(memory: float) -> None:
    rng = np.random.default_rng(1)
    one_run = np.zeros(BLOCKS, int)
    squares = []
    for _ in range(200):
        design = _design(rng)
        noise = lfilter([1.0], [1.0, -memory], rng.normal(size=ROWS))
        x, normal, parts, scores = _fit(design, noise)
        squares.append(x**2 / np.diag(covariance_of(normal, parts, scores, one_run)))
    # Squares of t with about 11 degrees of freedom have the mean 1.22; half of that and twice it are wrong errors.
    assert 0.7 < np.mean(squares) < 1.7


def test_a_parameter_that_one_block_alone_knows_is_not_sure() -> None:
    rng = np.random.default_rng(2)
    design = _design(rng)
    design[:, 0] = 0.0
    design[100:120, 0] = 1.0  # a motion that only the third block holds
    target = design @ np.ones(COLUMNS) + 0.01 * rng.normal(size=ROWS)
    x, normal, parts, scores = _fit(design, target)
    errors = np.sqrt(np.diag(covariance_of(normal, parts, scores, np.zeros(BLOCKS, int))))
    # Without that block nothing is left of the parameter: the error is its whole size.
    assert errors[0] > 0.9 * abs(x[0])
    assert np.all(errors[1:] < 0.05)


def test_a_run_of_one_block_counts_as_much_as_one_inside_a_run() -> None:
    rng = np.random.default_rng(3)
    design = _design(rng)
    _, normal, parts, scores = _fit(design, rng.normal(size=ROWS))
    every = covariance_of(normal, parts, scores, np.arange(BLOCKS))
    # With every block its own run this is the plain jackknife.
    out = [np.linalg.solve(normal - p, s) for p, s in zip(parts, scores, strict=True)]
    np.testing.assert_allclose(every, np.transpose(out) @ out * (BLOCKS - 1) / BLOCKS, rtol=1e-6)


def test_nothing_to_know_has_no_covariance() -> None:
    empty = covariance_of(np.zeros((0, 0)), np.zeros((3, 0, 0)), np.zeros((3, 0)), np.zeros(3, int))
    assert empty.shape == (0, 0)
