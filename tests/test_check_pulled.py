"""A strong spring is no sign turned round and no wrong unit: the log is right as it is, and the loop names it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from tests.panda_arm import JOINTS, load_panda

from hybrid_dynamics.check.columns import columns_of, standing
from hybrid_dynamics.check.guess import best_guess
from hybrid_dynamics.check.pulled import _bounded, spring_leaves
from hybrid_dynamics.check.samples import stretches
from hybrid_dynamics.check.torque import check_torque
from hybrid_dynamics.effects import Effect
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.simulation.excitation import excitation


@pytest.fixture(scope="module")
def panda() -> Robot:
    return load_panda()


def _friction(size):
    return [Effect("coulomb_friction", (j,), {"coulomb_torque": size}) for j in JOINTS]


def _hard(robot, run):
    return [f.code for f in check_torque(robot, [run])[0] if f.severity == "hard"]


@pytest.mark.parametrize("stiffness", [5.0, 20.0, 80.0, 300.0])
@pytest.mark.parametrize("joint", [1, 3, 5, 6])
def test_a_spring_is_never_refused(panda, joint, stiffness):
    spring = Effect(
        "joint_spring", (JOINTS[joint],), {"stiffness": stiffness, "rest_position": 0.3}, {"shape": "linear"}
    )
    for friction in (0.0, 0.1):
        run = excitation(panda, [spring, *_friction(friction)], duration=16.0, rate=200.0)
        assert _hard(panda, run) == []


@pytest.mark.parametrize("turned", ["position", "torque"])
def test_a_better_guess_that_a_spring_is_as_good_as_is_no_certainty(panda, turned, monkeypatch):
    """As a spring on the light wrist of a z1 was refused: its weight turned round and forty times over."""
    joint = 5
    spring = Effect("joint_spring", (JOINTS[joint],), {"stiffness": 20.0, "rest_position": 0.3}, {"shape": "linear"})

    def guessed(robot, parts, forms, gravity):
        told, _ = best_guess(robot, parts, forms, gravity)
        scores = tuple(float(np.log(0.11)) if j == joint else s for j, s in enumerate(told.scores))
        sign = tuple(-1 if j == joint else 1 for j in range(7))
        return told, replace(told, scores=scores, sign=sign, mirror=joint if turned == "position" else None)

    monkeypatch.setattr("hybrid_dynamics.check.torque.best_guess", guessed)
    monkeypatch.setattr("hybrid_dynamics.check.torque._shows_its_sign", lambda *_: True)
    run = excitation(panda, [spring], duration=16.0, rate=200.0)
    code = f"{turned}_sign"
    (finding,) = [f for f in check_torque(panda, [run])[0] if f.code == code]
    assert finding.severity == "warning"
    assert not finding.suggestion
    assert "spring" in finding.text
    # Control: where no spring explains as much the better guess stands.
    monkeypatch.setattr("hybrid_dynamics.check.torque.spring_leaves", lambda *_: 0.9)
    (finding,) = [f for f in check_torque(panda, [run])[0] if f.code == code]
    assert finding.severity == "hard"
    assert finding.suggestion


@pytest.mark.parametrize("joint", [1, 3, 5])
def test_a_spring_does_not_stand_for_a_torque_turned_round_or_in_another_unit(panda, joint):
    run = excitation(panda, _friction(0.5), duration=16.0, rate=200.0)
    turned = run.with_signals(tau=run["tau"] * np.where(np.arange(7) == joint, -1, 1))
    assert _hard(panda, turned) == ["torque_sign"]
    assert _hard(panda, run.with_signals(tau=run["tau"] * 1e3)) == ["torque_unit"]


def test_friction_that_would_drive_is_no_spring(panda):
    spring = Effect("joint_spring", (JOINTS[5],), {"stiffness": 20.0, "rest_position": 0.3}, {"shape": "linear"})
    for friction, left in ((0.0, 0.05), (0.5, 0.05)):
        parts = stretches([excitation(panda, [spring, *_friction(friction)], duration=16.0, rate=200.0)])
        q = np.concatenate([p.q for p in parts])
        columns = columns_of(panda, parts)
        assert spring_leaves(columns, q[:, 5], standing(panda), 5) < left
    run = excitation(panda, _friction(1.0), duration=16.0, rate=200.0)
    parts = stretches([run.with_signals(tau=-run["tau"])])
    q = np.concatenate([p.q for p in parts])
    assert spring_leaves(columns_of(panda, parts), q[:, 5], standing(panda), 5) == 1.0


@pytest.mark.parametrize("seed", range(4))
def test_a_tool_on_the_other_side_of_a_wrist_is_never_refused(panda, seed):
    """About as heavy as the flange twice over: its weight turns the torque of the last joints round."""
    own = panda.model.inertias[panda.joint_ids[-1]]
    side = dict(zip(("com_x", "com_y", "com_z"), (-1.5 * np.asarray(own.lever)).tolist(), strict=True))
    block = {f"inertia_{e}": 0.004 * (e[0] == e[1]) for e in ("xx", "xy", "yy", "xz", "yz", "zz")}
    tool = Effect("link_inertia", (JOINTS[-1],), {"mass": 3.0 * own.mass, **side, **block})
    run = excitation(panda, [tool], duration=12.0, rate=100.0, seed=seed)
    assert _hard(panda, run) == []


@pytest.mark.parametrize("torque", [False, True])
@pytest.mark.parametrize("joint", range(6))
def test_no_body_excuses_a_joint_that_is_counted_the_other_way(panda, joint, torque):
    run = excitation(panda, _friction(0.3), duration=12.0, rate=100.0, seed=1)
    turn = np.where(np.arange(7) == joint, -1.0, 1.0)
    signals = {"q": run["q"] * turn, **({"tau": run["tau"] * turn} if torque else {})}
    assert _hard(panda, run.with_signals(**signals)) == ["position_sign"]


def test_a_link_with_its_weight_on_the_other_side_is_no_torque_turned_round(panda):
    """Seen on a wrist of the WAM, too: a run of a few seconds was refused."""
    own = panda.model.inertias[panda.joint_ids[5]]
    side = dict(zip(("com_x", "com_y", "com_z"), (-2.5 * np.asarray(own.lever)).tolist(), strict=True))
    block = {f"inertia_{e}": 0.025 * (e[0] == e[1]) for e in ("xx", "xy", "yy", "xz", "yz", "zz")}
    link = Effect("link_inertia", (JOINTS[5],), {"mass": 2.5 * own.mass, **side, **block})
    run = excitation(panda, [link], duration=6.0, rate=100.0, seed=3)
    assert _hard(panda, run) == []
    # Control: friction that is turned round is of no body.
    run = excitation(panda, _friction(0.3), duration=6.0, rate=100.0, seed=3)
    assert _hard(panda, run.with_signals(tau=run["tau"] * np.where(np.arange(7) == 5, -1, 1))) == ["torque_sign"]


@pytest.mark.parametrize("seed", range(40))
def test_columns_alike_or_of_rounding_leave_what_the_others_do(seed):
    """A body behind a joint acts through few of its ten numbers: the rest is alike, or nothing but rounding."""
    rng = np.random.default_rng(seed)
    acts = rng.normal(size=(300, 6))
    alike, rounding = acts @ rng.normal(size=(6, 6)), 1e-17 * rng.normal(size=(300, 4))
    rounding[:, 3] += 0.1 * acts[:, 5]
    torque = acts @ np.array([-1.0, 2.0, -1.0, 0.5, 1.0, 1.0]) + rng.normal(size=300)
    torque -= torque.mean()
    low, high = np.array([0.3, 0, 0, 0, *[-np.inf] * 10]), np.array([3.0, *[np.inf] * 13])
    x, table, left = _bounded(np.hstack([acts[:, :4], alike, rounding]), torque, low, high)
    assert np.all((low - 1e-9 <= x) & (x <= high + 1e-9))
    assert left == pytest.approx(float(np.sum((torque - table @ x) ** 2)))
    # The six columns that act, of which those alike make the last two, which have no bounds: no better, and no worse
    # than with those that act alone bounded in all signs they may have.
    free = lsq_linear(acts - acts.mean(axis=0), torque, (-np.inf, np.inf))
    bound = lsq_linear(acts - acts.mean(axis=0), torque, ([0.3, 0, 0, 0, -np.inf, -np.inf], [3.0, *[np.inf] * 5]))
    assert 2 * free.cost * (1 - 1e-9) <= left <= 2 * bound.cost * (1 + 1e-6)
