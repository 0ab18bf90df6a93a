"""What all tests share: which of them are slow, and that none depends on luck or on how busy the machine is."""

from __future__ import annotations

from pathlib import Path

import hypothesis
import pytest

# The same examples in every run, however long each takes; others: pytest --hypothesis-profile=default.
hypothesis.settings.register_profile("same", derandomize=True, deadline=None)
hypothesis.settings.load_profile("same")

#: Files of tests that run the pipeline, whole loops on arms with six or seven joints, a browser, a compiler or MLflow:
#: they take part in `make test`, not in `make check`. Single tests of other files are marked where they stand.
SLOW = frozenset(
    {
        "test_benchmarks",
        "test_dvc_traps",
        "test_engine",
        "test_examples",
        "test_export_programs",
        "test_export_resimulate",
        "test_export_round_trip",
        "test_extras",
        "test_faults",
        "test_fleet",
        "test_glitches",
        "test_loop_alternatives",
        "test_loop_cli",
        "test_loop_close",
        "test_loop_friction",
        "test_loop_unseen",
        "test_models_panda",
        "test_pipeline",
        "test_reporting",
        "test_simulation_planted",
        "test_simulation_twin",
        "test_study_engine",
        "test_tracking",
        "test_tracking_loop",
        "test_tracking_park",
        "test_urdf_dynamics",
    }
)
#: Files that take longest, the longest first: begun last, one of them would keep one worker busy while the other idles.
FIRST = (
    "test_pipeline",
    "test_loop_close",
    "test_loop_unseen",
    "test_check_torque",
    "test_loop_mounting",
    "test_loop_scale",
    "test_check_pulled",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of the slow files, and begin with those of :data:`FIRST`."""
    for item in items:
        if Path(item.fspath).stem in SLOW:
            item.add_marker(pytest.mark.slow)
    place = {name: k for k, name in enumerate(FIRST)}
    items.sort(key=lambda item: place.get(Path(item.fspath).stem, len(FIRST)))
