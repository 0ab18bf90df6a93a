"""What a closed loop leaves behind: ``diagnosis.json``, ``model.json``, ``report.html``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_dynamics.files import write_text
from hybrid_dynamics.loop.close import LoopResult
from hybrid_dynamics.loop.diagnosis import Diagnosis, write_diagnosis
from hybrid_dynamics.loop.model import save_model
from hybrid_dynamics.loop.uncertainty import correlation_of
from hybrid_dynamics.loop_report.content import CONTENT_FILE, write_content
from hybrid_dynamics.loop_report.gather import gather
from hybrid_dynamics.loop_report.report import content_html

RESULT_FILES = ("diagnosis.json", "model.json", "report.html")


def write_result(
    folder: Path,
    result: LoopResult,
    provenance: Mapping[str, Any] | None = None,
    origin: str = "",
    keep_content: bool = False,
) -> Diagnosis:
    """Write the three files to ``folder``, each atomically; the diagnosis last, so that its presence means all.

    Returns the diagnosis as it is written.

    ``provenance`` is what the page can be made from again, ``origin`` says where the logs come from (``recorded``).
    ``keep_content`` leaves what the page was made from as well, for a page over many loops.
    """
    diagnosis = result.diagnosis
    residual = _residual(diagnosis)
    record: dict[str, Any] = {"uncertainty": {"residual": residual}}
    correlation = correlation_of(result.model, result.train, np.array(residual))
    if correlation is not None:
        record["uncertainty"]["correlation"] = [[round(float(v), 6) + 0.0 for v in row] for row in correlation]
    if provenance is not None:
        diagnosis = replace(diagnosis, provenance=dict(provenance))
        record["provenance"] = dict(provenance)
    content = gather(replace(result, diagnosis=diagnosis), origin)
    page = content_html(content)
    save_model(folder / "model.json", result.model, record)
    if keep_content:
        write_content(folder / CONTENT_FILE, content)
    write_text(folder / "report.html", page)
    write_diagnosis(folder / "diagnosis.json", diagnosis)
    return diagnosis


def is_result(folder: Path) -> bool:
    """Whether ``folder`` holds what :func:`write_result` leaves behind."""
    try:
        value = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(value, dict) and {"schema", "robot", "verdict"} <= set(value)


def _residual(diagnosis: Diagnosis) -> list[float]:
    """(n,) [N m] by which the completed model is off on held-out runs, at least the noise floor."""
    test = diagnosis.error["test"]
    left = (test.after_confirmed or test.after).rmse
    return [max(a, b) for a, b in zip(left, diagnosis.noise_floor, strict=True)]
