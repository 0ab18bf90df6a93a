"""How far the motion of the test runs lies outside that of the training runs, per joint and variable."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hybrid_dynamics.effects.units import unit_at
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.robots import Robot

#: Less than this share of samples outside the training range is no extrapolation worth a word.
SHARE = 0.01
VARIABLES = (("q", "rad"), ("dq", "rad/s"), ("ddq", "rad/s^2"))


def extrapolation(robot: Robot, train: Sequence[Run], test: Sequence[Run]) -> list[dict[str, Any]]:
    """A row per joint and variable of which more than :data:`SHARE` of the test samples lie outside the training range.

    ``beyond`` is the farthest sample's distance from that range, in widths of the range.
    """
    rows = []
    for variable, unit in VARIABLES:
        seen = np.concatenate([getattr(run, variable) for run in train])
        asked = np.concatenate([getattr(run, variable) for run in test])
        low, high = seen.min(axis=0), seen.max(axis=0)
        distance = np.maximum(np.maximum(low - asked, asked - high), 0.0)
        share = np.mean(distance > 0, axis=0)
        for j in map(int, np.flatnonzero(share > SHARE)):
            rows.append(
                {
                    "joint": robot.joint_names[j],
                    "variable": variable,
                    "unit": unit_at(unit, robot.joint_names[j], robot.prismatic),
                    "train": [float(low[j]), float(high[j])],
                    "test": [float(asked[:, j].min()), float(asked[:, j].max())],
                    "share_outside": float(share[j]),
                    "beyond": float(distance[:, j].max() / max(high[j] - low[j], 1e-12)),
                }
            )
    return sorted(rows, key=lambda r: (-r["share_outside"], r["joint"], r["variable"]))
