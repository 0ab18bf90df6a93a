"""Blocks of rows that belong together: as long as is asked for, whenever the log began."""

import numpy as np
import pytest

from hybrid_dynamics.loop.blocks import block_starts


@pytest.mark.parametrize("began", [0.0, 1.7e9])
@pytest.mark.parametrize(("block", "count"), [(1.0, 20), (0.5, 40), (2.5, 8)])
def test_blocks_are_as_long_as_asked_for_whenever_the_log_began(began: float, block: float, count: int) -> None:
    starts = block_starts(began + np.arange(2001) / 100.0, block)
    assert len(starts) == count
    assert starts[0] == 0
    assert np.all(np.abs(np.diff(starts) - 100.0 * block) <= 1)


def test_a_log_that_is_shorter_than_a_block_has_two() -> None:
    assert block_starts(np.arange(101) / 100.0, 5.0).tolist() in ([0, 50], [0, 51])
