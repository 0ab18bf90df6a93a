"""Where the samples of a fit do not tell two columns apart, rounding does not either."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hybrid_dynamics.loop.solve import Constraints, solve
from hybrid_dynamics.types import Array

#: Coulomb friction of a joint, offset, friction of a coupling with the sign of a difference; true torques [N m].
TRUE = np.array([0.5, 2.0, 0.04])


def normal(columns: Array, target: Array) -> tuple[Array, Array]:
    return columns.T @ columns, columns.T @ target


def log(seed: int, turning: bool, rows: int = 400) -> tuple[Array, Array]:
    """Columns and torque; not ``turning``: the difference of both speeds keeps its sign."""
    rng = np.random.default_rng(seed)
    sign = np.where(rng.random(rows) < 0.5, -1.0, 1.0)
    difference = np.where(rng.random(rows) < 0.5, -1.0, 1.0) if turning else np.ones(rows)
    columns = np.stack([sign, np.ones(rows), difference], axis=1)
    return columns, columns @ TRUE + 0.05 * rng.normal(size=rows)


def bounds(count: int, friction: Sequence[int]) -> Array:
    lower = np.full(count, -np.inf)
    lower[list(friction)] = 0.0
    return lower


@example(seed=0, bounded=True, cones=True)
@given(seed=st.integers(0, 10_000), bounded=st.booleans(), cones=st.booleans())
@settings(max_examples=40)
def test_what_a_part_of_a_log_leaves_open_is_small_there_and_does_not_turn_on_others(seed, bounded, cones):
    """Offset and friction of the coupling are one column: only their sum is known, and it is the sum that is found."""
    columns, target = log(seed, turning=False)
    lower = bounds(3, [0, 2] if bounded else [])
    # A half space that is far from active makes it a problem for the cone solver where bounds alone would do.
    room = {"rows": np.array([[1.0, 0.0, 0.0]]), "least": np.array([0.499 if cones else -1e3])}
    x = solve(*normal(columns, target), Constraints(lower, **room))
    known = TRUE[1] + TRUE[2]
    assert x[1] + x[2] == pytest.approx(known, abs=0.03)
    assert np.abs(x).max() < 1.05 * known
    # The same beside a joint of its own, which shares no row with these.
    other = np.random.default_rng(seed + 1).normal(size=(len(target), 2))
    own, beside = normal(columns, target), normal(other, other @ [3.0, -1.0])
    a = np.block([[own[0], np.zeros((3, 2))], [np.zeros((2, 3)), beside[0]]])
    wide = {"rows": np.array([[1.0, 0.0, 0.0, 0.0, 0.0]]), "least": room["least"]}
    y = solve(a, np.concatenate([own[1], beside[1]]), Constraints(bounds(5, [0, 2] if bounded else []), **wide))
    np.testing.assert_allclose(y[:3], x, atol=1e-2)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=20)
def test_what_is_known_is_as_it_was(seed):
    """The control: where the sign turns over, all three are told, to far below what the samples know them."""
    columns, target = log(seed, turning=True)
    exact = np.linalg.lstsq(columns, target, rcond=None)[0]
    x = solve(*normal(columns, target), Constraints(np.full(3, -np.inf)))
    np.testing.assert_allclose(x, exact, rtol=1e-8)
