"""Writing files so that nothing is ever half-written."""

from __future__ import annotations

import errno
import json
import os
import re
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hybrid_dynamics.errors import InputError


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside ``path``; rename it on success, remove it on any error."""
    target = Path(path)
    check_target(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    # The suffix stays last: matplotlib and others choose the format by it.
    temporary = target.with_name(f".{target.stem}.{os.getpid()}.tmp{target.suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def check_target(path: str | os.PathLike[str], inputs: Iterable[str | os.PathLike[str]] = ()) -> None:
    """Raise :class:`InputError` where no file can be written to ``path``, or where it is one of ``inputs``.

    Meant to be asked before long work as well; nothing is created.
    """
    target = Path(path)
    if target.is_dir():
        raise InputError(f"{target}: is a folder; give a file name for the output")
    check_folder(target.parent)
    for other in inputs:
        if target.exists() and Path(other).exists() and target.samefile(other):
            raise InputError(f"{target}: is an input and would be overwritten; give another name for the output")


def check_once(logs: Sequence[Path], option: str) -> None:
    """Raise :class:`InputError` where ``logs``, given to ``option``, name one file twice, in whatever words."""
    for k, log in enumerate(logs):
        if log.exists() and any(other.exists() and log.samefile(other) for other in logs[:k]):
            raise InputError(f"{log}: the same file is given twice to {option}; it is one run: leave one out")


def check_folder(path: str | os.PathLike[str]) -> None:
    """Raise :class:`InputError` where ``path`` is no folder and cannot become one."""
    folder = Path(path)
    for place in (folder, *folder.parents):
        if place.is_dir():
            if not os.access(place, os.W_OK | os.X_OK) or not _takes_files(place):
                raise InputError(f"{place}: not writable; give another folder for the output")
            return
        if place.exists() or place.is_symlink():
            raise InputError(f"{place}: is a file; give a folder for the results")


def _takes_files(folder: Path) -> bool:
    """Whether a file can be made in ``folder``: permissions alone do not tell (another user's server, ``/proc``)."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError as error:
        # A full disk, say, is no reason to look for another folder.
        return error.errno not in (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOENT)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write UTF-8 text with Unix line ends, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def write_json(path: str | os.PathLike[str], value: Any) -> None:
    """Write JSON with a fixed layout (same value, same bytes); NaN and infinity are refused."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def json_text(value: Any) -> str:
    """JSON with a fixed layout in which a list of numbers takes one line."""
    text = json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False)
    return _NUMBERS.sub(lambda found: f"[{', '.join(found.group(1).split())}]".replace(",,", ","), text) + "\n"


#: A list of numbers, laid out a line each.
_NUMBERS = re.compile(r"\[\s+((?:-?[0-9][0-9.eE+-]*,?\s+)+)\]")
