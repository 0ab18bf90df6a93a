"""Rigid-body torque and inertial regressor against Pinocchio called directly, on a seven-joint arm."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.data import arm


def _data(samples: int) -> tuple[Any, tuple[np.ndarray, ...]]:
    robot = arm(7)
    return robot, tuple(np.random.default_rng(0).normal(size=(3, samples, 7)))


def rigid_body(side: str, samples: int) -> Callable[[], dict[str, Any]]:
    """Peer: ``rneaInParallel`` on one thread, on arrays that already have its layout."""
    robot, states = _data(samples)
    pool = pin.ModelPool(robot.model, 1)
    columns = [np.asfortranarray(x.T) for x in states]

    def peer() -> dict[str, Any]:
        return {"sum": float(np.abs(pin.rneaInParallel(1, pool, *columns)).sum())}

    def ours() -> dict[str, Any]:
        return {"sum": float(np.abs(robot.inverse_dynamics(*states)).sum())}

    return ours if side == "ours" else peer


def _ours(samples: int) -> Callable[[], dict[str, Any]]:
    robot, states = _data(samples)
    return lambda: {"shape": list(robot.regressor(*states).shape)}


def regressor_loop(side: str, samples: int) -> Callable[[], dict[str, Any]]:
    """Peer: a Python loop over ``computeJointTorqueRegressor`` that keeps the results."""
    if side == "ours":
        return _ours(samples)
    robot, states = _data(samples)

    def peer() -> dict[str, Any]:
        data = robot.model.createData()
        out = np.empty((samples, 7, 70))
        for k, (q, dq, ddq) in enumerate(zip(*states, strict=True)):
            out[k] = pin.computeJointTorqueRegressor(robot.model, data, q, dq, ddq)
        return {"shape": list(out.shape)}

    return peer


def regressor_call(side: str, samples: int) -> Callable[[], dict[str, Any]]:
    """Peer: the calls alone, always the same sample, nothing kept."""
    if side == "ours":
        return _ours(samples)
    robot, states = _data(samples)

    def peer() -> dict[str, Any]:
        data, (q, dq, ddq) = robot.model.createData(), (x[0] for x in states)
        for _ in range(samples):
            pin.computeJointTorqueRegressor(robot.model, data, q, dq, ddq)
        return {}

    return peer
