"""Taking a completed model away: into a URDF, a simulator, a controller, an optimiser. One module a format."""

from __future__ import annotations

import importlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from hybrid_dynamics.errors import InputError, MissingDependencyError
from hybrid_dynamics.export.source import Source, name
from hybrid_dynamics.files import atomic_path, check_target
from hybrid_dynamics.robots import Robot

PathLike = str | os.PathLike[str]

NETWORK = "onnx"


@dataclass(frozen=True)
class Format:
    """Module that renders it, file endings, the library it needs and the extra that brings it."""

    module: str
    endings: tuple[str, ...]
    library: str = "casadi"
    extra: str = "export"


FORMATS: dict[str, Format] = {
    "urdf": Format("urdf", (".urdf",)),
    "mjcf": Format("mjcf", (".xml", ".mjcf"), "mujoco"),
    "c": Format("c_source", (".c",)),
    "python": Format("python_source", (".py",)),
    "casadi": Format("casadi_function", (".casadi",)),
    NETWORK: Format("onnx_graph", (".onnx",), "onnx", NETWORK),
}


def export(
    model: PathLike,
    robot: PathLike,
    form: str,
    out: PathLike,
    lock: Sequence[str] = (),
    strict: bool = False,
    force: bool = False,
) -> list[str]:
    """Write the model in the file ``model`` (of the robot in the URDF ``robot``) to ``out``, in one of :data:`FORMATS`.

    Returns what the user should be told, a line each. Raises :class:`InputError` where a file is unusable, ``out``
    exists (without ``force``), is an input or cannot be written, and with ``strict`` where the format cannot carry all
    of the model; :class:`MissingDependencyError` without the format's library. Nothing is written then.
    """
    target, kind = Path(out), FORMATS[form]
    if target.suffix.lower() not in kind.endings:
        raise InputError(f"{target}: expected a file name that ends in {' or '.join(kind.endings)} for --format {form}")
    check_target(target, [model, robot])
    writer = _writer(form)
    if form == NETWORK:
        rendered, losses, told = writer.render(Path(model), Robot.from_urdf(robot, tuple(lock)), target.name), [], []
    else:
        source = Source.read(Path(model), Path(robot), tuple(lock))
        losses = source.losses(form)
        if strict and losses:
            raise InputError(f"{form} cannot carry {' | '.join(losses)}; choose another format, or leave out --strict")
        told = [f"{name(effect)} is left out: held-out runs contradict it" for effect in source.inactive]
        rendered = writer.render(source, target.name, source.head(form))
    places = [target.with_name(file) for file in rendered.files]
    write_files(dict(zip(places, rendered.files.values(), strict=True)), force)
    notes = [f"{form} cannot carry {line}" for line in losses] + told + list(rendered.notes)
    return [f"{place}: written" for place in places] + [f"note: {note}" for note in notes]


def _writer(form: str) -> ModuleType:
    kind = FORMATS[form]
    try:
        importlib.import_module(kind.library)
    except ImportError:
        raise MissingDependencyError(
            f"--format {form} needs {kind.library}; install it with pip install 'hybrid-dynamics[{kind.extra}]'"
        ) from None
    return importlib.import_module(f"{__name__}.{kind.module}")


def write_files(files: dict[Path, bytes], force: bool) -> None:
    """Write all ``files``, each atomically; none where one of them exists and ``force`` is not given."""
    for path in files:
        check_target(path)
        if path.exists() and not force:
            raise InputError(f"{path}: exists; give another name, or --force to replace it")
    for path, content in files.items():
        with atomic_path(path) as temporary:
            temporary.write_bytes(content)


__all__ = ["FORMATS", "Format", "export", "write_files"]
