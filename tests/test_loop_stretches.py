"""Hours of logs: what is looked at of them is spread evenly, as long as asked for, and all that is held."""

import gc
import weakref
from collections.abc import Iterator

import numpy as np
import pytest
from tests.small_arm import arm, noisy_log

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop import LoopSettings, close_loop
from hybrid_dynamics.loop.hold_out import hold_out
from hybrid_dynamics.loop.process import ProcessSettings, process
from hybrid_dynamics.loop.stretches import STRETCH, spread
from hybrid_dynamics.simulation.excitation import excitation
from hybrid_dynamics.trajectory import Trajectory

RATE = 10.0


def long_run(name: str, seconds: float, start: float = 0.0) -> Trajectory:
    """A run that holds its own time as its signal."""
    time = start + np.arange(round(seconds * RATE)) / RATE
    return Trajectory(name, "train", time, {"q": time[:, None].copy(), "tau": time[:, None].copy()})


def test_runs_that_are_short_enough_stay_as_they_are():
    runs = [long_run(f"r{k}", 100.0) for k in range(3)]
    kept, notes = spread(iter(runs), 300.0, "training")
    assert [a is b for a, b in zip(kept, runs, strict=True)] == [True] * 3
    assert notes == []


@pytest.mark.parametrize(
    ("lengths", "longest"), [((36000.0,), 1200.0), ((900.0,) * 12, 1200.0), ((200.0, 10.0, 3000.0, 40.0), 600.0)]
)
def test_what_is_looked_at_is_as_long_as_asked_for_and_evenly_spread(lengths: tuple[float, ...], longest: float):
    runs = [long_run(f"r{k}", s) for k, s in enumerate(lengths)]
    kept, notes = spread(runs, longest, "training")
    total = sum(piece.duration for piece in kept)
    assert longest - 2 * STRETCH < total <= longest + STRETCH
    assert len({piece.name for piece in kept}) == len(kept)
    # Every stretch holds the samples of the run that it is named after, at their times, and nothing is in two of them.
    for piece in kept:
        np.testing.assert_array_equal(piece["q"][:, 0], piece.time)
        assert piece.start == 0.0
        assert piece.name.split(" ")[0] in {run.name for run in runs}
    # In the longest run no two neighbours are further apart than a few times the even distance.
    of_longest = runs[int(np.argmax(lengths))]
    starts = [p.time[0] for p in kept if p.name.split(" ")[0] == of_longest.name]
    even = STRETCH * sum(lengths) / longest
    assert np.diff([*starts, of_longest.time[-1]]).max() < 4 * even + STRETCH
    (note,) = notes
    assert f"{len(kept)} stretches" in note
    assert "the setting longest" in note


@pytest.mark.parametrize("kinds", [2, 3, 4])
@pytest.mark.parametrize("count", [40, 80, 240])
def test_what_alternates_from_run_to_run_is_seen_in_all_its_kinds(kinds: int, count: int):
    """There and back, one tool and the other: a choice of every second, fourth ... would see one of them."""
    kept, _ = spread([long_run(f"{'abcd'[k % kinds]}{k}", 60.0) for k in range(count)], 1200.0, "training")
    seen = [piece.name[0] for piece in kept]
    assert min(seen.count(kind) for kind in "abcd"[:kinds]) >= len(kept) / kinds / 3
    # Within one run as well.
    (run,) = [long_run("r", 60.0 * count)]
    starts = [round(piece.time[0] / 60.0) % kinds for piece in spread([run], 1200.0, "training")[0]]
    assert min(starts.count(kind) for kind in range(kinds)) >= len(starts) / kinds / 3


def test_what_is_no_run_is_left_to_who_refuses_it():
    nothing = Trajectory("nothing", "train", np.zeros(0), {"q": np.zeros((0, 1)), "tau": np.zeros((0, 1))})
    instant = long_run("instant", 1 / RATE)
    undated = long_run("undated", 30.0)
    undated.time[5:] = np.nan
    assert [run.name for run in spread([nothing, instant, undated], 60.0, "training")[0]] == [
        "nothing",
        "instant",
        "undated",
    ]
    kept, _ = spread([nothing, instant, long_run("long", 600.0)], 120.0, "training")
    assert sum(piece.duration for piece in kept) <= 120.0 + STRETCH
    with pytest.raises(InputError, match="holds 0 samples"):
        close_loop(arm(), [Trajectory("e", "train", np.zeros(0), {s: np.zeros((0, 2)) for s in ("q", "tau")})], [])


def test_stretches_of_one_run_are_one_run_and_of_two_are_two():
    def told(runs: list[Trajectory]) -> int:
        notes = hold_out(spread(runs, 120.0, "training")[0], [], LoopSettings()).notes
        return sum("one training run only" in note for note in notes)

    assert told([long_run("a", 600.0)]) == 1
    assert told([long_run("a", 300.0), long_run("b", 300.0)]) == 0


def test_runs_are_let_go_once_their_stretches_are_taken():
    alive: list[int] = []
    read: list[weakref.ref[np.ndarray]] = []

    def reading() -> Iterator[Trajectory]:
        for k in range(12):
            run = long_run(f"r{k}", 900.0)
            read.append(weakref.ref(run["q"]))
            yield run
            del run
            gc.collect()
            alive.append(sum(ref() is not None for ref in read))

    spread(reading(), 1200.0, "training")
    # The first one is whole as long as it may be all there is; then the one just read at most.
    assert max(alive) <= 2
    assert max(alive[2:]) <= 1


def test_a_stretch_knows_when_its_run_began():
    run = noisy_log((), 1, "train", 0.01)
    piece = run.rows(slice(1000, 3000)).rows(slice(500, None))
    assert piece.start == run.time[0]
    assert process(piece, arm(), ProcessSettings()).motion.began == run.time[0]
    assert process(run, arm(), ProcessSettings()).motion.began == run.time[0]


def test_a_loop_over_long_logs_finds_the_same_as_one_over_all_of_them():
    grease = Effect("viscous_friction", ("shoulder",), {"viscous_coefficient": 2.0})

    def logs(split: str, count: int) -> Iterator[Trajectory]:
        for k in range(count):
            yield excitation(arm(), [grease], name=f"{split}{k}", split=split, seed=k, duration=70.0, rate=100.0)

    few = LoopSettings(effects=("viscous_friction", "coulomb_friction"), longest=140.0)
    result = close_loop(arm(), logs("train", 6), logs("test", 1), few)
    (effect,) = result.model.effects
    assert (effect.effect, effect.joints) == ("viscous_friction", ("shoulder",))
    assert abs(effect.parameters["viscous_coefficient"] - 2.0) < 5 * effect.std_errors["viscous_coefficient"]
    assert sum(run.time[-1] - run.time[0] for run in result.train) <= 140.0
    assert any("6 training runs of 7 min last longer than 2 min" in note for note in result.diagnosis.notes)
