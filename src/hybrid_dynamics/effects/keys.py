"""Keys of parameters, names of joints, settings that can be compared: what families share beside their equations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.types import Array


def joint_number(robot: Robot, name: str, who: str) -> int:
    """0-based index of joint ``name``; :class:`InputError` lists those there are."""
    if name not in robot.joint_names:
        raise InputError(
            f"{who}: robot {robot.name} has no joint {name!r}; its joints are {', '.join(robot.joint_names)}"
        )
    return robot.joint_names.index(name)


def hashable(value: Any) -> Any:
    """Lists (as JSON has them) as tuples."""
    return tuple(hashable(v) for v in value) if isinstance(value, list | tuple) else value


def split_key(key: str) -> tuple[str | None, str]:
    """Joint (None without one) and name of a published parameter's key."""
    joint, _, name = key.rpartition("/")
    return joint or None, name


def central_difference(function: Callable[[Array], Array], at: Array, steps: Array) -> Array:
    """Central differences: (len(function), len(at))."""
    columns = []
    for k, h in enumerate(steps):
        up, down = at.copy(), at.copy()
        up[k] += h
        down[k] -= h
        columns.append((function(up) - function(down)) / (2 * h))
    return np.stack(columns, axis=1) if columns else np.zeros((len(function(at)), 0))
