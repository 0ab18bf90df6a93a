"""Errors meant for the person at the keyboard: one line naming the thing, the value and the remedy.

Anything else that escapes is a bug and keeps its traceback.
"""

from __future__ import annotations

import sys
from collections.abc import Callable


class HybridDynamicsError(Exception):
    """Base of all errors a user can cause and mend."""

    exit_code = 1


class InputError(HybridDynamicsError):
    """Unusable input: a file, a column, a robot."""

    exit_code = 2


class ConfigError(HybridDynamicsError):
    """A parameter that is unknown, of the wrong type or out of range."""

    exit_code = 2


class SourceError(HybridDynamicsError):
    """Recorded data that cannot be had or does not match its digest."""


class MissingDependencyError(HybridDynamicsError):
    """An optional program (Julia for PySR, say) that is not installed."""


def run_main(main: Callable[[], int | None]) -> None:
    """Run ``main`` as a program: a user error becomes one line on stderr and its exit code."""
    try:
        code = main() or 0
    except HybridDynamicsError as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        code = error.exit_code
    except OSError as error:
        if error.filename is None:
            raise
        print(f"error: {error.filename}: {error.strerror}; give another path, or mend this one", file=sys.stderr)
        code = InputError.exit_code
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        code = 130
    sys.exit(code)


def require(condition: bool, message: str) -> None:
    """Raise :class:`ConfigError` with ``message`` unless ``condition`` holds."""
    if not condition:
        raise ConfigError(message)
