"""Boxes in time: how long one may be, and what is no other one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hybrid_dynamics.loop.boxes import ALIKE, LARGEST_SHARE, SHORTEST, STEP, Interval, Stretch, _beside, _best, _return

DT = 0.01
#: Rows of a boundary's step.
STEP_ROWS = round(STEP / DT)


def stretch(rows: int, *pushes: tuple[int, int, float]) -> Stretch:
    """Nothing is left but ``pushes``: from a row to another (excluded), of a height [N m]; the model has an offset."""
    left = np.zeros(rows)
    for start, stop, height in pushes:
        left[start:stop] += height
    return Stretch(np.ones((rows, 1)), left, np.ones(rows, bool), np.zeros((rows, 2)))


def found(*runs: Stretch, known: tuple[Interval, ...] = (), window: float = 0.2) -> Interval:
    best = _best(runs, DT, known, window)
    assert best is not None
    return best[1]


@pytest.mark.parametrize(("start", "stop"), [(300, 333), (417, 590), (204, 790)])
def test_the_best_box_is_where_the_push_is(start: int, stop: int) -> None:
    assert found(stretch(1000, (start, stop, 5.0))) == Interval(None, start, stop)


@pytest.mark.parametrize("rows", [600, 1000, 2000])
def test_a_box_takes_no_more_than_its_share_of_a_run_and_a_step_at_either_end(rows: int) -> None:
    """Of half a wave over the run a box of three quarters of it would gain most."""
    wave = 5.0 * np.sin(np.pi * (np.arange(rows) + 0.5) / rows)
    box = found(Stretch(np.zeros((rows, 1)), wave, np.ones(rows, bool), np.zeros((rows, 2))))
    assert LARGEST_SHARE * rows <= box.stop - box.start <= LARGEST_SHARE * rows + 2 * STEP_ROWS


def test_a_box_is_no_shorter_than_the_shortest_less_a_step_at_either_end() -> None:
    box = found(stretch(1000, (500, 503, 50.0)))
    assert SHORTEST / DT - 2 * STEP_ROWS <= box.stop - box.start <= SHORTEST / DT
    assert box.start <= 500 < 503 <= box.stop


@pytest.mark.parametrize("side", ["before", "after"])
def test_what_is_left_beside_a_known_box_is_no_other_one(side: str) -> None:
    """Within a step and the filter's window of its ends; what lies farther off is one."""
    window = 0.2
    beside = (260, 300, 9.0) if side == "before" else (400, 440, 9.0)
    run = stretch(1000, beside, (700, 760, 4.0))
    known = (Interval(None, 300, 400),)
    assert found(run, known=known, window=window) == Interval(None, 700, 760)
    assert found(run, window=window) == Interval(None, *beside[:2])
    # Known of another run it says nothing of this one.
    assert found(run, stretch(1000), known=(Interval(1, 300, 400),), window=window) == Interval(0, *beside[:2])


def test_what_is_far_enough_from_a_known_box_is_another() -> None:
    pad = STEP_ROWS + round(0.2 / DT)
    run = stretch(1000, (300 - pad - 60, 300 - pad, 9.0), (700, 760, 4.0))
    assert found(run, known=(Interval(None, 300, 400),)) == Interval(None, 300 - pad - 60, 300 - pad)


@pytest.mark.parametrize("entries", [1, 4, 9])
@pytest.mark.parametrize(("away", "returns"), [(0.8 * ALIKE, True), (1.2 * ALIKE, False)])
def test_a_box_returns_where_states_that_are_alike_stand_off_too(entries: int, away: float, returns: bool) -> None:
    """Alike is within ``ALIKE`` by the root mean square over the entries of a state, however many these are."""
    push, again = slice(300, 400), slice(700, 800)
    states = 10.0 + np.arange(1000.0)[:, None] * np.ones(entries)
    states[again] = states[push] + away
    box = [Interval(None, push.start, push.stop)]
    for there in (5.0, 0.0):
        run = stretch(1000, (push.start, push.stop, 5.0), (again.start, again.stop, there))
        run = replace(run, columns=np.zeros((1000, 0)), states=states)
        # The control: a motion that comes back without what stood off.
        assert _return(_beside([run], box), box, DT) is (returns and there > 0)
