"""Bokeh's own JSON of a figure, with blanks that a page fills from data.

A blank is the text ``@@name``: alone in a list it stands for a column of numbers, anywhere else for a text. A range of
an axis bears its blank as a tag.
"""

from __future__ import annotations

import base64
import gzip
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

MARK = "@@"


@dataclass(frozen=True)
class Drawing:
    """A figure of ``kind`` (a template) and what fills its blanks: texts, columns of numbers, and ranges of an axis."""

    kind: str
    values: Mapping[str, str | tuple[float, float] | NDArray[np.float64]]

    def to_json(self) -> dict[str, Any]:
        """Texts as they are; numbers as Bokeh takes them, four bytes each: finer than a screen, half the page."""
        return {
            "kind": self.kind,
            "values": {name: _column(own) if isinstance(own, np.ndarray) else own for name, own in self.values.items()},
        }


def blank(name: str) -> str:
    """The blank ``name``."""
    return MARK + name


def _column(values: NDArray[np.float64]) -> dict[str, Any]:
    packed = gzip.compress(np.ascontiguousarray(values, dtype="<f4").tobytes(), mtime=0)
    data = base64.b64encode(packed).decode("ascii")
    return {
        "type": "ndarray",
        "array": {"type": "bytes", "data": data},
        "shape": [len(values)],
        "dtype": "float32",
        "order": "little",
    }


def plain(figure: Any) -> dict[str, Any]:
    """Bokeh's JSON of ``figure`` with its ids counted from one, so that the same figure gives the same bytes."""
    from bokeh.document import Document

    document = Document()
    document.add_root(figure)
    value = _renamed(document.to_json(deferred=False), {})
    document.remove_root(figure)
    return {"doc": value, "root_id": value["roots"][0]["id"], "version": value["version"]}


def _renamed(value: Any, names: dict[str, str]) -> Any:
    if isinstance(value, dict):
        return {key: _name(item, names) if key == "id" else _renamed(item, names) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_renamed(item, names) for item in value]
    return value


def _name(identity: Any, names: dict[str, str]) -> Any:
    return names.setdefault(identity, f"m{len(names) + 1}") if isinstance(identity, str) else identity
