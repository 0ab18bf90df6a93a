"""What the tests of the exports share: planted effects of every family, and running exported programs."""

from __future__ import annotations

import ctypes
import importlib.util
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np

from hybrid_dynamics.effects import Effect, family
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.robots import Robot, find_description

FINGER = find_description("finger_edu_description/robots/finger_edu.urdf")
STRICT_C = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
CLANG = shutil.which("clang")


def drawn(robot: Robot, name: str, seed: int = 0, std_errors: bool = False) -> Effect:
    """An effect of that family with random values, as a study would hide it."""
    kind = family(name)
    rng = np.random.default_rng(seed)
    moving = np.ones(robot.n_joints, bool)
    term = kind.draw_term(robot, moving, rng)
    parameters, settings = kind.at_term(term, kind.draw(robot, term, rng), robot)
    joints = () if term.joint is None else (robot.joint_names[term.joint],)
    errors = {key: 0.01 + 0.1 * abs(value) for key, value in parameters.items()} if std_errors else {}
    return Effect(name, joints, parameters, settings, errors)


def motion(n: int, rows: int = 40, seed: int = 1) -> tuple[np.ndarray, ...]:
    """``time q dq ddq`` of a run with reversals; the speeds are those of the positions, for laws with a memory."""
    rng = np.random.default_rng(seed)
    time = 0.02 * np.arange(rows)
    phase = rng.uniform(0, 2 * np.pi, (2, n))
    rate = np.array([[9.0], [23.0]])
    parts = [np.sin(r * time[:, None] + p) for r, p in zip(rate, phase, strict=True)]
    slopes = [r * np.cos(r * time[:, None] + p) for r, p in zip(rate, phase, strict=True)]
    bends = [-(r**2) * np.sin(r * time[:, None] + p) for r, p in zip(rate, phase, strict=True)]
    return time, parts[0] + 0.3 * parts[1], slopes[0] + 0.3 * slopes[1], 0.01 * (bends[0] + 0.3 * bends[1])


@dataclass(frozen=True)
class CLibrary:
    """A compiled export: arrays in, an array out."""

    handle: ctypes.CDLL
    n: int
    states: int

    def __call__(self, function: str, *arguments: np.ndarray | float) -> np.ndarray:
        out = np.zeros(self.states if function == "advance" else self.n)
        held = [np.ascontiguousarray(a, float) if isinstance(a, np.ndarray) else a for a in arguments]
        passed = [ctypes.c_double(a) if isinstance(a, float) else _pointer(a) for a in held]
        getattr(self.handle, function)(*passed, _pointer(out))
        return out


def _pointer(array: np.ndarray) -> object:
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def compiled(source: Path, n: int, states: int, *flags: str) -> CLibrary:
    """Compile ``source`` without a warning, by clang too where there is one, and load it."""
    if CLANG is not None:
        done = subprocess.run(
            [CLANG, *STRICT_C, "-fsyntax-only", str(source)], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
    library = source.with_suffix(".so")
    command = ["gcc", *STRICT_C, *flags, "-shared", "-fPIC", "-o", str(library), str(source), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return CLibrary(ctypes.CDLL(str(library)), n, states)


def imported(path: Path) -> ModuleType:
    """Import an exported Python file."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def saved(model: Model, folder: Path) -> Path:
    """``model.json`` of ``model``."""
    path = folder / "model.json"
    model.save(path)
    return path
