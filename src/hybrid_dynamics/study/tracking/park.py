"""Recorded arms of the park as runs: the loop closed on each, beside the rigid body, least squares and a black box."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from hybrid_dynamics.strict_json import read_json
from hybrid_dynamics.study.layout import DatasetFiles
from hybrid_dynamics.study.results import read_csv
from hybrid_dynamics.study.tracking.identified import identified
from hybrid_dynamics.study.tracking.inputs import input_records
from hybrid_dynamics.study.tracking.records import (
    DIAGNOSIS_FILE,
    RunRecord,
    file_digest,
    read_diagnosis,
    result_digest,
    texts_of,
)
from hybrid_dynamics.trajectory import RECORDED

#: The name under which an arm's run stands, as another data set's ``loop`` does.
PARK_METHOD = "park"
MODELS = ("rigid_body", "least_squares", "loop", "black_box", "loop_confirmed")
SHARES = ("explained_share", "against_least_squares", "against_least_squares_error")
WHOLE = ("arm_against_least_squares", "arm_against_least_squares_error")
TABLES = ("joints", "regimes", "parameters")


def park_records(root: Path, arms: Sequence[str], settings: Mapping[str, Any] | None = None) -> list[RunRecord]:
    """A record for every arm of ``arms`` whose recording could be had, from what stage park_arm left below ``root``.

    ``settings`` are the loop's. Raises :class:`InputError` naming a file that is missing.
    """
    found = ((arm, DatasetFiles(arm, root).park) for arm in arms)
    return [record for arm, folder in found for record in _arm(arm, folder, settings or {})]


def _arm(arm: str, folder: Path, settings: Mapping[str, Any]) -> Iterator[RunRecord]:
    told = read_json(folder / "summary.json", "the summary that stage park_arm writes")
    if told["provenance"] != RECORDED:
        return
    diagnosis = read_diagnosis(folder / "loop" / DIAGNOSIS_FILE)
    joints = read_csv(folder / "joints.csv", ("joint", *MODELS))
    logs = folder / "trajectories.parquet"
    data = file_digest(logs)
    found = identified(diagnosis)
    measures = {key: value for key, value in _measures(joints) if math.isfinite(value)}
    chosen = texts_of({"loop": settings})
    yield RunRecord(
        dataset=arm,
        method=PARK_METHOD,
        provenance=RECORDED,
        digest=result_digest(arm, PARK_METHOD, data, measures, chosen, folder / "loop", ()),
        metrics={**measures, **found.metrics},
        params={"dataset": arm, "method": PARK_METHOD, **chosen, **found.params},
        tags={**found.tags, "arm": arm, "provenance": RECORDED, "data_digest": data},
        texts={f"park/{name}.csv": (folder / f"{name}.csv").read_text("utf-8") for name in TABLES},
        features=logs,
        model=folder / "loop",
        inputs=input_records(logs, data, arm, RECORDED, told, below=folder.name),
        finished=(folder / "loop" / DIAGNOSIS_FILE).stat().st_mtime,
    )


def _measures(joints: pd.DataFrame) -> Iterator[tuple[str, float]]:
    """Held-out errors per model and joint [N m], all rows, at the loop's bandwidth; shares of them."""
    for row in joints.to_dict("records"):
        for model in MODELS:
            yield f"park/test/rmse/{model}/joint{row['joint']}", float(row[model])
        for share in SHARES:
            yield f"park/test/{share}/joint{row['joint']}", float(row.get(share, math.nan))
    for share in WHOLE:
        yield (
            f"park/test/{share.removeprefix('arm_')}/arm",
            float(joints[share].iloc[0]) if share in joints else math.nan,
        )
