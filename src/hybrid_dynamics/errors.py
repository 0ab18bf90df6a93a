"""Errors meant for the person at the keyboard: one line naming the thing, the value and the remedy.

Anything else that escapes is a bug and keeps its traceback.
"""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator


class HybridDynamicsError(Exception):
    """Base of all errors a user can cause and mend. Exit code 1 is left to bugs."""

    exit_code = 2


class InputError(HybridDynamicsError):
    """Unusable input: a file, a column, a robot."""


class ConfigError(HybridDynamicsError):
    """A parameter that is unknown, of the wrong type or out of range."""


class SourceError(HybridDynamicsError):
    """Recorded data that cannot be had or does not match its digest."""


class MissingDependencyError(HybridDynamicsError):
    """An optional package or program (Julia for PySR, say) that is not installed."""

    exit_code = 2


@contextlib.contextmanager
def needs_extra(extra: str, what: str) -> Iterator[None]:
    """Around the import of a package that only the optional ``extra`` brings: where it is missing, say how to get it.

    Raises :class:`MissingDependencyError`: ``what`` (a clause, such as "reading ROS bags") needs it.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            f"{what} needs the package {error.name}, which is not installed; "
            f"run in a clone of the project: pip install '.[{extra}]' (make venv there installs everything)"
        ) from None


#: The disk, not the program: full, over quota, too large a file, read-only, broken.
_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)


def one_line(error: BaseException) -> str:
    """The message of ``error`` in one line of printable characters: names come out of files."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(str(error).split()))


def run_main(main: Callable[[], int | None]) -> None:
    """Run ``main`` as a program: a user error becomes one line on stderr and its exit code; SIGTERM is like Ctrl-C."""
    _terminate_like_interrupt()
    try:
        code = main() or 0
    except HybridDynamicsError as error:
        code = _complain(one_line(error), error.exit_code)
    except BrokenPipeError:
        code = 0  # nobody reads what is printed any more (`| head`)
    except OSError as error:
        if error.errno in _DISK:
            where = f"{error.filename}: " if error.filename else ""
            reason = os.strerror(error.errno or 0)
            code = _complain(f"{where}{reason}; nothing was changed: make room and run again", InputError.exit_code)
        elif error.filename is None:
            raise
        else:
            code = _complain(
                one_line(OSError(f"{error.filename}: {error.strerror}; give another path, or mend this one")),
                InputError.exit_code,
            )
    except MemoryError:
        code = _complain("not enough memory; give shorter or fewer logs, or a larger machine", InputError.exit_code)
    except KeyboardInterrupt:
        code = _complain("interrupted", 130, "")
    sys.exit(code)


def _complain(line: str, code: int, prefix: str = "error: ") -> int:
    with contextlib.suppress(BrokenPipeError):
        print(f"{prefix}{line}", file=sys.stderr)
    return code


def _terminate_like_interrupt() -> None:
    """Let a polite request to end (SIGTERM) clean up as Ctrl-C does; only the main thread may ask for that."""

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTERM) == signal.SIG_DFL:
        signal.signal(signal.SIGTERM, interrupt)


def require(condition: bool, message: str) -> None:
    """Raise :class:`ConfigError` with ``message`` unless ``condition`` holds."""
    if not condition:
        raise ConfigError(message)
