"""Tables of text: with or without a header, any delimiter, compressed or from standard input; cells stay text.

Text, because a cell that is no number is refused by its column and row, and because what a parser guesses (dates,
booleans, digits with underscores) is not for a log.
"""

from __future__ import annotations

import gzip
import io
import os
import sys
import zlib
from functools import cache
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pacsv

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.readers.description import DELIMITERS

STANDARD_INPUT = "-"


def read_bytes(file: str | os.PathLike[str]) -> bytes:
    """Content of ``file``; ``-`` is standard input, ``.gz`` is unpacked. Raises :class:`InputError`."""
    if str(file) == STANDARD_INPUT:
        return standard_input()
    path = Path(file)
    if not path.is_file():
        raise InputError(f"{path}: {'is a folder' if path.is_dir() else 'no such file'}; give the path of a log")
    content = path.read_bytes()
    return _unpacked(content, str(path)) if path.suffix.lower() == ".gz" else content


@cache
def standard_input() -> bytes:
    """What standard input holds, unpacked where it is packed; kept, because it can be read only once."""
    content = sys.stdin.buffer.read()
    return _unpacked(content, "standard input") if content[:2] == b"\x1f\x8b" else content


def _unpacked(content: bytes, name: str) -> bytes:
    try:
        return gzip.decompress(content)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{name}: not a readable gzip file ({error}); pack or copy it again") from None


def read_delimited(
    file: str | os.PathLike[str], delimiter: str = "auto", header: bool = True, skip_rows: int = 0
) -> tuple[pa.Table, int]:
    """A table of text columns (named ``1``, ``2``, ... without a header), and the line of its first row from 1.

    ``delimiter`` is a key of ``DELIMITERS``. Empty lines at the end are left out. Raises :class:`InputError` naming
    file and line for a row with another number of fields.
    """
    lines = read_bytes(file).decode("latin1").removeprefix("ï»¿").replace("\r\n", "\n").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    lines = lines[skip_rows:]
    if not lines:
        raise InputError(f"{file}: empty; expected a table of text")
    mark = DELIMITERS[delimiter] or _guess(lines[min(1, len(lines) - 1)])
    if mark == " ":
        lines, mark = [",".join(line.split()) for line in lines], ","
    if header:
        names = [name.strip().strip('"') for name in lines[0].split(mark)]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InputError(f"{file}: column {twice[0]!r} stands twice in the header; give every column its own name")
        rows, first = lines[1:], skip_rows + 2
    else:
        names, rows, first = [str(k + 1) for k in range(lines[0].count(mark) + 1)], lines, skip_rows + 1
    if not rows:
        raise InputError(f"{file}: no rows; expected samples below the header")
    for number, row in enumerate(rows, first):
        if row.count(mark) != len(names) - 1 and '"' not in row:
            cut = " (the last row: the file is truncated)" if number == first + len(rows) - 1 else ""
            raise InputError(
                f"{file}: row {number} has {row.count(mark) + 1 if row.strip() else 0} columns{cut}; "
                f"expected {len(names)} as in {'the header' if header else 'the first row'}"
            )
    text = "\n".join(rows).encode("latin1")
    try:
        table = pacsv.read_csv(
            io.BytesIO(text),
            read_options=pacsv.ReadOptions(column_names=names, encoding="latin1"),
            parse_options=pacsv.ParseOptions(delimiter=mark, ignore_empty_lines=False),
            convert_options=pacsv.ConvertOptions(column_types=dict.fromkeys(names, pa.string())),
        )
    except pa.ArrowException as error:
        raise InputError(f"{file}: not a readable table ({str(error).splitlines()[0]}); write it again") from None
    return table, first


def _guess(line: str) -> str:
    """The delimiter of a line: the first of tab, semicolon, comma that it holds, else white space."""
    return next((mark for mark in ("\t", ";", ",") if mark in line), " ")
