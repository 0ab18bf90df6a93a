"""Links lie about their joints: no fit may put their matter elsewhere, however open the data leaves them."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from tests.panda_arm import load_panda
from tests.test_sliding_joints import LIFT

from hybrid_dynamics.effects import Effect, Term, family
from hybrid_dynamics.effects.inertia import ROOM, in_ball, link_parameters, radii, to_body
from hybrid_dynamics.loop import LoopSettings, Model
from hybrid_dynamics.loop.physics import physical_constraints
from hybrid_dynamics.loop.problem import Problem
from hybrid_dynamics.loop.process import process
from hybrid_dynamics.loop.solve import solve
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.trajectory import Trajectory


@pytest.fixture(scope="module")
def panda():
    return load_panda()


PLACES = arrays(float, (5, 3), elements=st.floats(-1.0, 1.0))
MASSES = arrays(float, 5, elements=st.floats(0.01, 3.0))


def cloud(masses, places):
    """Dynamic parameters (10,) of point masses (K,) [kg] at places (K, 3) [m]."""
    squares = np.einsum("k,ki,kj->ij", masses, places, places)
    inertia = np.trace(squares) * np.eye(3) - squares
    entries = [inertia[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
    return np.array([masses.sum(), *(masses @ places), *entries])


@given(MASSES, PLACES)
def test_whatever_lies_in_the_ball_is_allowed(masses, places):
    farthest = float(np.linalg.norm(places, axis=1).max())
    assert in_ball(farthest + 1e-9) @ cloud(masses, places) >= -1e-9


@given(MASSES, PLACES)
def test_whatever_lies_outside_the_ball_is_not(masses, places):
    nearest = float(np.linalg.norm(places, axis=1).min())
    if nearest > 1e-3:
        assert in_ball(0.99 * nearest) @ cloud(masses, places) < 0


def test_a_ball_holds_the_joints_around_a_link_and_its_own_matter(panda):
    size = radii(panda)
    steps = [np.linalg.norm(panda.model.jointPlacements[i].translation) for i in panda.joint_ids]
    for k in range(7):
        assert in_ball(size[k] / ROOM) @ link_parameters(panda, k) >= -1e-9
        if k:
            assert size[k] >= ROOM * steps[k]
            assert size[k - 1] >= ROOM * steps[k]
    # A tool may reach as far as half the arm; the wrist before it may not.
    assert size[6] > 0.4 > size[5]


def test_nothing_is_known_of_a_slide_and_its_rail_of_massless_links_and_of_joints_at_one_place():
    apart = LIFT.replace('<child link="arm"/>', '<child link="arm"/><origin xyz="0.3 0 0"/>')
    assert list(np.isinf(radii(Robot.from_text(apart, "lift")))) == [True, False]
    boom = apart.replace('type="prismatic"', 'type="fixed"').replace('type="revolute"', 'type="prismatic"')
    boom = boom.replace('type="fixed"', 'type="revolute"')
    assert list(np.isinf(radii(Robot.from_text(boom, "boom")))) == [True, True]
    turning = apart.replace('type="prismatic"', 'type="revolute"')
    assert list(np.isinf(radii(Robot.from_text(turning, "arm")))) == [False, False]
    assert (
        list(np.isinf(radii(Robot.from_text(LIFT.replace('type="prismatic"', 'type="revolute"'), "one")))) == [True] * 2
    )
    robot = Robot.from_text(turning, "arm")
    robot.model.inertias[robot.joint_ids[0]] = pin.Inertia.Zero()
    assert list(np.isinf(radii(robot))) == [True, False]


def farthest(robot, reach, pulled):
    """Distance [m] of the centre of mass of the Panda's link 5 from its joint, with balls of ``reach``, where a fit
    keeps its mass and asks for a first moment of ``pulled`` [kg m] more."""
    (term,) = family("inertial_parameters").terms(robot, np.ones(7, bool), {})
    constraints = physical_constraints([term], [0], 70, {}, robot, np.ones(7), reach)
    a, b = np.diag(1.0 / term.prior_scale(robot) ** 2), np.zeros(70)
    a[40, 40] += 1e7
    a[41, 41] += 1e4
    b[41] = 1e4 * pulled
    body = to_body(link_parameters(robot, 4) + solve(a, b, constraints)[40:50])
    return float(np.linalg.norm([body["com_x"], body["com_y"], body["com_z"]]))


@pytest.mark.parametrize("pulled", [2.0, -2.0])
def test_a_link_that_the_data_pulls_away_stays_within_its_ball(panda, pulled):
    size = radii(panda)
    assert farthest(panda, size, pulled) <= size[4] * (1 + 1e-6)
    # Control: without balls it is pulled out.
    assert farthest(panda, None, pulled) > 1.5 * size[4]
    assert farthest(panda, np.full(7, np.inf), pulled) > 1.5 * size[4]


def test_a_starting_model_that_reaches_farther_is_not_made_worse_and_its_ball_does_not_grow(panda):
    term = Term("inertial_parameters", None, (("links", ("panda_joint5",)),))
    far = panda.copy()
    far.model.inertias[far.joint_ids[4]].lever = np.array([5.0, 0.0, 0.0])
    assert in_ball(radii(panda)[4]) @ link_parameters(far, 4) < 0
    started = physical_constraints([term], [0], 10, {}, far, np.ones(7), radii(panda))
    (row,) = started.rows
    np.testing.assert_allclose(row, in_ball(radii(panda)[4]))
    assert started.least[0] == 0.0
    # Control: of the described link there is room.
    near = physical_constraints([term], [0], 10, {}, panda, np.ones(7), radii(panda))
    assert near.least[0] == pytest.approx(-row @ link_parameters(panda, 4))
    assert near.least[0] < 0


def test_a_loop_takes_the_balls_of_the_described_links(panda):
    heavy = Term("inertial_parameters", None, (("links", ("panda_joint5",)),))
    body = to_body(link_parameters(panda, 4)) | {"com_x": 5.0}
    start = Model(panda, (Effect(heavy.effect, (), {f"panda_joint5/{k}": v for k, v in body.items()}, heavy.options),))
    still = np.zeros((200, 7))
    run = Trajectory("still", "train", np.arange(200) / 100.0, {"q": still, "tau": still})
    problem = Problem(start, [process(run, panda, LoopSettings().process)], LoopSettings())
    np.testing.assert_allclose(problem.reach_of_links, radii(panda))
