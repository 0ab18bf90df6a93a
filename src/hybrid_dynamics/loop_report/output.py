"""What a closed loop leaves behind: ``diagnosis.json``, ``model.json``, ``report.html``."""

from __future__ import annotations

from pathlib import Path

from hybrid_dynamics.files import write_text
from hybrid_dynamics.loop.close import LoopResult
from hybrid_dynamics.loop.diagnosis import write_diagnosis
from hybrid_dynamics.loop.model import save_model
from hybrid_dynamics.loop_report.report import report_html


def write_result(folder: Path, result: LoopResult) -> None:
    """Write the three files to ``folder``, each atomically; the diagnosis last, so that its presence means all."""
    page = report_html(result)
    save_model(folder / "model.json", result.model)
    write_text(folder / "report.html", page)
    write_diagnosis(folder / "diagnosis.json", result.diagnosis)
