"""What a command prints: for a person or for a program, on a terminal, into a log, a closed pipe or a full disk.

Results go to stdout, everything said on the way (notes, progress) to stderr. With ``--json`` stdout holds one JSON
object and nothing else; with ``--quiet`` nothing is said but errors.
"""

from __future__ import annotations

import argparse
import codecs
import contextlib
import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from hybrid_dynamics.types import Progress

#: What an ASCII terminal shows in place of signs it does not have.
_PLAIN = {
    "±": "+-",
    "→": "->",
    "−": "-",
    "–": "-",
    "·": "*",
    "²": "^2",
    "³": "^3",
    "×": "x",
    "≥": ">=",
    "≤": "<=",
    "…": "...",
}


class Console:
    """Where a command's words go; see the module's text."""

    def __init__(self, quiet: bool = False, as_json: bool = False) -> None:
        self.quiet, self.as_json = quiet, as_json

    @classmethod
    def of(cls, args: argparse.Namespace) -> Console:
        """As the options ``--quiet`` and ``--json`` ask for."""
        return cls(bool(getattr(args, "quiet", False)), bool(getattr(args, "json", False)))

    def say(self, line: str = "") -> None:
        """A line of the result, for a person."""
        if not self.quiet:
            _write(sys.stderr if self.as_json else sys.stdout, line)

    def note(self, line: str) -> None:
        """What a person should know, on stderr."""
        if not self.quiet:
            _write(sys.stderr, f"note: {line}")

    def result(self, value: dict[str, Any]) -> None:
        """The result for a program: one JSON object on stdout, with ``--json`` only."""
        if self.as_json:
            _write(sys.stdout, json.dumps(value, ensure_ascii=True, allow_nan=False), visible=False)

    def table(self, header: list[str], rows: list[list[str]]) -> None:
        """A table of plain text, first column to the left, numbers to the right."""
        shown = [[visible(cell) for cell in row] for row in [header, *rows]]
        widths = [max(len(row[k]) for row in shown) for k in range(len(header))]
        for row in shown:
            cells = [row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))]
            self.say(("  " + "  ".join(cells)).rstrip())

    @contextmanager
    def progress(self) -> Iterator[Progress]:
        """Yield ``progress(share, what)``: a bar on a terminal, a line a step elsewhere, nothing if quiet."""
        if self.quiet:
            yield lambda share, what: None
        elif _is_terminal(sys.stderr):
            yield from _bar()
        else:
            yield _lines()


def visible(text: str) -> str:
    """``text`` without what would move the cursor or change colours: names come out of files."""
    return "".join(c if c.isprintable() else "?" for c in text)


def _lines() -> Progress:
    said = ""

    def line(share: float, what: str) -> None:
        nonlocal said
        if what != said:
            said = what
            _write(sys.stderr, f"{share:4.0%} {what}")

    return line


def _bar() -> Iterator[Progress]:
    from rich.console import Console as RichConsole
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
    )
    with Bars(*columns, console=RichConsole(stderr=True), transient=True) as bar:
        task = bar.add_task("reading the logs", total=1.0)
        yield lambda share, what: bar.update(task, description=visible(what), completed=share)


def _is_terminal(stream: TextIO) -> bool:
    try:
        return stream.isatty() and os.environ.get("TERM") != "dumb"
    except ValueError:  # closed
        return False


def _write(stream: TextIO, line: str, visible: bool = True) -> None:
    """Print ``line``; where nobody listens any more (a closed pipe) the work goes on in silence."""
    text = "".join(c if c.isprintable() or c == "\n" else "?" for c in line) if visible else line
    try:
        print(text, file=stream, flush=True)
    except BrokenPipeError:
        _deafen(stream)


def _deafen(stream: TextIO) -> None:
    """Let what is still written to ``stream`` go nowhere."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def _plain_signs(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(_PLAIN.get(c, "?") for c in error.object[error.start : error.end]), error.end


@contextmanager
def safe_streams() -> Iterator[None]:
    """Let stdout and stderr take any text, and end in peace where the pipe behind them is closed."""
    codecs.register_error("plain_signs", _plain_signs)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, ValueError):
            stream.reconfigure(errors="plain_signs")  # type: ignore[union-attr]
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            try:
                stream.flush()
            except BrokenPipeError:
                _deafen(stream)
            except (OSError, ValueError):
                continue
