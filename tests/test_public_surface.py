"""What others import: every name is there, costs nothing before it is used, and its example runs."""

from __future__ import annotations

import doctest
import subprocess
import sys

import pytest
from tests.small_arm import arm, runs, write_logs

import hybrid_dynamics
from hybrid_dynamics.loop.diagnosis import write_diagnosis

HEAVY = ("numpy", "pinocchio", "scipy", "torch", "pysindy", "sympy", "pyarrow")


def test_importing_the_package_imports_nothing_else() -> None:
    code = f"import sys, hybrid_dynamics; print([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", hybrid_dynamics.__all__)
def test_every_public_name_is_there_and_explained(name: str) -> None:
    assert name in dir(hybrid_dynamics)
    assert getattr(hybrid_dynamics, name).__doc__


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="clsoe_loop"):
        _ = hybrid_dynamics.clsoe_loop  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory):
    folder = write_logs(tmp_path_factory.mktemp("logs"))
    result = hybrid_dynamics.close_loop(arm(), *runs())
    write_diagnosis(folder / "diagnosis.json", result.diagnosis)
    return folder


@pytest.mark.parametrize("name", hybrid_dynamics.__all__)
def test_the_examples_of_the_public_names_run(name: str, logs, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(logs)
    finder, runner = doctest.DocTestFinder(recurse=False), doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    (found,) = finder.find(getattr(hybrid_dynamics, name), name, globs={})
    assert found.examples, f"{name} has no example"
    report: list[str] = []
    runner.run(found, out=report.append)
    assert not runner.failures, "".join(report)
