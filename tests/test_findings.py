"""The findings page says what its files say, and no number of it is typed by hand."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from benchmarks.findings import FINDINGS, PAGE, ROOT, Finding, page, section

FIVE = {
    "arm": "z1", "joints": 6, "loop_cpu_s": 20.25, "exports_cpu_s": 9.0, "cpu_s": 29.2, "wall_s": 75.0,
    "load_before": 6.1, "peak_memory_mb": 430, "named_right": 9, "hidden": 10, "named_besides": "armature joint2",
    "exports": 5,
    "held_out_error_before": 0.25, "held_out_error_after": 0.0125, "goal_s": 300.0, "met": "yes",
}  # fmt: skip


COMMITTED = [finding for finding in FINDINGS if finding.file.startswith("docs/")]


@pytest.mark.parametrize("finding", COMMITTED, ids=lambda finding: finding.name)
def test_sections_of_committed_files_are_what_the_files_say(finding: Finding) -> None:
    said = section(finding)
    assert said is not None, f"{ROOT / finding.file} is missing"
    assert said in PAGE.read_text("utf-8"), "run python -m benchmarks.findings"


def test_a_section_follows_its_file_and_stays_where_there_is_none(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    assert "five" not in page("", tmp_path).lower()
    pd.DataFrame([FIVE, FIVE | {"arm": "ur3", "met": "no", "named_besides": ""}]).to_csv(
        tmp_path / "docs" / "five_minutes.csv", index=False
    )
    first = page("", tmp_path)
    assert "| z1 | 6 | 20.2 | 9 | 29 | 75 (6.1) | 430 | 9 of 10 | armature joint2 | 25 % → 1.25 % |" in first
    assert "| nothing | 25 %" in first.split("| ur3")[1]
    assert "met on 1 of 2" in first
    (tmp_path / "docs" / "five_minutes.csv").unlink()
    assert page(first, tmp_path) == first
    assert page(first.replace("| z1 |", "| other |"), tmp_path) != first  # it is kept, not made up


def test_every_table_of_the_study_has_its_words(tmp_path: Path) -> None:
    (tmp_path / "reports").mkdir()
    state = {"position_before": 0.4, "position_after": 0.1, "velocity_before": 2.0, "velocity_after": 0.5}
    tables: dict[str, list[dict[str, object]]] = {
        "park": [{"dataset": "tx40", "joint": 1, "rigid_body": 3.0, "least_squares": 1.0, "loop": 0.5, "black_box": 0.4,
                  "floor": 0.3, "explained_share": 0.97}],
        "resimulation": [{"dataset": "tx40", "provenance": "recorded", "joint": "j", "windows": 9, "window": 0.5,
                          **state}, {"dataset": "still", "provenance": "recorded", "joint": "j", "windows": 3,
                          "window": 0.5, **state, "position_before": None, "velocity_before": None}],
        "blind": [{"robot": "panda", "hidden": "payload", "size_over_floor": size, "named_right": right,
                   "nothing_wrong_named": True} for size, right in ((9.0, True), (8.0, False), (0.5, False))],
    }  # fmt: skip
    for name, rows in tables.items():
        pd.DataFrame(rows).to_csv(tmp_path / "reports" / f"{name}.csv", index=False)
    made = page("", tmp_path)
    assert "| tx40 | 3 | 1 | 0.5 | 0.4 | 0.3 | 97 % |" in made
    assert "| tx40 (recorded) | 0.4 → 0.1 | 2 → 0.5 | 1 of 1 | 9 |" in made
    assert "| still (recorded) | – → 0.1 | – → 0.5 | all: none moved | 3 |" in made
    assert "No number before: still as its URDF" in made
    assert "| panda | 1 | 1 of 2 (95 %" in made  # the small one is not counted
