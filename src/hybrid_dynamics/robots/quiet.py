"""Libraries in C++ that write to the process' error stream: silenced while they run, because we say it in one line."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quiet_stderr() -> Iterator[None]:
    """Nothing that is written to file descriptor 2 inside appears. Not for several threads at once."""
    sys.stderr.flush()
    try:
        kept = os.dup(2)
    except OSError:  # the stream is closed: there is nothing to silence
        yield
        return
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
