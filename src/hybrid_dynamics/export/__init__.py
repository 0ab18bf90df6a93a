"""Taking a completed model away: into a URDF, a simulator, a controller, an optimiser. One module a format."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterable
from pathlib import Path

from hybrid_dynamics.errors import InputError, MissingDependencyError
from hybrid_dynamics.export.source import Rendered, Source
from hybrid_dynamics.files import atomic_path, check_target

#: Module, file endings (the first is the usual one) and needed library of every format of a completed model.
FORMATS: dict[str, tuple[str, tuple[str, ...], str]] = {
    "urdf": ("urdf", (".urdf",), "pinocchio"),
    "mjcf": ("mjcf", (".xml", ".mjcf"), "pinocchio"),
    "c": ("c_source", (".c",), "casadi"),
    "python": ("python_source", (".py",), "casadi"),
    "casadi": ("casadi_function", (".casadi",), "casadi"),
}


def render(source: Source, form: str, name: str) -> Rendered:
    """The files of format ``form`` under file name ``name``; raises :class:`MissingDependencyError` without its library."""
    module, endings, library = FORMATS[form]
    if Path(name).suffix.lower() not in endings:
        raise InputError(f"{name}: expected a file name that ends in {' or '.join(endings)} for --format {form}")
    try:
        importlib.import_module(library)
    except ImportError:
        raise MissingDependencyError(
            f"--format {form} needs {library}; install it with pip install 'hybrid-dynamics[export]'"
        ) from None
    writer = importlib.import_module(f"{__name__}.{module}")
    rendered: Rendered = writer.render(source, name, source.head(form))
    return rendered


def export(source: Source, form: str, out: str | os.PathLike[str], strict: bool = False, force: bool = False) -> list[str]:
    """Write the completed model of ``source`` to ``out`` and return what the user should be told, a line each.

    Raises :class:`InputError` where ``out`` exists (without ``force``), is an input or cannot be written, and with
    ``strict`` where the format cannot carry the whole model. Nothing is written then.
    """
    target = Path(out)
    check_target(target, [source.urdf])
    losses = source.losses(form)
    if strict and losses:
        raise InputError(f"{form} cannot carry {' | '.join(losses)}; choose another format, or leave out --strict")
    rendered = render(source, form, target.name)
    places = [target.with_name(name) for name in rendered.files]
    write_files(dict(zip(places, rendered.files.values(), strict=True)), force)
    lines = [f"{place}: written" for place in places]
    lines += [f"note: {form} cannot carry {line}" for line in losses]
    lines += [f"note: {effect.effect} is left out: held-out runs contradict it" for effect in source.model.inactive]
    return lines + [f"note: {note}" for note in rendered.notes]


def write_files(files: dict[Path, bytes], force: bool) -> None:
    """Write all ``files``, each atomically; none where one of them exists and ``force`` is not given."""
    for path in files:
        check_target(path)
        if path.exists() and not force:
            raise InputError(f"{path}: exists; give another name, or --force to replace it")
    for path, content in files.items():
        with atomic_path(path) as temporary:
            temporary.write_bytes(content)


def formats() -> Iterable[str]:
    """Names of the formats of a completed model."""
    return FORMATS


__all__ = ["FORMATS", "Rendered", "Source", "export", "formats", "render", "write_files"]
