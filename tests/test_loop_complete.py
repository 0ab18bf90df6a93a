"""What a joint lacks is asked together: friction and an offset that take each other's part show side by side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from tests.small_arm import arm

from hybrid_dynamics.effects import Effect, Term, predict
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop import complete as complete_module
from hybrid_dynamics.loop.complete import _chance, complete
from hybrid_dynamics.loop.prepare import gather, read_motion
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory

ROBOT = arm()
SHOULDER, ELBOW = ROBOT.joint_names
SEEDS = range(4)


def mostly_one_way(effects: Sequence[Effect], seed: int, split: str) -> Trajectory:
    """10 s in which the shoulder goes back three quarters of the time and forth the rest: friction looks constant."""
    time = np.arange(2000) / 200.0
    harmonics = [np.sin(k * 0.8 * np.pi * time) / k * np.exp(-0.08 * k * k) for k in range(1, 7)]
    q = np.column_stack([0.9 * np.sum(harmonics, axis=0), 0.6 * np.sin(1.95 * time + 1.0) + 0.4 * np.sin(3.3 * time)])
    dq = np.gradient(q, time, axis=0)
    tau = predict(ROBOT, effects, q, dq, np.gradient(dq, time, axis=0), time)
    tau += np.random.default_rng(seed).normal(size=tau.shape)
    return Trajectory(f"{split}_{seed}", split, time, {"q": q, "dq": dq, "tau": tau})


def judged(effects: Sequence[Effect], seed: int) -> tuple[Judge, list[Term]]:
    settings = LoopSettings()
    train, test = mostly_one_way(effects, seed, "train"), mostly_one_way(effects, seed + 50, "test")
    judge, terms, _ = gather(Model(ROBOT), read_motion(ROBOT, [train], [test], settings), settings)
    return judge, terms


def named(effects: Sequence[Effect]) -> list[set[tuple[str, str]]]:
    out = []
    for seed in SEEDS:
        judge, terms = judged(effects, seed)
        out.append({(t.effect, ROBOT.joint_names[t.index]) for t in complete(judge, [], terms)[1]})
    return out


def test_friction_and_offset_that_hide_each_other_are_named_together(monkeypatch: pytest.MonkeyPatch) -> None:
    # Two thirds of a floor each; alone viscous friction looks most like both of them.
    hidden = [
        Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 0.26}),
        Effect("torque_offset", (SHOULDER,), {"offset": 0.26}),
    ]
    truth = {(e.effect, e.joints[0]) for e in hidden}
    found = named(hidden)
    assert sum(names == truth for names in found) >= 3
    assert all(names <= truth for names in found)
    # Control: one by one another is called first, and then they are not sure.
    monkeypatch.setattr(complete_module, "_together", lambda judge, chosen, *rest: chosen)
    assert sum(names == truth for names in named(hidden)) <= 1


def test_each_joint_asks_at_its_share_of_the_level(monkeypatch: pytest.MonkeyPatch) -> None:
    hidden = [
        Effect("coulomb_friction", (SHOULDER,), {"coulomb_torque": 2.0}),
        Effect("torque_offset", (SHOULDER,), {"offset": 2.0}),
    ]
    judge, terms = judged(hidden, SEEDS[0])
    share = judge.settings.significance / judge.evidence.n
    for chance, asked in ((0.9 * share, True), (1.1 * share, False)):
        monkeypatch.setattr(complete_module, "_chance", lambda *_, p=chance: p)
        names = ["coulomb_friction", "torque_offset"]
        assert bool(complete_module._together(judge, [], terms, names, 0)) is asked


def test_nothing_is_named_together_where_nothing_is() -> None:
    assert named([]) == [set()] * len(SEEDS)


def test_the_chance_of_a_group_is_uniform_where_nothing_is_there() -> None:
    # Student's assumption: coefficients from the mean of 20 correlated parts, their covariance from the same parts.
    rng = np.random.default_rng(0)
    mix = np.array([[1.0, 0.0, 0.0], [0.9, 0.4, 0.0], [-0.5, 0.3, 0.8]])
    parts = rng.normal(size=(4000, 20, 3)) @ mix.T
    chances = [_chance(p.mean(axis=0), np.cov(p.T) / 20, 20) for p in parts]
    for level in (0.01, 0.1, 0.5):
        # Three standard deviations of a share out of 4000.
        assert np.mean(np.array(chances) < level) == pytest.approx(level, abs=3 * np.sqrt(level * (1 - level) / 4000))
    # Control: a shift of two standard errors in one, much more where the others say where it must be, is seen.
    shift = np.array([0.4, 0.0, 0.0])
    assert np.median([_chance(p.mean(axis=0) + shift, np.cov(p.T) / 20, 20) for p in parts]) < 0.01


def test_as_many_parts_as_coefficients_say_nothing() -> None:
    assert _chance(np.ones(3), np.eye(3), 3) == 1.0


#: Four joints in a row, about the vertical and a horizontal axis in turn.
FOUR = Robot.from_text(
    '<robot name="four"><link name="l0"/>'
    + "".join(
        f'<link name="l{k}"><inertial><origin xyz="0.1 0 0.02"/><mass value="{5 - k}"/><inertia ixx="0.01" iyy="0.02" '
        'izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="j{k}" type="revolute"><origin xyz="0.2 0 0"/><parent link="l{k - 1}"/><child link="l{k}"/>'
        f'<axis xyz="0 {(k + 1) % 2} {k % 2}"/>'
        '<limit lower="-3" upper="3" velocity="5" effort="40"/></joint>'
        for k in range(1, 5)
    )
    + "</robot>",
    "four.urdf",
)


def rubbing(torques: Sequence[float], seed: int, split: str) -> Trajectory:
    """20 s of four joints with dry friction of ``torques`` [N m], little noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(2000) / 100.0
    speed, phase = 1.1 * (1.0 + 0.17 * np.arange(4)), rng.uniform(0.0, 6.0, (3, 4))
    q = sum(0.6 / k * np.sin(k * speed * time[:, None] + phase[k - 1]) for k in (1, 2, 3))
    dq = np.gradient(q, time, axis=0)
    effects = [
        Effect("coulomb_friction", (name,), {"coulomb_torque": torque})
        for name, torque in zip(FOUR.joint_names, torques, strict=True)
        if torque
    ]
    tau = predict(FOUR, effects, q, dq, np.gradient(dq, time, axis=0), time) + 0.02 * rng.normal(size=q.shape)
    return Trajectory(f"{split}_{seed}", split, time, {"q": q, "dq": dq, "tau": tau})


@pytest.mark.parametrize(("others", "named_joints"), [(2.0, [0, 1, 2, 3]), (0.0, [0])])
def test_what_sits_on_most_joints_need_only_be_sure_on_the_others(others: float, named_joints: list[int]) -> None:
    """A tenth of the torque is of practical size here; 0.02 N m on the last joint is less, and sure."""
    settings = LoopSettings(effects=("coulomb_friction",), torque_share=0.01)
    train, test = (rubbing((2.0, others, others, 0.02), seed, split) for seed, split in enumerate(("train", "test")))
    judge, terms, _ = gather(Model(FOUR), read_motion(FOUR, [train], [test], settings), settings)
    assert np.sqrt(judge.settings.torque_share * judge.torque_variance[3]) > 0.02
    assert [t.joint for t in complete(judge, [], terms)[1]] == named_joints
