"""Would the tests notice? One operator at a time is turned into its opposite; the tests that run its line must fail.

    pip install pytest-cov
    python -m tests.operator_swaps cover --data build/swaps                 (the suite once: which test runs which line)
    python -m tests.operator_swaps try --data build/swaps --sample 100 --seed 1 --out swaps.csv

writes a row an operator (file, line, what became what, caught, by which test, seconds) and says how many were caught.
Tests are tried in the order of their time, up to ``--seconds`` of them an operator: what is caught later, by a process
of its own or on import only, counts as missed. ``try`` never touches the tree: it works on a copy.
"""

from __future__ import annotations

import argparse
import ast
import csv
import io
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tokenize
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGE = "src/hybrid_dynamics"
#: What is sampled by default.
FOLDERS = ("loop", "effects", "identification", "simulation")
#: An operator and its opposite, both ways.
PAIRS = (
    ("<", ">="),
    (">", "<="),
    ("==", "!="),
    ("in", "not in"),
    ("is", "is not"),
    ("and", "or"),
    ("+", "-"),
    ("*", "/"),
    ("&", "|"),
    ("+=", "-="),
    ("*=", "/="),
    ("&=", "|="),
)
OPPOSITE = {**dict(PAIRS), **{b: a for a, b in PAIRS}}
#: What a copy needs to run the tests.
COPIED = (
    "README.md",
    "src",
    "tests",
    "stages",
    "benchmarks",
    "examples",
    "conf",
    "docs",
    "pyproject.toml",
    "params.yaml",
    "dvc.yaml",
)


@dataclass(frozen=True)
class Swap:
    """The operator ``old`` of ``file`` that ends up as ``new``: characters ``start`` to ``stop`` of the text."""

    file: str
    line: int
    start: int
    stop: int
    old: str
    new: str


def swaps_of(path: Path, name: str) -> list[Swap]:
    """Every operator of the source at ``path`` that has an opposite; those of types and of messages are none."""
    text = path.read_text()
    lines = text.splitlines(keepends=True)
    starts = [0]
    for line in lines:
        starts.append(starts[-1] + len(line))

    def characters(at: tuple[int, int]) -> tuple[int, int]:
        # A syntax tree counts bytes, a tokenizer characters.
        return at[0], len(lines[at[0] - 1].encode()[: at[1]].decode())

    tokens = list(tokenize.generate_tokens(io.StringIO(text).readline))
    words = [t for t in tokens if t.type in (tokenize.OP, tokenize.NAME)]
    out = []
    for before, after in _between(ast.parse(text)):
        left, right = characters(before), characters(after)
        inside = [t for t in words if left <= t.start and t.end <= right and t.string not in ("(", ")")]
        old = " ".join(t.string for t in inside)
        if old in OPPOSITE:
            start = starts[inside[0].start[0] - 1] + inside[0].start[1]
            stop = starts[inside[-1].end[0] - 1] + inside[-1].end[1]
            out.append(Swap(name, inside[0].start[0], start, stop, old, OPPOSITE[old]))
    return sorted(out, key=lambda s: s.start)


def _between(tree: ast.AST) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Where an operator stands between two expressions: the end of the first, the begin of the second."""
    todo: list[ast.AST] = [tree]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.Assert):
            continue
        pairs: list[tuple[ast.AST, ast.AST]] = []
        if isinstance(node, ast.Compare):
            pairs = list(zip([node.left, *node.comparators], node.comparators, strict=False))
        elif isinstance(node, ast.BoolOp):
            pairs = list(zip(node.values, node.values[1:], strict=False))
        elif isinstance(node, ast.BinOp):
            pairs = [(node.left, node.right)]
        elif isinstance(node, ast.AugAssign):
            pairs = [(node.target, node.value)]
        for a, b in pairs:
            yield (a.end_lineno, a.end_col_offset), (b.lineno, b.col_offset)  # type: ignore[attr-defined]
        skipped = {id(getattr(node, part, None)) for part in ("annotation", "returns")}
        todo += [child for child in ast.iter_child_nodes(node) if id(child) not in skipped]


def cover(data: Path) -> None:
    """Run the fast tests once and write into ``data`` which lines each ran and how long it took."""
    data = data.resolve()
    data.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "pytest", "-n", "2", "--dist", "loadfile", "-m", "not slow", "-p", "pytest_cov"]
    command += ["--cov", PACKAGE, "--cov-context=test", "--cov-report=", f"--junit-xml={data / 'times.xml'}"]
    subprocess.run(command, cwd=ROOT, env={**os.environ, "COVERAGE_FILE": str(data / "lines")}, check=False)


@dataclass
class Covered:
    """Which tests run which lines, and how long each lasts [s]."""

    lines: dict[tuple[str, int], frozenset[str]]
    seconds: dict[str, float]

    @classmethod
    def read(cls, data: Path) -> Covered:
        """From what :func:`cover` wrote into ``data``."""
        from coverage import CoverageData  # type: ignore[import-not-found,unused-ignore]

        seconds = {}
        for case in ElementTree.parse(data / "times.xml").iter("testcase"):
            name = f"{case.attrib['classname'].replace('.', '/')}.py::{case.attrib['name']}"
            seconds[name] = float(case.attrib["time"])
        stored = CoverageData(str(data / "lines"))
        stored.read()
        of_file: dict[str, list[str]] = {}
        for name in seconds:
            of_file.setdefault(name.split("::")[0], []).append(name)
        lines = {}
        for file in stored.measured_files():
            short = os.path.relpath(file, ROOT)
            for line, contexts in stored.contexts_by_lineno(file).items():
                tests: set[str] = set()
                for context in filter(None, contexts):
                    test, _, phase = context.rpartition("|")
                    # What is set up once for a file's tests runs in the first of them; each looks at its own part.
                    tests.update(of_file.get(test.split("::")[0], []) if phase == "setup" else [test])
                lines[short, line] = frozenset(tests & seconds.keys())
        return cls(lines, seconds)

    def tests(self, swap: Swap, limit: float) -> list[str]:
        """Tests that run the line of ``swap``, the quickest first, ``limit`` seconds in all."""
        out: list[str] = []
        spent = 0.0
        # A statement over several lines counts at its first.
        line = next((n for n in range(swap.line, 0, -1) if (swap.file, n) in self.lines), 0)
        for test in sorted(self.lines.get((swap.file, line), ()), key=lambda t: (self.seconds[t], t)):
            spent += self.seconds[test]
            if spent > limit and out:
                break
            out.append(test)
        return out


def tried(swap: Swap, tests: Sequence[str], tree: Path, limit: float) -> str:
    """The test that catches ``swap`` in the copy ``tree``, "" where none does."""
    path = tree / swap.file
    text = path.read_text()
    path.write_text(text[: swap.start] + swap.new + text[swap.stop :])
    try:
        failed = _failing(tests, tree, 3 * limit + 120)
    except subprocess.TimeoutExpired:
        return "does not end"
    finally:
        path.write_text(text)
    if failed in tests and _failing([failed], tree, 3 * limit + 120):
        raise SystemExit(f"error: {failed} fails in an unchanged copy, too; make the suite green first")
    return failed


def _failing(tests: Sequence[str], tree: Path, limit: float) -> str:
    """The first of ``tests`` that fails in ``tree``, or that they cannot run; "" where all pass in ``limit`` [s]."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    environment = {**os.environ, "PYTHONPATH": f"{tree}:{tree / 'src'}"}
    done = subprocess.run(
        command, cwd=tree, env=environment, capture_output=True, text=True, timeout=limit, check=False
    )
    if done.returncode == 0:
        return ""
    failed = re.findall(r"^(?:FAILED|ERROR) (tests/.*?)(?: - .*)?$", done.stdout, re.MULTILINE)
    return str(failed[0]) if failed else "cannot be run"


def attempt(arguments: argparse.Namespace) -> int:
    """Try the sample; the number that no test caught."""
    covered = Covered.read(arguments.data)
    files = [p for folder in arguments.folders for p in sorted((ROOT / PACKAGE / folder).rglob("*.py"))]
    pool = [s for p in files for s in swaps_of(p, str(p.relative_to(ROOT)))]
    sample = random.Random(arguments.seed).sample(pool, min(arguments.sample, len(pool)))
    print(f"{len(pool)} operators in {len(files)} files, {len(sample)} of them tried", flush=True)
    missed = 0
    with tempfile.TemporaryDirectory() as folder, arguments.out.open("w", newline="") as file:
        tree = Path(folder)
        for name in COPIED:
            source = ROOT / name
            (shutil.copytree if source.is_dir() else shutil.copy2)(source, tree / name)
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["file", "line", "old", "new", "caught", "by", "tests"])
        for swap in sample:
            started = time.monotonic()
            tests = covered.tests(swap, arguments.seconds)
            by = tried(swap, tests, tree, arguments.seconds) if tests else ""
            missed += not by
            rows.writerow([swap.file, swap.line, swap.old, swap.new, bool(by), by, len(tests)])
            file.flush()
            words = f"caught by {by}" if by else f"MISSED by {len(tests)} tests"
            print(
                f"{swap.file}:{swap.line} {swap.old} -> {swap.new}: {words} ({time.monotonic() - started:.0f} s)",
                flush=True,
            )
    print(f"{len(sample) - missed} of {len(sample)} caught")
    return missed


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["cover", "try"])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--sample", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=150.0, help="of tests for an operator")
    parser.add_argument("--folders", nargs="+", default=FOLDERS)
    parser.add_argument("--out", type=Path, default=Path("swaps.csv"))
    arguments = parser.parse_args()
    if arguments.what == "cover":
        cover(arguments.data)
    else:
        sys.exit(min(attempt(arguments), 1))


if __name__ == "__main__":
    main()
