"""ONNX of the networks: the same torque as the estimator, evaluated by the format's own reference implementation."""

import numpy as np
import onnx
import pytest
from onnx.reference import ReferenceEvaluator
from tests.support_export import FINGER, saved

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.export.writing import export
from hybrid_dynamics.features import feature_names
from hybrid_dynamics.models import NetworkEstimator, NetworkSettings, RigidBody
from hybrid_dynamics.models.base import HybridEstimator
from hybrid_dynamics.models.storage import save_estimator
from hybrid_dynamics.robots import Robot, find_description


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(0)
    return rng.normal(size=(200, 21)), rng.normal(size=(200, 3))


def network():
    return NetworkEstimator(NetworkSettings(hidden=(8, 5), epochs=3, batch_size=50, learning_rate=1e-2))


def evaluated(path, X):
    return ReferenceEvaluator(str(path)).run(["tau"], {"X": X})[0]  # type: ignore[index]


@pytest.mark.parametrize("method", ["nn", "r_nn"])
def test_the_graph_gives_the_estimators_torque(method, data, tmp_path):
    X, y = data
    estimator = network() if method == "nn" else HybridEstimator(RigidBody(), network())
    estimator.fit(X, y)
    save_estimator(estimator, tmp_path)
    done = export(tmp_path / "model.json", FINGER, "onnx", tmp_path / "net.onnx")
    assert done.files == (tmp_path / "net.onnx",)
    # Single precision within: its rounding, not that of the rigid body, which stays double.
    assert evaluated(tmp_path / "net.onnx", X) == pytest.approx(estimator.predict(X), abs=1e-5)
    if method == "r_nn":
        assert np.abs(estimator.predict(X) - estimator.residual.predict(X)).max() > 0.1
    held = onnx.load(tmp_path / "net.onnx")
    assert {p.key: p.value for p in held.metadata_props}["features"] == ",".join(feature_names(3))
    assert "finger" in held.doc_string


def test_large_features_keep_the_rigid_body_in_double(data, tmp_path):
    """1e6 N m of rigid body must not cost the network's digits."""
    X, y = data
    estimator = HybridEstimator(RigidBody(), network()).fit(X, y)
    save_estimator(estimator, tmp_path)
    export(tmp_path / "model.json", FINGER, "onnx", tmp_path / "net.onnx")
    big = np.zeros((1, 21))
    big[0, -1], big[0, -4] = 1e6, -1e6 + 1e-3
    rigid = estimator.base.predict(big)
    parts = evaluated(tmp_path / "net.onnx", big) - np.asarray(estimator.residual.predict(big))
    assert parts == pytest.approx(rigid, abs=1e-1)
    assert rigid[0, 2] == pytest.approx(1e-3, abs=1e-9)


def test_a_closed_loop_holds_no_network(tmp_path):
    from hybrid_dynamics.loop.model import Model

    path = saved(Model(Robot.from_urdf(FINGER)), tmp_path)
    with pytest.raises(InputError, match="holds no network"):
        export(path, FINGER, "onnx", tmp_path / "net.onnx")


def test_formulas_are_no_network(data, tmp_path):
    save_estimator(RigidBody().fit(*data), tmp_path)
    export(tmp_path / "model.json", FINGER, "onnx", tmp_path / "rigid.onnx")
    X, _ = data
    assert evaluated(tmp_path / "rigid.onnx", X) == pytest.approx(RigidBody().predict(X), abs=1e-12)


def test_a_network_of_another_robot_is_refused(data, tmp_path):
    save_estimator(network().fit(*data), tmp_path)
    other = find_description("double_pendulum_description/urdf/double_pendulum_simple.urdf")
    with pytest.raises(InputError, match="trained for 3 joints; the robot has 2"):
        export(tmp_path / "model.json", other, "onnx", tmp_path / "net.onnx")
    assert not (tmp_path / "net.onnx").exists()
