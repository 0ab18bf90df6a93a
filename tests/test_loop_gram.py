"""Packed Gram matrices against dense ones."""

import numpy as np
import pytest

from hybrid_dynamics.loop.blocks import Blocks, Folds
from hybrid_dynamics.loop.gram import BlockGrams
from hybrid_dynamics.loop.sums import FoldSums

BLOCKS, SIZE = 5, 7


@pytest.fixture
def dense():
    rows = np.random.default_rng(0).normal(size=(BLOCKS, 12, SIZE))
    return np.einsum("bki,bkj->bij", rows, rows)


@pytest.mark.parametrize("moving", [[], [0, 4]])
@pytest.mark.parametrize("used", [[6], [1, 6], [0, 2, 3, 5, 6], range(SIZE)])
@pytest.mark.parametrize("blocks", [slice(None), slice(1, 4), np.array([0, 3])])
def test_a_form_is_that_of_the_dense_matrices_whatever_columns_are_used(dense, used, blocks, moving):
    v, w = np.zeros(SIZE), np.zeros(SIZE)
    v[list(used)], w[list(used)[:2]] = np.arange(1.0, len(used) + 1), -2.5
    packed = BlockGrams.of(dense, moving)
    np.testing.assert_allclose(packed.forms(v, w, blocks), dense[blocks] @ w @ v, rtol=1e-12)
    np.testing.assert_allclose(packed.forms(w, v, blocks), dense[blocks] @ v @ w, rtol=1e-12)


@pytest.mark.parametrize("moving", [[], [2], [1, 4]])
def test_entries_sums_and_the_last_column_are_those_of_the_dense_matrices(dense, moving):
    packed, rows, columns = BlockGrams.of(dense, moving), np.array([4, 0]), np.array([2, 6, 5])
    np.testing.assert_array_equal(packed.last, dense[:, :, -1])
    np.testing.assert_array_equal(packed.pick(rows, columns), dense[:, rows[:, None], columns])
    weights = np.array([[0.0, 1.0, 1.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0, -1.0], np.zeros(BLOCKS)])
    sums = np.einsum("mb,bij->mij", weights, dense)
    np.testing.assert_allclose(packed.totals(weights), sums, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(packed.column_totals(columns, weights), sums[:, columns], rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("moving", [[], [1], [1, 4], [0, 1, 2, 3, 4, 5]])
def test_columns_come_before_the_last_and_leave_the_others_where_they_are(dense, moving):
    kept, every = [0, 1, 2, 3, 6], np.arange(SIZE)
    few = BlockGrams.of(dense[:, kept][:, :, kept], [m for m in moving if m < 4])
    packed = few.grown(dense[:, [4, 5]], [m for m in moving if m >= 4])
    assert packed.size == SIZE
    np.testing.assert_array_equal(packed.pick(every, every), dense)
    v = np.arange(1.0, SIZE + 1)
    np.testing.assert_allclose(packed.forms(v, v[::-1]), dense @ v[::-1] @ v, rtol=1e-12)
    np.testing.assert_array_equal(packed.last, dense[:, :, -1])
    np.testing.assert_allclose(packed.totals(np.ones((1, BLOCKS)))[0], dense.sum(axis=0), rtol=1e-13)
    # Those there were have not changed, nor can they.
    np.testing.assert_array_equal(few.pick(every[:5], every[:5]), dense[:, kept][:, :, kept])
    with pytest.raises(ValueError, match="read-only"):
        few.last[0, 0] = 1.0


def test_sums_of_folds_leave_out_what_borders_on_a_fold_and_follow_columns_that_change(dense):
    # One run in five blocks, the first two one fold, the next two the second, the last one the third.
    blocks = Blocks(np.zeros(BLOCKS, int), ((0, 0),) * BLOCKS)
    folds = Folds(blocks, 3, np.array([0, 0, 1, 1, 2]))
    first = FoldSums.of([BlockGrams.of(dense)], folds)
    own, others = [[0, 1], [2, 3], [4]], [[3, 4], [0], [0, 1, 2]]

    def check(sums, now):
        np.testing.assert_allclose(sums.full[0], now.sum(axis=0), rtol=1e-12, atol=1e-12)
        for f in range(3):
            np.testing.assert_allclose(sums.own[0][f], now[own[f]].sum(axis=0), rtol=1e-12, atol=1e-12)
            np.testing.assert_allclose(sums.others[0][f], now[others[f]].sum(axis=0), rtol=1e-12, atol=1e-12)

    check(first, dense)
    changed, columns = dense.copy(), np.array([5, 2])
    changed[:, columns] *= 3.0
    changed[:, :, columns] *= 3.0
    grams = [BlockGrams.of(dense, [2, 5]).replaced(columns, changed[:, columns])]
    second = first.renewed(grams, {0: columns})
    with pytest.raises(AssertionError):
        check(second, dense)
    check(second, changed)
    check(first, dense)


def test_what_the_other_blocks_do_not_hold_is_exactly_nothing_there(dense):
    # One direction of a joint, a push: seen in two blocks, one a fold's last, one the next one's first. As a
    # difference of sums its square would be what rounding leaves, which may be less than nothing.
    blocks = Blocks(np.zeros(BLOCKS, int), ((0, 0),) * BLOCKS)
    folds = Folds(blocks, 3, np.array([0, 0, 1, 1, 2]))
    once = dense.copy()
    once[[0, 3, 4]] = 0.0
    (others,) = FoldSums.of([BlockGrams.of(once)], folds).others
    np.testing.assert_array_equal(others[:2], 0.0)
    np.testing.assert_allclose(others[2], once[1] + once[2], rtol=1e-12)
    # Control: such differences are not nothing.
    assert np.any(once[1] + once[2] - once[1] - once[2])
