"""A handful of kills and full disks; ``python -m tests.kill_close_loop`` does as many as wanted."""

from pathlib import Path

import pytest
from tests.kill_close_loop import Trial


@pytest.fixture(scope="module")
def trial(tmp_path_factory) -> Trial:
    return Trial(tmp_path_factory.mktemp("faults"))


def test_kills_and_a_full_disk_leave_whole_results(trial):
    """Killed while it searches and near its end; a disk that takes the small files but not the page."""
    trial.reset()
    assert trial.killed(0.5 * trial.lasts) in ("old", "new")
    for after in (0.01, 0.1):
        trial.reset()
        assert trial.killed(after, writing=True) in ("old", "new")
    trial.reset()
    page = len(trial.new["report.html"])
    assert trial.full(page // 2) == "old"
    assert trial.leftovers() == [] or all(name.startswith(".out.") for name in trial.leftovers())
    # The next run completes, gives the same bytes, and clears away what was left.
    assert trial.start("new").wait() == 0
    assert trial.state() == "new"
    assert trial.leftovers() == []


def test_a_mixture_would_be_seen(trial):
    """The control: the trial can tell."""
    Path(trial.folder / "out" / "report.html").write_bytes(trial.old["report.html"] + b" ")
    assert trial.state().startswith("a mixture")
    trial.reset()
    assert trial.state() == "old"
