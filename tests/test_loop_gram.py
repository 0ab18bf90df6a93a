"""Packed Gram matrices against dense ones."""

import numpy as np
import pytest

from hybrid_dynamics.loop.gram import BlockGrams

BLOCKS, SIZE = 5, 7


@pytest.fixture
def dense():
    rows = np.random.default_rng(0).normal(size=(BLOCKS, 12, SIZE))
    return np.einsum("bki,bkj->bij", rows, rows)


@pytest.mark.parametrize("used", [[6], [1, 6], [0, 2, 3, 5, 6], range(SIZE)])
@pytest.mark.parametrize("blocks", [slice(None), slice(1, 4), np.array([0, 3])])
def test_a_form_is_that_of_the_dense_matrices_whatever_columns_are_used(dense, used, blocks):
    v, w = np.zeros(SIZE), np.zeros(SIZE)
    v[list(used)], w[list(used)[:2]] = np.arange(1.0, len(used) + 1), -2.5
    packed = BlockGrams.of(dense)
    np.testing.assert_allclose(packed.forms(v, w, blocks), dense[blocks] @ w @ v, rtol=1e-12)
    np.testing.assert_allclose(packed.forms(w, v, blocks), dense[blocks] @ v @ w, rtol=1e-12)


def test_entries_sums_and_the_last_column_are_those_of_the_dense_matrices(dense):
    packed, rows, columns = BlockGrams.of(dense), np.array([4, 0]), np.array([2, 6, 5])
    np.testing.assert_array_equal(packed.last, dense[:, :, -1])
    np.testing.assert_array_equal(packed.pick(rows, columns), dense[:, rows[:, None], columns])
    np.testing.assert_allclose(packed.total(np.array([1, 2])), dense[1:3].sum(axis=0), rtol=1e-14)
    np.testing.assert_array_equal(packed.total(np.zeros(0, int)), np.zeros((SIZE, SIZE)))


def test_columns_come_before_the_last_and_leave_the_others_where_they_are(dense):
    kept = [0, 1, 2, 3, 6]
    packed = BlockGrams.of(dense[:, kept][:, :, kept]).grown(SIZE)
    packed.put(np.array([4, 5]), dense[:, [4, 5]])
    assert packed.size == SIZE
    np.testing.assert_array_equal(packed.last, dense[:, :, -1])
    np.testing.assert_allclose(packed.total(), dense.sum(axis=0), rtol=1e-14)
