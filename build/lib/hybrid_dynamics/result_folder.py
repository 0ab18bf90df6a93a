"""A folder of results that is there as a whole or not at all.

A command writes into a new sibling of the folder it was asked for; when everything is there, the two change places in
one step of the file system. Whoever looks sees the old results or the new ones, never a mixture: a kill, a full disk or
a second run at any moment leave one of the two. What a killed run has left beside the folder the next one clears away.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.files import check_folder

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2


def check_result_folder(
    folder: str | os.PathLike[str],
    own: Collection[str],
    inputs: Collection[str | os.PathLike[str]] = (),
    *,
    force: bool,
    ours: Callable[[Path], bool] | None = None,
) -> Path:
    """The place that ``folder`` names, links resolved; :class:`InputError` where results cannot be put there.

    ``own`` are the file names the command writes: a folder that holds anything else is not a result of ours and is
    refused, unless ``force`` (what is foreign is kept beside the new results then); and so is one that ``ours`` does
    not recognise. ``inputs`` are files the command reads: none may be among the results it would replace. Meant to be
    asked before long work; nothing is created.
    """
    check_folder(folder)
    place = Path(os.path.realpath(folder))
    check_folder(place.parent)
    if place.is_dir() and os.path.ismount(place):
        raise InputError(f"{folder}: is a mount point and cannot be replaced as a whole; give a folder inside it")
    for other in inputs:
        for name in own:
            target = place / name
            if target.exists() and Path(other).exists() and target.samefile(other):
                raise InputError(f"{target}: is an input and would be overwritten; give another name for the output")
    here = Path.cwd()
    if place == here or place in here.parents:
        raise InputError(
            f"{folder}: is the working folder or holds it, and results replace their folder as a whole; give a new "
            "folder, such as out"
        )
    foreign = _foreign(place, own)
    if foreign and not force:
        more = f" and {len(foreign) - 1} more" if len(foreign) > 1 else ""
        raise InputError(
            f"{folder}: holds {foreign[0]}{more}, so it is not a folder of earlier results; give another folder, or "
            "--force to put the results there (what is not ours stays)"
        )
    if not foreign and not force and ours is not None and place.is_dir() and any(place.iterdir()) and not ours(place):
        name = min(p.name for p in place.iterdir())
        raise InputError(
            f"{folder}: holds {name}, which is not a result of ours; give another folder, or --force to replace it"
        )
    return place


@contextmanager
def result_folder(
    folder: str | os.PathLike[str],
    own: Collection[str],
    *,
    force: bool = False,
    ours: Callable[[Path], bool] | None = None,
) -> Iterator[Path]:
    """Yield a new empty folder; on success it takes the place of ``folder`` in one step, on any error it vanishes."""
    place = check_result_folder(folder, own, force=force, ours=ours)
    place.parent.mkdir(parents=True, exist_ok=True)
    _restore(place)
    _sweep(place)
    temporary, descriptor = _new_sibling(place)
    try:
        yield temporary
        for name in _foreign(place, own):
            _carry_over(place / name, temporary / name)
        temporary.chmod(place.stat().st_mode & 0o7777 if place.is_dir() else 0o777 & ~_umask())
        _to_disk(temporary)
        _swap(temporary, place)
    finally:
        os.close(descriptor)
        shutil.rmtree(temporary, ignore_errors=True)


def _new_sibling(place: Path) -> tuple[Path, int]:
    """A new folder beside ``place``, and its open descriptor.

    Its lock tells other runs that it is still being written; it goes with the process, however that ends.
    """
    while True:
        temporary = Path(tempfile.mkdtemp(prefix=f".{place.name}.", suffix=".tmp", dir=place.parent))
        try:
            descriptor = os.open(temporary, os.O_RDONLY)
        except FileNotFoundError:
            continue
        _lock(descriptor)
        # Another run that starts at this very moment may have taken it, not yet locked, for a leftover.
        if temporary.is_dir():
            return temporary, descriptor
        os.close(descriptor)


def _foreign(place: Path, own: Collection[str]) -> list[str]:
    return sorted(p.name for p in place.iterdir() if p.name not in own) if place.is_dir() else []


def _carry_over(source: Path, target: Path) -> None:
    """``source`` also under ``target``, without a copy where the file system can link."""
    if target.exists():
        return
    if source.is_dir() and not source.is_symlink():
        shutil.copytree(source, target, symlinks=True, copy_function=_link)
    else:
        _link(source, target)


def _link(source: str | os.PathLike[str], target: str | os.PathLike[str]) -> None:
    try:
        os.link(source, target, follow_symlinks=False)
    except OSError:
        shutil.copy2(source, target, follow_symlinks=False)


def _to_disk(folder: Path) -> None:
    """Have the content on the disk before the name points to it: a power failure must not leave empty files."""
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not path.is_symlink():
            with open(path, "rb") as stream:
                os.fsync(stream.fileno())
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # some network file systems know no fsync of a folder
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _swap(new: Path, place: Path) -> None:
    """``new`` becomes ``place``; where ``place`` was there, it becomes ``new`` (and is removed by the caller)."""
    if not place.exists():
        try:
            os.rename(new, place)
            return
        except OSError as error:
            # Another run was faster.
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
    if not _exchange(new, place):
        # No exchange in one step here (not Linux, or an old file system): two steps, and the old results keep a name
        # that the next run knows, so that a kill between the two loses nothing.
        aside = _aside(place)
        shutil.rmtree(aside, ignore_errors=True)
        os.rename(place, aside)
        os.rename(new, place)
        shutil.rmtree(aside, ignore_errors=True)


def _aside(place: Path) -> Path:
    return place.with_name(f".{place.name}.old")


def _restore(place: Path) -> None:
    """Undo the first of two steps where the second never came."""
    aside = _aside(place)
    if aside.is_dir() and not place.exists():
        os.rename(aside, place)


def _exchange(a: Path, b: Path) -> bool:
    """Exchange two names in one step (Linux renameat2); False where that does not exist."""
    if not sys.platform.startswith("linux"):
        return False
    renameat2 = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if renameat2 is None:
        return False
    if renameat2(_AT_FDCWD, os.fsencode(a), _AT_FDCWD, os.fsencode(b), _RENAME_EXCHANGE) == 0:
        return True
    number = ctypes.get_errno()
    if number in (errno.EINVAL, errno.ENOSYS, errno.EXDEV, errno.ENOTSUP):
        return False
    raise OSError(number, os.strerror(number), str(b))


def _sweep(place: Path) -> None:
    """Remove what killed runs have left beside ``place``; a folder that a living run writes is locked and stays."""
    for left in place.parent.glob(f".{_escaped(place.name)}.*.tmp"):
        if not left.is_dir():
            continue
        try:
            descriptor = os.open(left, os.O_RDONLY)
        except OSError:
            continue
        try:
            if _lock(descriptor):
                shutil.rmtree(left, ignore_errors=True)
        finally:
            os.close(descriptor)


def _escaped(name: str) -> str:
    return "".join(f"[{c}]" if c in "*?[" else c for c in name)


def _lock(descriptor: int) -> bool:
    """Lock an open folder for this process; False where another holds it or nothing can be locked."""
    try:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (ImportError, OSError):
        return False
    return True


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
