"""Joints that move one after the other, and runs that repeat one motion: what is held out must say something."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from tests.small_arm import noisy_log

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop import LoopSettings, close_loop
from hybrid_dynamics.loop.blocks import FARTHEST, FEW_PARTS, IN_TURN, folds_of, parts_of, reach_of, turns_of
from hybrid_dynamics.loop.hold_out import hold_out
from hybrid_dynamics.loop.paths import paths_of
from hybrid_dynamics.loop.process import Run, process
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.simulation.excitation import excitation
from hybrid_dynamics.trajectory import Trajectory

PARTS = 6


@pytest.fixture(scope="module")
def panda() -> Robot:
    return Robot.from_urdf(find_description("panda.urdf"), lock=("panda_finger_joint1", "panda_finger_joint2"))


def together(rows: int = 600, joints: int = 3) -> np.ndarray:
    """(K, n) joints that move all the time."""
    return np.ones((rows, joints), bool)


def one_by_one(rows: int = 600, joints: int = 3) -> np.ndarray:
    """(K, n) joints that move in turn."""
    return np.arange(joints) == np.arange(rows)[:, None] * joints // rows


def edges(rows: int, pieces: int) -> np.ndarray:
    return np.linspace(0, rows, pieces + 1).round().astype(int)


@pytest.mark.parametrize("joints", [4, 7])
def test_a_part_holds_as_much_of_every_joints_motion_as_any_other(joints):
    moving, cut = one_by_one(840, joints), edges(840, 84)
    assert turns_of(moving, PARTS) == joints
    part = np.repeat(parts_of(moving, cut, PARTS), np.diff(cut))
    share = np.array([moving[part == p].sum(axis=0) for p in range(PARTS)]) / moving.sum(axis=0)
    assert np.all(share > 0.5 / PARTS)
    assert np.all(share < 2.0 / PARTS)
    # The control: of the time, a part holds nearly all that is known of a joint.
    even = np.arange(840) * PARTS // 840
    assert max(moving[even == p].sum(axis=0).max() for p in range(PARTS)) > IN_TURN * moving[:, 0].sum()


def test_parts_are_of_the_time_where_joints_move_together_and_for_a_joint_that_stands():
    moving = together()
    assert turns_of(moving, PARTS) == 1
    assert parts_of(moving, edges(600, 12), PARTS).tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
    moving[:, 1] = False
    assert turns_of(moving, PARTS) == 1
    assert turns_of(np.zeros((60, 2), bool), PARTS) == 1


@given(moving=arrays(bool, st.tuples(st.integers(60, 90), st.integers(1, 4))), pieces=st.integers(6, 30))
def test_every_piece_is_of_a_part_whatever_moves(moving, pieces):
    part = parts_of(moving, edges(len(moving), pieces), PARTS)
    assert part.shape == (pieces,)
    assert part.min() >= 0
    assert part.max() < PARTS


def test_a_twitch_is_no_turn_and_halves_of_a_motion_are_none():
    moving = together()
    moving[:, 2] = False
    moving[300:305, 2] = True
    assert turns_of(moving, PARTS) == 1
    rng = np.random.default_rng(0)
    # Whatever number of parts: joints that move together, each with rests of its own, take no turns.
    assert all(turns_of(rng.random((600, 7)) < 0.7, number) == 1 for number in range(1, 8))
    # The control: a joint that moves as shortly, but long enough for parts of its motion.
    moving[300:360, 2] = True
    assert turns_of(moving, PARTS) == 10


def again(run: Trajectory, seed: int, rows: int = 0) -> Trajectory:
    """The same motion once more, with other noise, logged from ``rows`` samples later on."""
    rng = np.random.default_rng(seed)
    signals = {
        "q": run["q"] + 1e-4 * rng.normal(size=run["q"].shape),
        "tau": run["tau"] + 0.01 * rng.normal(size=run["tau"].shape),
    }
    return replace(run, name=f"again_{seed}", signals=signals).rows(slice(rows, None))


def processed(*logs: Trajectory) -> list[Run]:
    from tests.small_arm import arm

    return [process(log, arm(), LoopSettings().process) for log in logs]


def test_runs_that_repeat_a_motion_have_one_path_and_are_held_out_together():
    one, other = (noisy_log((), seed, "train", 0.01) for seed in (1, 2))
    runs = processed(one, other, again(one, 3), again(other, 4, rows=7))
    assert paths_of(runs).tolist() == [0, 1, 0, 1]
    folds = folds_of(runs, LoopSettings())
    assert folds.number == 2
    assert [set(folds.of_block[folds.blocks.run == r]) for r in range(4)] == [{0}, {1}, {0}, {1}]
    # Where all repeat one motion, parts of it are held out, of every run the same.
    folds = folds_of(processed(one, again(one, 3), again(one, 5)), LoopSettings())
    assert folds.number == LoopSettings().time_folds
    assert all(set(folds.of_block[folds.blocks.run == r]) == set(range(folds.number)) for r in range(3))


def test_every_fold_leaves_something_of_every_joint_where_a_motion_is_all_that_is_known_of_it():
    """One joint a log, each log twice: held out with its twin, a motion would leave nothing of its joint."""
    one = noisy_log((), 1, "train", 0.01)
    alone = [
        replace(one, name=f"joint {j}", signals={"q": one["q"] * (np.arange(2) == j), "tau": one["tau"]})
        for j in (0, 1)
    ]
    runs = processed(alone[0], again(alone[0], 3), alone[1], again(alone[1], 4))
    folds = folds_of(runs, LoopSettings())
    for fold in range(folds.number):
        learned = np.zeros(2)
        out = {*folds.own[fold], *folds.edges[fold]}
        for block, (low, high) in enumerate(folds.blocks.rows):
            if block not in out:
                learned += runs[folds.blocks.run[block]].mask[low:high].sum(axis=0)
        assert np.all(learned > 100)


def test_runs_that_go_each_their_own_way_are_held_out_in_parts(panda):
    """Learnt from a few moves of all joints at once, the links' torque on a few others is anybody's guess."""

    def moves(seed: int, poses: int) -> Run:
        rng = np.random.default_rng(seed)
        low, high = panda.position_limits
        via = (low + high) / 2 + 0.3 * (high - low) * rng.uniform(-1, 1, (poses, panda.n_joints))
        time = np.arange(0, 16.0, 0.005)
        place = np.interp(time % 8.0, np.linspace(0, 8, poses + 1), np.arange(poses + 1))
        k, s = place.astype(int) % poses, place % 1
        q = via[k] + (s**3 * (10 - 15 * s + 6 * s**2))[:, None] * (via[(k + 1) % poses] - via[k])
        log = Trajectory(f"moves {seed}", "train", time, {"q": q, "tau": panda.inverse_dynamics(q, 0 * q, 0 * q)})
        return process(log, panda, LoopSettings().process)

    def reach(poses: int, runs: int) -> float:
        some = [moves(seed, poses) for seed in range(runs)]
        return reach_of(some, paths_of(some))

    cycle = [moves(seed, 5) for seed in range(2)]
    assert reach_of(cycle, paths_of(cycle)) > FARTHEST
    assert folds_of(cycle, LoopSettings()).number == FEW_PARTS
    assert reach(12, 4) < FARTHEST
    # A run at rest says nothing either way.
    still = replace(cycle[0], mask=np.zeros_like(cycle[0].mask))
    assert reach_of([*cycle, still], np.arange(3)) == pytest.approx(reach_of(cycle, np.arange(2)))
    assert reach_of([cycle[0], still], np.arange(2)) == 1.0
    # Whatever its place, and whoever else repeats whose motion.
    twins = [cycle[0], replace(cycle[0], name="twin"), cycle[1]]
    expected = reach_of(twins, np.array([0, 0, 1]))
    assert reach_of([still, *twins], np.array([0, 1, 1, 2])) == pytest.approx(expected)
    # The same states in all: known as well as where it was learnt.
    same = [moves(1, 5), replace(moves(1, 5), name="again")]
    assert reach_of(same, np.array([0, 1])) == pytest.approx(1.0)


def test_a_part_of_a_motion_repeats_it_in_any_order_and_a_small_motion_is_not_near_a_large_one():
    one = noisy_log((), 1, "train", 0.01)
    part = again(one, 3).rows(slice(0, 2500))
    assert paths_of(processed(one, part)).tolist() == paths_of(processed(part, one)).tolist() == [0, 0]
    small = [
        replace(r, name=f"small {r.name}", signals={"q": 0.02 * r["q"], "tau": r["tau"]})
        for r in (noisy_log((), seed, "train", 0.01) for seed in (4, 5))
    ]
    assert len(set(paths_of(processed(*small, one)))) == 3


def test_one_joint_alone_has_no_path_that_could_be_told_from_chance():
    one = noisy_log((), 1, "train", 0.01)
    still = [replace(r, signals={**r.signals, "q": r["q"] * [1, 0]}) for r in (one, again(one, 2))]
    still = [replace(r, signals={k: v for k, v in r.signals.items() if k != "dq"}) for r in still]
    assert paths_of(processed(*still)).tolist() == [0, 1]


def in_turn(robot: Robot, effects: list[Effect], name: str, seconds: float = 4.0) -> Trajectory:
    """One joint after the other; the others stand."""
    n = robot.n_joints
    pieces = [
        excitation(
            robot, effects, name=f"{name}{j}", duration=seconds, rate=250.0, still=[k for k in range(n) if k != j]
        )
        for j in range(n)
    ]
    signals = {s: np.concatenate([piece[s] for piece in pieces]) for s in ("q", "tau")}
    return Trajectory(name, "train", np.arange(len(signals["q"])) / 250.0, signals)


def test_friction_of_every_joint_is_named_from_one_run_in_which_they_move_in_turn(panda):
    effects = [Effect("viscous_friction", (name,), {"viscous_coefficient": 2.0}) for name in panda.joint_names]
    test = excitation(panda, effects, name="test", split="test", duration=8.0, rate=250.0)
    result = close_loop(panda, [in_turn(panda, effects, "turns")], [test])
    assert {(e.effect.effect, e.effect.joints) for e in result.diagnosis.effects} == {
        (e.effect, e.joints) for e in effects
    }
    assert all(e.confirmed for e in result.diagnosis.effects)
    # The control: where nothing is missing, nothing is named.
    test = excitation(panda, (), name="test", split="test", duration=8.0, rate=250.0)
    assert close_loop(panda, [in_turn(panda, [], "turns")], [test]).diagnosis.effects == ()


def test_without_test_runs_the_end_of_each_joints_motion_is_held_out(panda):
    settings = LoopSettings()
    run = in_turn(panda, [], "turns")
    split = hold_out([run], [], settings)
    kept, held, notes = split.train, split.test, split.notes
    assert {piece.start for piece in split.train + split.test} == {0.0}
    assert len(kept) == len(held) == panda.n_joints
    for j in range(panda.n_joints):
        learned, tested = (sum(np.ptp(piece["q"][:, j]) > 0.1 for piece in pieces) for pieces in (kept, held))
        assert (learned, tested) == (1, 1)
    # Three joints: equal turns put a half of one joint's motion into a part, and the end has all of the last one's.
    first = replace(run, signals={k: v[: 3 * 1000, :3] for k, v in run.signals.items()}, time=run.time[:3000])
    split = hold_out([first, first], [], settings)
    assert [len(split.train), len(split.test)] == [6, 6]
    # Nothing is in both, and what is held out is what is said, less the gaps.
    times = np.concatenate([piece.time for piece in (*kept, *held)])
    assert len(np.unique(times)) == len(times)
    rows = sum(len(piece.time) for piece in held)
    assert 0.5 * settings.held_out_share < rows / len(run.time) < settings.held_out_share
    assert "in which joints move in turn" in notes[0]


def test_the_end_of_the_run_is_held_out_where_joints_move_together_or_turns_are_too_short(panda):
    slow = in_turn(panda, [], "slow", seconds=60.0)
    twitch = excitation(panda, duration=12.0, rate=250.0, still=(3,))
    twitch["q"][2900:2925, 3] += 0.004
    runs = [excitation(panda, duration=12.0, rate=250.0), in_turn(panda, [], "turns", seconds=1.0), twitch]
    for run in (*runs, slow.rows(slice(None, None, 125))):
        split = hold_out([run], [], LoopSettings())
        kept, held, notes = split.train, split.test, split.notes
        assert [piece.name for piece in kept] == [run.name]
        assert [piece.name for piece in held] == [f"{run.name} (held out)"]
        assert held[0].time[-1] == run.time[-1]
        assert "in turn, of each" not in notes[0]


def test_an_end_at_which_the_arm_rests_is_left_out_of_its_only_log():
    run = noisy_log((), 1, "train", 0.01)
    rows = np.minimum(np.arange(len(run.time)), 2000)  # it stops after 10 of 20 s
    rests = replace(run, signals={"q": run["q"][rows], "tau": run["tau"]})
    split = hold_out([rests], [], LoopSettings())
    kept, held, notes = split.train, split.test, split.notes
    assert 10.0 < held[0].time[-1] < 11.0
    assert notes[0] == "train_1: the arm rests over the last 9.5 s, which are left out"
    assert kept[0].time[-1] < held[0].time[0]
    # The control: one that moves to its end is left whole, as is one with a test run.
    for train, test in (([run], []), ([rests], [run])):
        split = hold_out(train, test, LoopSettings())
        kept, held, notes = split.train, split.test, split.notes
        assert (held or kept)[-1].time[-1] == run.time[-1]
        assert not any("rests" in note for note in notes)


def test_a_log_at_rest_beside_another_and_one_of_a_few_samples():
    from tests.small_arm import arm

    one, test = noisy_log((), 1, "train", 0.01), noisy_log((), 3, "test", 0.01)
    q = np.full_like(one["q"], 0.3)
    noise = 0.01 * np.random.default_rng(0).normal(size=q.shape)
    still = replace(one, name="still", signals={"q": q, "tau": arm().inverse_dynamics(q, 0 * q, 0 * q) + noise})
    one, test = (replace(run, signals={s: run[s] for s in ("q", "tau")}) for run in (one, test))
    with pytest.raises(InputError, match="run short: holds 4 samples"):
        hold_out([replace(one.rows(slice(0, 4)), name="short")], [], LoopSettings())
    assert close_loop(arm(), [one, still], [test]).diagnosis.verdict in ("nothing_missing", "explained")


def test_what_a_repeated_motion_cannot_show_is_said():
    from tests.small_arm import arm

    one, other = (noisy_log((), seed, "train", 0.01) for seed in (1, 2))
    notes = close_loop(arm(), [one, again(one, 3)], [replace(again(one, 4), split="test")]).diagnosis.notes
    assert any(note.startswith("the training runs repeat one motion") for note in notes)
    assert any(note.startswith("again_4: repeats the motion of a training run") for note in notes)
    notes = close_loop(arm(), [one, other], [noisy_log((), 3, "test", 0.01)]).diagnosis.notes
    assert not any("repeat" in note for note in notes)
