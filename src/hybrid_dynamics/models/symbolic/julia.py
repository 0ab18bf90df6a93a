"""Julia for PySR: found and tried before any work starts, and whatever is wrong with it said in one line."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hybrid_dynamics.errors import MissingDependencyError

#: What PySR's Julia part asks for (its ``juliapkg.json``: =1.10.0 or 1.10.3 and later).
OLDEST = (1, 10, 3)
ALSO = (1, 10, 0)
#: Variables that name the Julia to use; the first one set counts, as for juliapkg.
VARIABLES = ("PYTHON_JULIAPKG_EXE", "PYTHON_JULIACALL_EXE")
REMEDY = "or choose sr=operon, which needs nothing more"


def find_julia() -> str | None:
    """Path of a Julia program: the one PythonCall is told to use, on the PATH, in juliaup or installed by juliapkg."""
    for variable in VARIABLES:
        if os.environ.get(variable):
            return shutil.which(os.environ[variable])
    places = [
        Path(sys.prefix) / "julia_env" / "pyjuliapkg" / "install" / "bin",
        Path.home() / ".juliaup" / "bin",
    ]
    return shutil.which("julia") or shutil.which("julia", path=os.pathsep.join(str(place) for place in places))


def check_julia() -> str:
    """Path of a Julia that runs and is new enough; :class:`MissingDependencyError` says what is wrong and the remedy.

    Meant to be asked before long work: it starts ``julia --version`` and nothing else.
    """
    julia = find_julia()
    if julia is None:
        told = _told()
        if told:
            raise MissingDependencyError(
                f"sr=pysr needs Julia, and {told} names no program; correct or unset it, {REMEDY}"
            )
        raise MissingDependencyError(
            "sr=pysr needs Julia, and none was found; install Julia 1.10.3 or later from "
            f"https://julialang.org/downloads and put it on the PATH, {REMEDY}"
        )
    try:
        done = subprocess.run(
            [julia, "--version"], capture_output=True, text=True, timeout=120, check=False, stdin=subprocess.DEVNULL
        )
        said, failed = f"{done.stdout}{done.stderr}", done.returncode != 0
    except (OSError, subprocess.TimeoutExpired) as error:
        said, failed = str(error), True
    found = re.search(r"julia version (\d+)\.(\d+)\.(\d+)", said)
    where = f"{julia}{f' (from {_told()})' if _told() else ''}"
    if failed or found is None:
        raise MissingDependencyError(
            f"sr=pysr needs Julia, and {where} is none that runs ({_first(said) or 'it says nothing'}); install Julia "
            f"1.10.3 or later{', or correct that variable' if _told() else ''}, {REMEDY}"
        )
    version = tuple(int(part) for part in found.groups())
    if version < OLDEST and version != ALSO:
        raise MissingDependencyError(
            f"sr=pysr needs Julia 1.10.3 or later, and {where} is {'.'.join(found.groups())}; install a later one"
            f"{', or correct that variable' if _told() else ''}, {REMEDY}"
        )
    return julia


def unusable(julia: str, error: BaseException, said: str = "") -> MissingDependencyError:
    """The error for a Julia that was found and that PySR cannot work with; ``said`` is what it printed."""
    named = _told() or "PYTHON_JULIAPKG_EXE is not set"
    reason = _complaint(said) or _first(str(error)) or type(error).__name__
    return MissingDependencyError(
        f"sr=pysr: Julia was found ({julia}; {named}) but PySR cannot start it: {reason}; its packages must be "
        "installed or downloadable once (SymbolicRegression, PythonCall): start it once with a network, "
        f"name another Julia with PYTHON_JULIAPKG_EXE, {REMEDY}"
    )


@contextmanager
def overheard(said: list[str]) -> Iterator[None]:
    """Keep what this process and its children print (file descriptors 1 and 2) from the terminal; ``said`` gets it.

    A Julia that fails prints its own traceback before Python prints another.
    """
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    with tempfile.TemporaryFile() as file:
        kept = [os.dup(number) for number in (1, 2)]
        try:
            for number in (1, 2):
                os.dup2(file.fileno(), number)
            yield
        finally:
            for stream in (sys.stdout, sys.stderr):
                with contextlib.suppress(OSError, ValueError):
                    stream.flush()
            for number, descriptor in zip((1, 2), kept, strict=True):
                os.dup2(descriptor, number)
                os.close(descriptor)
            file.seek(0)
            said.append(file.read().decode("utf-8", errors="replace"))


def _told() -> str:
    """``VARIABLE=value`` of the one that names a Julia, or nothing."""
    return next((f"{name}={os.environ[name]}" for name in VARIABLES if os.environ.get(name)), "")


def _first(text: str) -> str:
    """The first line of ``text`` that says anything, shortened."""
    line = next((line.strip() for line in text.splitlines() if line.strip()), "")
    return line if len(line) <= 160 else f"{line[:157]}..."


def _complaint(text: str) -> str:
    """The line of a Julia traceback that names the fault."""
    lines = [line.strip() for line in text.splitlines()]
    return _first("\n".join(line for line in lines if line.startswith(("ERROR", "error", "fatal"))))
