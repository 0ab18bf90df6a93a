"""ONNX of the learned methods: the network of ``nn`` and ``r_nn``, written node by node from its stored weights.

Neither torch nor its exporter is needed: a multilayer perceptron is matrix products and ReLU.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.export.source import Rendered
from hybrid_dynamics.features import feature_names
from hybrid_dynamics.models.base import Estimator, HybridEstimator, RigidBody
from hybrid_dynamics.models.network import NetworkEstimator
from hybrid_dynamics.models.storage import load_estimator
from hybrid_dynamics.robots import Robot

#: Old enough for every runtime in use, new enough for all nodes used here.
OPSET, IR = 17, 8


def render(path: Path, robot: Robot, name: str) -> Rendered:
    """The network in the ``model.json`` at ``path``, for ``robot``."""
    estimator = read_network(path, robot.n_joints)
    head = [
        f"Written by hybrid-dynamics {version('hybrid-dynamics')} (export --format onnx).",
        f"Robot {robot.name}; joints {', '.join(robot.joint_names)}. SI units.",
        "Input X: features as in the metadata. Output tau: torque the drive delivers [N m]. Holds all of the model.",
    ]
    return Rendered({name: graph_of(estimator, head).SerializeToString(deterministic=True)})


def graph_of(estimator: Estimator, head: Sequence[str]) -> onnx.ModelProto:
    """Features ``X`` (N, 7 n), double, to drive torque ``tau`` (N, n) [N m]; :class:`InputError` without a network."""
    n = int(estimator.n_joints_)  # type: ignore[attr-defined]
    nodes: list[onnx.NodeProto] = []
    held: list[onnx.TensorProto] = []
    parts = _add(estimator, n, nodes, held)
    nodes.append(helper.make_node("Sum", parts, ["tau"]))
    graph = helper.make_graph(
        nodes,
        "torque",
        [helper.make_tensor_value_info("X", TensorProto.DOUBLE, ["N", 7 * n])],
        [helper.make_tensor_value_info("tau", TensorProto.DOUBLE, ["N", n])],
        held,
        doc_string="\n".join(head),
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR)
    model.producer_name = "hybrid-dynamics"
    model.doc_string = "\n".join(head)
    helper.set_model_props(model, {"features": ",".join(feature_names(n))})
    onnx.checker.check_model(model, full_check=True)
    return model


def _add(estimator: Estimator, n: int, nodes: list[onnx.NodeProto], held: list[onnx.TensorProto]) -> list[str]:
    """Add the nodes of ``estimator``; returns the names of the torques whose sum it is."""
    if isinstance(estimator, HybridEstimator):
        return _add(estimator.base, n, nodes, held) + _add(estimator.residual, n, nodes, held)
    if isinstance(estimator, RigidBody):
        # The rigid-body torque stands in the features: the sum of their last three blocks.
        block = np.vstack([np.zeros((4 * n, n)), *[np.eye(n)] * 3])
        held.append(numpy_helper.from_array(block, "blocks"))
        nodes.append(helper.make_node("MatMul", ["X", "blocks"], ["rigid_body"]))
        return ["rigid_body"]
    if isinstance(estimator, NetworkEstimator):
        return [_network(estimator, nodes, held)]
    raise InputError(
        f"--format onnx is for the networks (nn, r_nn), and this model holds a {type(estimator).__name__}; its "
        "formulas stand in expressions.csv"
    )


def _network(estimator: NetworkEstimator, nodes: list[onnx.NodeProto], held: list[onnx.TensorProto]) -> str:
    nodes.append(helper.make_node("Cast", ["X"], ["x0"], to=TensorProto.FLOAT))
    layers = [key.removesuffix(".weight") for key in estimator.weights_ if key.endswith(".weight")]
    at = "x0"
    for k, layer in enumerate(layers, 1):
        for part in ("weight", "bias"):
            held.append(numpy_helper.from_array(estimator.weights_[f"{layer}.{part}"], f"{part}{k}"))
        nodes.append(helper.make_node("Gemm", [at, f"weight{k}", f"bias{k}"], [f"y{k}"], transB=1))
        at = f"y{k}"
        if k < len(layers):
            nodes.append(helper.make_node("Relu", [at], [f"x{k}"]))
            at = f"x{k}"
    nodes.append(helper.make_node("Cast", [at], ["network"], to=TensorProto.DOUBLE))
    return "network"


def read_network(path: Path, n_joints: int) -> Estimator:
    """The trained method whose ``model.json`` is ``path``.

    :class:`InputError` where it is one of a loop or of a robot with another number of joints.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        document = {}  # load_estimator says what is wrong with it
    if isinstance(document, dict) and "effects" in document:
        raise InputError(f"{path}: is the model of a closed loop, which holds no network; choose another --format")
    estimator = load_estimator(path.parent)
    own = int(estimator.n_joints_)  # type: ignore[attr-defined]
    if own != n_joints:
        raise InputError(f"{path}: was trained for {own} joints; the robot has {n_joints}")
    return estimator
