"""The loop step by step: how much each named effect lowered the error, on every run."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pandas as pd

from hybrid_dynamics.loop.close import LoopResult
from hybrid_dynamics.loop.diagnosis import errors_of
from hybrid_dynamics.loop.process import Run
from hybrid_dynamics.study.layout import LOOP_COLUMNS, POOL


def step_table(result: LoopResult, dataset: str, provenance: str) -> pd.DataFrame:
    """A row per named effect, run (and the pool of each split) and joint: rmse [N m] before and after it was added."""
    named = result.diagnosis.to_json()["effects"]
    parts: list[tuple[str, str, list[Run]]] = []
    for split, own in (("train", result.train), ("test", result.test)):
        parts += [*((split, run.name, [run]) for run in own), (split, POOL, list(own))]
    rows: list[dict[str, Any]] = []
    for split, trajectory, runs in parts:
        errors = [errors_of(model, runs)["rmse"] for model in result.models]
        for step, ((before, after), effect) in enumerate(zip(pairwise(errors), named, strict=True), 1):
            rows += [
                {
                    "dataset": dataset,
                    "provenance": provenance,
                    "step": step,
                    "effect": effect["effect"],
                    "effect_joints": " ".join(effect["joints"]),
                    "split": split,
                    "trajectory": trajectory,
                    "joint": j,
                    "rmse_before": b,
                    "rmse_after": a,
                }
                for j, (b, a) in enumerate(zip(before, after, strict=True), 1)
            ]
    table = pd.DataFrame(rows, columns=list(LOOP_COLUMNS))
    return table.sort_values(["step", "split", "trajectory", "joint"], kind="stable", ignore_index=True)
