"""Links lie about their joints: no fit may put their matter elsewhere, however open the data leaves them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from tests.panda_arm import load_panda
from tests.test_sliding_joints import LIFT

from hybrid_dynamics.effects import Term, family
from hybrid_dynamics.effects.inertia import ROOM, in_ball, link_parameters, radii, to_body
from hybrid_dynamics.loop.physics import physical_constraints
from hybrid_dynamics.loop.solve import solve
from hybrid_dynamics.robots import Robot


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
        own = link_parameters(panda, k)
        assert in_ball(size[k] / ROOM) @ own >= -1e-9 or k == 6
        assert in_ball(size[k]) @ own > 0
        if k:
            assert size[k] >= ROOM * steps[k]
            assert size[k - 1] >= ROOM * steps[k]
    # A tool may reach as far as half the arm; the wrist before it may not.
    assert size[6] > 0.4 > size[5]


def test_of_a_slide_and_its_rail_nothing_is_known():
    assert list(np.isinf(radii(Robot.from_text(LIFT, "lift")))) == [True, False]
    above = LIFT.replace('type="prismatic"><parent link="base"/>', 'type="revolute"><parent link="base"/>')
    above = above.replace('name="turn" type="revolute"', 'name="turn" type="prismatic"')
    assert list(np.isinf(radii(Robot.from_text(above, "boom")))) == [True, True]


@pytest.mark.parametrize("pulled", [3.0, -3.0])
def test_a_link_that_the_data_pulls_away_stays_within_its_ball(panda, pulled):
    (term,) = family("inertial_parameters").terms(panda, np.ones(7, bool), {})
    constraints = physical_constraints([term], [0], 70, {}, panda, np.ones(7))
    weight = 1.0 / family("inertial_parameters").prior_scale(panda, term) ** 2
    # A first moment of the forearm (link 5) that asks for a centre of mass metres away; else nothing is known.
    a, b = np.diag(weight), np.zeros(70)
    a[41, 41] += 1e6
    b[41] = 1e6 * pulled
    for k, x in enumerate(solve(a, b, constraints).reshape(7, 10)):
        body = to_body(link_parameters(panda, k) + x)
        centre = np.array([body["com_x"], body["com_y"], body["com_z"]])
        assert np.linalg.norm(centre) <= radii(panda)[k] * (1 + 1e-6)


def test_a_starting_model_that_reaches_farther_is_left_as_it_is(panda):
    far = panda.copy()
    inertia = far.model.inertias[far.joint_ids[4]]
    inertia.lever = np.array([5.0, 0.0, 0.0])
    term = Term("inertial_parameters", None, (("links", ("panda_joint5",)),))
    ((_, _, row),) = family("inertial_parameters").matter(panda, term)
    assert row @ link_parameters(far, 4) < 0
    # What stands there already is no offence; what is not surely inside has its ball about what is.
    constraints = physical_constraints([term], [0], 10, {}, far, np.ones(7))
    assert np.all(constraints.rows @ np.zeros(10) >= constraints.least)
