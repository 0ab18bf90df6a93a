"""Single wrong samples, end to end: found is what the clean logs give (``python -m tests.glitch_sweep`` does all)."""

import csv
from pathlib import Path

import pytest
from tests.glitch_sweep import Case, closed, holds, logs, outcome, summary

import hybrid_dynamics.check.before_fit as before_fit


@pytest.fixture(scope="module")
def clean():
    """What the clean logs give, without and with a measured velocity."""
    return {velocity: closed(*logs(velocity, 2)) for velocity in (False, True)}


@pytest.mark.parametrize(
    "case",
    [
        Case("tau", "train", "one", 1e-4, 3.0, 2),
        Case("tau", "train", "all", 1e-2, 3.0, 2),
        Case("tau", "train", "all", 1e-2, 1000.0, 2),
        Case("tau", "train", "message", 1e-2, 30.0, 2),
        Case("tau", "test", "all", 1e-3, 1000.0, 2),
        Case("q", "train", "all", 1e-3, 30.0, 2),
        Case("q", "test", "one", 1e-2, 3.0, 2),
        Case("dq", "train", "all", 1e-2, 1000.0, 2),
    ],
    ids=str,
)
def test_the_verdict_and_the_parameters_of_the_clean_logs(clean, case):
    row = outcome(case, clean[case.velocity])
    assert holds(row), row
    assert 0.9 < float(str(row["test_error_over_clean"])) < 1.1


def test_without_the_search_for_them_they_would_be_named_or_hide_what_is_missing(clean, monkeypatch):
    """The control."""
    monkeypatch.setattr(before_fit, "repair", lambda run: (run, []))
    row = outcome(Case("tau", "train", "all", 1e-2, 30.0, 2), clean[False])
    assert not holds(row), row
    assert row["told"] == 0


def test_the_page_says_what_the_table_says():
    docs = Path(__file__).parents[1] / "docs"
    rows = list(csv.DictReader((docs / "glitches.csv").open(encoding="utf-8")))
    assert len(rows) >= 200
    assert summary(rows) in " ".join((docs / "logs.md").read_text("utf-8").split())
