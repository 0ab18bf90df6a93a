"""The feature matrix: order of its columns, and rigid-body columns that sum to inverse dynamics."""

import numpy as np
import pytest

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.features import add_features, feature_matrix, feature_names
from hybrid_dynamics.robots import Robot, find_description
from hybrid_dynamics.trajectory import Trajectory


@pytest.fixture(scope="module")
def robot():
    return Robot.from_urdf(
        find_description("panda_description/urdf/panda.urdf"), ("panda_finger_joint1", "panda_finger_joint2")
    )


@pytest.fixture
def trajectory(robot):
    rng = np.random.default_rng(1)
    signals = {name: rng.normal(size=(30, robot.n_joints)) for name in ("q", "dq", "ddq", "dddq", "tau")}
    return Trajectory("run", "train", np.arange(30) * 0.01, signals)


def test_columns_stand_in_the_order_of_their_names(robot, trajectory):
    full = add_features(robot, trajectory)
    matrix, names = feature_matrix(full), feature_names(robot.n_joints)
    assert matrix.shape == (30, 7 * robot.n_joints)
    assert names[:2] == ("q1", "q2")
    assert names[-1] == "tau_gravity7"
    for column, name in zip(matrix.T, names, strict=True):
        np.testing.assert_array_equal(column, full[name[:-1]][:, int(name[-1]) - 1])


def test_torque_features_sum_to_inverse_dynamics(robot, trajectory):
    full = add_features(robot, trajectory)
    total = full["tau_inertia"] + full["tau_coriolis"] + full["tau_gravity"]
    truth = robot.inverse_dynamics(trajectory["q"], trajectory["dq"], trajectory["ddq"])
    np.testing.assert_allclose(total, truth, atol=1e-9)
    still = robot.inverse_dynamics(trajectory["q"], 0 * trajectory["q"], 0 * trajectory["q"])
    np.testing.assert_allclose(full["tau_gravity"], still, atol=1e-9)


def test_missing_signal_is_named(trajectory):
    with pytest.raises(InputError, match="tau_inertia"):
        feature_matrix(trajectory)
