"""The Panda's seventh joint, where the rigid-body torques are smallest: Table III's hardest row."""

import numpy as np
import pytest

from hybrid_dynamics.features import feature_names
from hybrid_dynamics.models import (
    HybridEstimator,
    RigidBody,
    SymbolicEstimator,
    SymbolicSettings,
    symbolic_regression,
)
from hybrid_dynamics.models.base import check_data
from hybrid_dynamics.robots import Robot, find_description

DAMPING = np.array([6.75, 6.0, 5.25, 4.5, 3.75, 3.0, 2.25])
#: Relative size of what finite sampling leaves in simulated data.
SAMPLING_ERROR = 2e-4


@pytest.fixture(scope="module")
def panda():
    """Features (N, 49) and torque (N, 7): smooth motion with exact derivatives, damping, a structured small error."""
    robot = Robot.from_urdf(
        find_description("panda_description/urdf/panda.urdf"), lock=("panda_finger_joint1", "panda_finger_joint2")
    )
    low, high = robot.position_limits
    rng = np.random.default_rng(11)
    time = np.arange(0.0, 10.0, 0.01)
    runs = []
    for _ in range(6):
        rate = 2 * np.pi * rng.uniform(0.05, 0.5, (5, 7))
        angle = time[:, None, None] * rate + rng.uniform(0, 2 * np.pi, (5, 7))
        size = rng.normal(size=(5, 7))
        size *= 0.35 * (high - low) / np.abs(size).sum(axis=0)
        parts = [np.sin(angle) * size, np.cos(angle) * size * rate]
        parts += [-parts[0] * rate**2, -parts[1] * rate**2]
        q, dq, ddq, dddq = (part.sum(axis=1) for part in parts)
        q += (low + high) / 2
        torque = robot.rigid_body_torques(q, dq, ddq)
        runs.append(np.hstack([q, dq, ddq, dddq, torque.inertia, torque.coriolis, torque.gravity]))
    X = np.concatenate(runs)
    y = RigidBody().predict(X) + DAMPING * X[:, 7:14]
    error = np.tanh(X[:, 21:28] / X[:, 21:28].std(axis=0))
    return check_data(X, y + SAMPLING_ERROR * y.std(axis=0) * error / error.std(axis=0))


def test_small_torques_of_the_last_joint_are_found_and_nothing_else(panda):
    X, y = panda
    found = symbolic_regression(X, y[:, 6], feature_names(7), SymbolicSettings(), joint=7).expression
    terms = {str(term): float(value) for term, value in found.as_coefficients_dict().items()}
    assert terms.keys() == {"dq7", "tau_inertia7", "tau_coriolis7", "tau_gravity7"}
    assert terms["dq7"] == pytest.approx(DAMPING[6], rel=1e-3)
    # The error's share of these columns: their spread is about a hundredth of the torque's.
    for name in ("tau_inertia7", "tau_coriolis7", "tau_gravity7"):
        spread = X[:, feature_names(7).index(name)].std()
        assert abs(terms[name] - 1.0) < 3 * SAMPLING_ERROR * y[:, 6].std() / spread


def test_control_without_damping_nothing_is_left_to_learn(panda):
    X, y = panda
    undamped = y - DAMPING * X[:, 7:14]
    # Where the sampling error is below the share of the torque's variance at which a search is worth it.
    small = SAMPLING_ERROR**2 * y.var(axis=0) < SymbolicSettings().min_gain * undamped.var(axis=0)
    assert small[:4].all()
    hybrid = HybridEstimator(RigidBody(), SymbolicEstimator(SymbolicSettings(max_rounds=1, evaluations=2000)))
    hybrid.fit(X, undamped)
    assert all(e == 0 for e, below in zip(hybrid.residual.expressions_, small, strict=True) if below)  # type: ignore[attr-defined]
