"""The documentation does what it says: commands and tutorial run, links lead somewhere."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from tests.small_arm import URDF, write_logs

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def environment(folder: Path) -> dict[str, str]:
    """``hybrid-dynamics`` and ``python`` of this checkout first on the path, as an installation puts them there."""
    commands = folder / "bin"
    commands.mkdir()
    for name, options in (("hybrid-dynamics", '-c "from hybrid_dynamics.cli import main; main()"'), ("python", "")):
        (commands / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" {options} "$@"\n')
        (commands / name).chmod(0o755)
    path = os.pathsep.join([str(commands), os.environ["PATH"]])
    return {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT / "src")}


def blocks(page: Path) -> list[str]:
    """The shell commands of a page, block by block."""
    return re.findall(r"```bash\n(.*?)```", page.read_text("utf-8"), re.DOTALL)


@pytest.mark.slow
def test_your_own_robot_in_five_minutes_runs_as_it_is_written(tmp_path: Path) -> None:
    write_logs(tmp_path)
    commands = blocks(ROOT / "docs" / "five-minutes.md")
    assert len(commands) == 4
    known = environment(tmp_path)
    for block in commands:
        done = subprocess.run(["bash", "-euo", "pipefail", "-c", block], cwd=tmp_path, env=known, capture_output=True)
        assert done.returncode == 0, f"{block}\n{done.stderr.decode()}"
    page = (tmp_path / "result" / "report.html").read_text("utf-8")
    assert "Viscous friction on shoulder" in page
    assert "Coulomb friction on elbow" in page
    for name in ("predicted.parquet", "completed.urdf", "completed.py", "changed/report.html"):
        assert (tmp_path / name).is_file()


@pytest.mark.slow
def test_the_commands_of_the_readme_run_as_they_are_written(tmp_path: Path) -> None:
    """Those for one's own robot, on the arm that the first of them writes."""
    (block,) = (b for b in blocks(ROOT / "README.md") if "hybrid-dynamics" in b)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", block],
        cwd=tmp_path,
        env=environment(tmp_path),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    for name in ("result/report.html", "predicted.parquet", "completed.urdf"):
        assert (tmp_path / "demo" / name).is_file()
    assert "hidden: viscous_friction (shoulder): viscous_coefficient 3" in done.stdout
    assert "missing: viscous friction 3 N m s/rad on shoulder; Coulomb friction 1.5 N m on elbow" in done.stdout


def test_the_tutorial_has_the_arm_of_the_examples() -> None:
    assert URDF in (ROOT / "docs" / "tutorial.py").read_text("utf-8")


@pytest.mark.slow
def test_the_tutorial_finds_what_it_hid(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "docs" / "tutorial.py")],
        env=environment(tmp_path),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    viscous = re.search(r"viscous_friction on shoulder: viscous_coefficient = ([\d.]+)", done.stdout)
    coulomb = re.search(r"coulomb_friction on elbow: coulomb_torque = ([\d.]+)", done.stdout)
    assert viscous
    assert coulomb
    assert float(viscous[1]) == pytest.approx(3.0, rel=0.03)
    assert float(coulomb[1]) == pytest.approx(1.5, rel=0.03)
    assert "report.html" in done.stdout


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_of_a_page_lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        place = page if not file else (page.parent / file).resolve()
        assert place.exists(), f"{page.name} links {target}, which is not there"
        if anchor and place.suffix == ".md":
            heads = re.findall(r"^#+ (.+)$", place.read_text("utf-8"), re.MULTILINE)
            slugs = {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}
            assert anchor in slugs, f"{page.name} links {target}; {place.name} has no such heading"


def test_every_page_is_reached_from_the_index() -> None:
    todo, seen = [ROOT / "docs" / "index.md"], set()
    while todo:
        page = todo.pop()
        if page not in seen and page.suffix == ".md" and page.is_file():
            seen.add(page)
            links = re.findall(r"\]\(([^)\s#:]+)[^)\s]*\)", page.read_text("utf-8"))
            todo += [(page.parent / link).resolve() for link in links]
    assert set((ROOT / "docs").rglob("*.md")) <= seen
