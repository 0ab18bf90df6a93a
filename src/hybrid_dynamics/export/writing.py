"""Exporting files to files: what ``hybrid-dynamics export`` does, for programs."""

from __future__ import annotations

import importlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from hybrid_dynamics.errors import InputError, needs_extra
from hybrid_dynamics.export import FORMATS, NETWORK
from hybrid_dynamics.export.source import Source, name
from hybrid_dynamics.files import atomic_path, check_target
from hybrid_dynamics.robots import Robot

PathLike = str | os.PathLike[str]


@dataclass(frozen=True)
class Exported:
    """``files`` written (the one asked for first); ``lost``, ``left_out`` and ``notes``: a line each for the user.

    ``lost`` is what the format cannot carry, ``left_out`` effects that held-out runs contradict.
    """

    files: tuple[Path, ...]
    lost: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def export(
    model: PathLike,
    robot: PathLike,
    form: str,
    out: PathLike,
    lock: Sequence[str] = (),
    strict: bool = False,
    force: bool = False,
) -> Exported:
    """Write the model in the file ``model`` (of the robot in the URDF ``robot``) to ``out``, in one of :data:`FORMATS`.

    Raises :class:`InputError` where a file is unusable, ``out`` exists (without ``force``), is an input or cannot be
    written, and with ``strict`` where the format cannot carry all of the model; :class:`MissingDependencyError` without
    the format's library. Nothing is written then.
    """
    target, kind = Path(out), FORMATS[form]
    if target.suffix.lower() not in kind.endings:
        raise InputError(f"{target}: expected a file name that ends in {' or '.join(kind.endings)} for --format {form}")
    _check(target, [model, robot], force)
    writer = _writer(form)
    lost: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    if form == NETWORK:
        rendered = writer.render(Path(model), Robot.from_urdf(robot, tuple(lock)), target.name)
    else:
        source = Source.read(Path(model), Path(robot), tuple(lock))
        lost, left_out = tuple(source.losses(form)), tuple(name(effect) for effect in source.inactive)
        if strict and lost:
            raise InputError(f"{form} cannot carry {' | '.join(lost)}; choose another format, or leave out --strict")
        rendered = writer.render(source, target.name, source.head(form))
    files = {target.with_name(file): content for file, content in rendered.files.items()}
    for path in files:
        _check(path, [model, robot], force)
    for path, content in files.items():
        with atomic_path(path) as temporary:
            temporary.write_bytes(content)
    return Exported(tuple(files), lost, left_out, tuple(rendered.notes))


def _check(path: Path, inputs: Sequence[PathLike], force: bool) -> None:
    check_target(path, inputs)
    if path.exists() and not force:
        raise InputError(f"{path}: exists; give another name, or --force to replace it")


def _writer(form: str) -> ModuleType:
    kind = FORMATS[form]
    with needs_extra(kind.extra, f"--format {form}"):
        return importlib.import_module(f"hybrid_dynamics.export.{kind.module}")
