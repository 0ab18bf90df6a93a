"""Which data a result was made from: one MLflow dataset a split, by digest, without copying a row."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

#: MLflow's column for a digest holds 36 characters; the whole SHA-256 stands in the run's tag ``data_digest``.
DIGEST_LENGTH = 32
CONTEXTS = {"train": "training", "test": "testing"}


@dataclass(frozen=True)
class InputRecord:
    """Runs of one split: ``source`` is the file relative to the project's root, ``schema`` and ``profile`` are JSON."""

    name: str
    digest: str
    context: str
    source: str
    schema: str
    profile: str


def input_records(
    path: Path, digest: str, dataset: str, provenance: str, origin: Mapping[str, Any], below: str = ""
) -> tuple[InputRecord, ...]:
    """One record for each split of the trajectory file ``path``, whose SHA-256 is ``digest``.

    ``origin`` is the dataset's ``source.json`` (empty for simulated data); ``below`` the folder of the dataset's that
    holds the file.
    """
    file = pq.ParquetFile(path)
    columns = [
        {"type": "string" if name in ("trajectory", "split") else "double", "name": name, "required": True}
        for name in file.schema_arrow.names
    ]
    rows = file.read(columns=["trajectory", "split"]).group_by(["split", "trajectory"], use_threads=False)
    counted = rows.aggregate([([], "count_all")]).to_pylist()
    where = {key: origin[key] for key in ("repository", "commit", "licence") if origin.get(key)}
    out = []
    for split in sorted({str(row["split"]) for row in counted}, reverse=True):
        runs = {str(row["trajectory"]): int(row["count_all"]) for row in counted if row["split"] == split}
        profile = {"provenance": provenance, **where, "runs": len(runs), "rows": sum(runs.values()), "rows_of": runs}
        out.append(
            InputRecord(
                name=f"{dataset} {split}",
                digest=digest[:DIGEST_LENGTH],
                context=CONTEXTS.get(split, split),
                source=(Path("data") / dataset / below / path.name).as_posix(),
                schema=json.dumps({"mlflow_colspec": columns}),
                profile=json.dumps(profile),
            )
        )
    return tuple(out)
