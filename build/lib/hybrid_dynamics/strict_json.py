"""JSON as it was meant: finite numbers, every key once, no surprises in depth. For files that people hand around."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

from hybrid_dynamics.errors import InputError

#: A document of ours is a few levels deep; a bomb is not read.
MAX_BYTES = 200_000_000


def read_json(path: str | os.PathLike[str], what: str) -> Any:
    """The value in the file ``path``; :class:`InputError` names the fault. ``what`` says which file was expected."""
    file = Path(path)
    if not file.exists():
        raise InputError(f"{file}: no such file; give {what}")
    if file.is_dir():
        raise InputError(f"{file}: is a folder; give {what}")
    if file.stat().st_size > MAX_BYTES:
        raise InputError(f"{file}: has {file.stat().st_size / 1e6:.0f} MB; give {what}")
    try:
        return parse_json(file.read_bytes().decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: not text in UTF-8 (byte {error.start + 1}); give {what}") from None
    except ValueError as error:
        raise InputError(f"{file}: not valid JSON ({error}); give {what}") from None


def parse_json(text: str) -> Any:
    """The value of ``text``; ``ValueError`` for what is no JSON, a number beyond all bounds, or a key twice."""
    try:
        return json.loads(
            text, parse_constant=_no_number, parse_float=_finite, parse_int=_whole, object_pairs_hook=_once
        )
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _no_number(name: str) -> float:
    raise ValueError(f"{name} is no number a file may hold")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{_short(text)} is beyond the range of numbers")
    return value


def _whole(text: str) -> int:
    # Python reads integers of any length; elsewhere they are numbers of double precision.
    _finite(text)
    return int(text)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out = dict(pairs)
    if len(out) != len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"key {_short(twice)!r} stands twice")
    return out


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:37]}..."
