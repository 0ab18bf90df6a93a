"""Whose motion a coupled torque follows is told, or no coupling is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hybrid_dynamics.effects import Effect, Term, predict
from hybrid_dynamics.loop import LoopSettings, Model, close_loop, partner
from hybrid_dynamics.loop.noise import noise_floor
from hybrid_dynamics.loop.partner import notes_of, partner_open, seen_together
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory

LINK = """<link name="l{0}"><inertial><origin xyz=".1 0 0"/><mass value="2"/>
<inertia ixx=".02" iyy=".03" izz=".03" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="j{0}" type="revolute"><parent link="{1}"/><child link="l{0}"/><origin xyz=".2 0 0"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="100" velocity="5"/></joint>"""
ROBOT = Robot.from_text(
    '<robot name="three"><link name="base"/>'
    + "".join(LINK.format(k) + JOINT.format(k, f"l{k - 1}" if k else "base") for k in range(3))
    + "</robot>",
    "three joints",
)
FORM = {"from_joint": "j1", "rows": "own", "sign_of": "partner"}
#: Share of white noise at 200 Hz that the filter of the torque lets pass.
SMOOTHED = 0.35
COUPLING = Effect("joint_coupling", ("j0",), {"viscous_coefficient": 0.3, "coulomb_torque": 0.5, "armature": 0.0}, FORM)


def log(effects: list[Effect], seed: int, split: str, together: bool) -> Trajectory:
    """12 s at 200 Hz; ``together``: the last joint makes a multiple of the motion of the one before."""
    rng = np.random.default_rng(seed)
    time = np.arange(2400) / 200.0
    speed = np.array([[0.9, 1.7, 3.1], [1.1, 2.3, 3.7], [0.7, 1.9, 2.9]])
    phase = rng.uniform(0, 2 * np.pi, (3, 3))
    q = np.einsum("k,jkt->tj", [0.5, 0.25, 0.1], np.sin(speed[..., None] * time + phase[..., None]))
    if together:
        q[:, 2] = -1.3 * q[:, 1]
    dq = np.gradient(q, time, axis=0)
    tau = predict(ROBOT, effects, q, dq, np.gradient(dq, time, axis=0), time)
    signals = {"q": q, "dq": dq, "tau": tau + 0.03 * rng.normal(size=tau.shape)}
    return Trajectory(f"{split}_{seed}", split, time, signals)


def judged(effects: list[Effect], together: bool, start: list[Effect] | None = None) -> tuple[Judge, Term]:
    settings = LoopSettings()
    train = [log(effects, seed, "train", together) for seed in (1, 2)]
    judge, _, _ = gather(Model(ROBOT, tuple(start or ())), read_motion(ROBOT, train, [], settings), settings)
    term = COUPLING.term(ROBOT)
    return judge.adding([term]).at([term]), term


def test_a_partner_that_another_joint_could_be_is_not_told() -> None:
    judge, term = judged([COUPLING], together=True)
    unknown = partner_open(judge, [term])
    assert unknown == {term: ["j2"]}
    (note,) = notes_of(unknown, ROBOT.joint_names)
    assert note.startswith("j0: a torque that follows the motion of j1 as well as that of j2 is no finding")
    # The control: where the two move each on its own, the partner is the one.
    judge, term = judged([COUPLING], together=False)
    assert partner_open(judge, [term]) == {}


@pytest.mark.parametrize("form", [FORM, {"from_joint": "j1"}, {"from_joint": "j1", "rows": "both", "sign_of": "sum"}])
def test_a_change_of_what_the_starting_model_has_is_not_asked(form: dict[str, str]) -> None:
    start = Effect(COUPLING.effect, COUPLING.joints, COUPLING.parameters, form)
    judge, term = judged([], together=True, start=[start])
    assert partner_open(judge, [term]) == {}


def test_a_partner_that_is_surely_worse_is_told_however_small_the_difference() -> None:
    """What a joint is off by before anything is asked says nothing of which partner it is."""
    judge, term = judged([COUPLING], together=False)
    much = np.full(3, 1.0)
    assert partner_open(replace(judge, misfit=much), [term]) == {}
    # The control: nothing that is asked for by size would see a difference beside such a misfit.
    others = partner._others(judge, term)
    there = replace(judge.adding(others), misfit=much)
    full = there.evidence.held([term], physical=True)
    assert any(there.as_good(there.evidence.held([c], physical=True), full) for c in others)


@pytest.mark.parametrize("seed", range(1, 9, 2))
def test_two_that_make_the_same_torque_are_never_told_by_the_rounding_of_sums(seed: int) -> None:
    """What differs by rounding differs on another processor by something else."""
    settings = LoopSettings()
    train = [log([COUPLING], k, "train", True) for k in (seed, seed + 1)]
    judge, _, _ = gather(Model(ROBOT), read_motion(ROBOT, train, [], settings), settings)
    term = COUPLING.term(ROBOT)
    (other,) = partner._others(judge, term)
    judge = judge.adding([term]).at([term]).adding([other])
    one, two = (judge.evidence.held([t], physical=True) for t in (term, other))
    assert not judge.gain(one, two, one).surer_than(1.0)
    assert not judge.gain(two, one, one).surer_than(1.0)
    assert partner_open(judge, [term]) == {term: ["j2"]}
    # The control: none at all is surely worse.
    assert judge.gain(one, judge.evidence.held([])).surer_than(3.0)


@pytest.mark.parametrize("together", [True, False])
def test_the_loop_names_it_where_its_partner_is_told(together: bool) -> None:
    train, test = ([log([COUPLING], seed, split, together) for seed in seeds]
                   for split, seeds in (("train", (1, 2)), ("test", (3,))))  # fmt: skip
    result = close_loop(ROBOT, train, test)
    named = {(e.effect.effect, e.effect.joints) for e in result.diagnosis.effects}
    told = [note for note in result.diagnosis.notes if "is no finding: let j0 rest" in note]
    if together:
        assert "joint_coupling" not in {effect for effect, _ in named}
        assert len(told) == 1
        assert result.diagnosis.verdict in ("partly_explained", "unexplained")
    else:
        assert named == {("joint_coupling", ("j0",))}
        assert told == []
        assert result.diagnosis.verdict == "explained"


def test_joints_that_never_move_at_once_are_not_asked_for_a_coupling() -> None:
    """Each one's own friction is what a coupling would stand for."""
    friction = [Effect("coulomb_friction", (f"j{k}",), {"coulomb_torque": 0.8}) for k in range(2)]
    settings = LoopSettings()

    def asked(train: list[Trajectory]) -> tuple[set[tuple[str | None, str]], list[str]]:
        _, terms, notes = gather(Model(ROBOT), read_motion(ROBOT, train, [], settings), settings)
        coupled = [t for t in terms if t.effect == "joint_coupling"]
        return {(f"j{t.joint}", str(t.options["from_joint"])) for t in coupled}, notes

    in_turn = in_pieces(friction, [(0,), (1,), (2,)])
    pairs, notes = asked([in_turn])
    assert pairs == set()
    assert notes == [
        "j0 and j1, j1 and j2: never move at once, so nobody asks whether they are coupled; move neighbours together "
        "for that"
    ]
    # Two of three at once are asked; the control: all together.
    assert asked([in_pieces(friction, [(0, 1), (2,), (0, 1)])])[0] == {("j0", "j1")}
    assert asked([log(friction, seed, "train", False) for seed in (1, 2)]) == ({("j0", "j1"), ("j1", "j2")}, [])
    term = Term("viscous_friction", 0)
    assert seen_together(read_motion(ROBOT, [in_turn], [], settings).train, ROBOT, [term]) == [term]


def test_no_floor_is_above_what_the_starting_model_leaves() -> None:
    """A joint that moves for a second or two is predicted anyhow by a rich model of the rest of its motion."""
    train = [in_pieces([], [(0,), (1,), (2,)], seconds=3.0)]
    logs = read_motion(ROBOT, train, [log([], 9, "test", False)], LoopSettings())
    judge, _, _ = gather(Model(ROBOT), logs, LoopSettings())
    left = np.sqrt(judge.mean_square(judge.evidence.held([])))
    assert np.all(noise_floor(judge.evidence)[:2] > 100 * left[:2])
    assert np.all(judge.floor <= np.maximum(left, judge.low) * (1 + 1e-9))
    np.testing.assert_allclose(judge.floor, 0.03 * SMOOTHED, rtol=0.3)


def in_pieces(effects: list[Effect], moving: list[tuple[int, ...]], seconds: float = 8.0) -> Trajectory:
    """Pieces in which some joints move and the others stand."""
    whole = [log([], seed, "train", False) for seed in range(len(moving))]
    rows = round(seconds * 200)
    s = np.sin(np.pi * np.arange(rows) / rows)[:, None] ** 2
    q = np.concatenate(
        [s * run["q"][:rows] * np.isin(np.arange(3), some) for run, some in zip(whole, moving, strict=True)]
    )
    time = np.arange(len(q)) / 200.0
    dq = np.gradient(q, time, axis=0)
    tau = predict(ROBOT, effects, q, dq, np.gradient(dq, time, axis=0), time)
    tau += 0.03 * np.random.default_rng(0).normal(size=tau.shape)
    return Trajectory("in_turn", "train", time, {"q": q, "dq": dq, "tau": tau})
