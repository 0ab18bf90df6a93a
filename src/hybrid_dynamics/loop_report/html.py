"""Small pieces of HTML: tables, figures, folds. Knows nothing of the study.

Pages are self-contained: images are data URIs, nothing is requested from a network.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

from hybrid_dynamics.trajectory import RECORDED, SIMULATED_TWIN

__all__ = ["Cell", "Heading", "badge", "details", "escape", "figure", "key", "slug", "table"]


@dataclass(frozen=True)
class Cell:
    """A table cell: ready HTML and its CSS classes."""

    html: str
    kind: str = ""


@dataclass(frozen=True)
class Heading:
    """A chapter (``level`` 2) or section (3) of the page, for the table of contents."""

    level: int
    title: str
    anchor: str


def slug(text: str) -> str:
    """An anchor made of ``text``."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def key(kind: str, text: str) -> str:
    """What a bar of ``kind`` (before, after, floor) is, with a piece of it: for the head of a column of bars."""
    return f'<span class="key {kind}">{escape(text)}</span>'


def badge(provenance: str) -> str:
    """The provenance, impossible to overlook."""
    kind = {RECORDED: "recorded", SIMULATED_TWIN: "twin"}.get(provenance, "simulated")
    return f'<span class="badge {kind}">{escape(provenance)}</span>'


def table(
    heads: Sequence[str], rows: Iterable[Sequence[Cell | str]], caption: str = "", last: str = "", kind: str = ""
) -> str:
    """A table from ready HTML; ``last`` is the CSS class of the last row, ``kind`` that of the table.

    Plain strings are ready HTML too. A table wider than the window scrolls by itself, by keyboard too.
    """
    lines = []
    body = [[cell if isinstance(cell, Cell) else Cell(cell) for cell in row] for row in rows]
    for place, row in enumerate(body):
        own = _class(last if place == len(body) - 1 else "")
        cells = "".join(f"<td{_class(cell.kind)}>{cell.html}</td>" for cell in row)
        lines.append(f"<tr{own}>{cells}</tr>")
    kinds = [body[0][k].kind if body and k < len(body[0]) else "" for k in range(len(heads))]
    head = "".join(
        f"<th{_class(own if own in ('text', 'picture') else '')}>{name}</th>"
        for own, name in zip(kinds, heads, strict=True)
    )
    title = f"<caption><span>{caption}</span></caption>" if caption else ""
    return (
        f'<div class="scroll" tabindex="0"><table{_class(kind)}>{title}<thead><tr>{head}</tr></thead>'
        f"<tbody>\n{chr(10).join(lines)}\n</tbody></table></div>"
    )


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""


def figure(content: bytes, caption: str, alt: str, kind: str = "png", css: str = "") -> str:
    """An image with its caption (ready HTML), embedded."""
    mime = "image/svg+xml" if kind == "svg" else f"image/{kind}"
    data = base64.b64encode(content).decode("ascii")
    return (
        f'<figure{_class(css)}><div class="scroll" tabindex="0"><img alt={_quoted(alt)} '
        f"src='data:{mime};base64,{data}'></div><figcaption>{caption}</figcaption></figure>"
    )


def _quoted(text: str) -> str:
    return f'"{escape(text, quote=True)}"'


def details(summary: str, content: str) -> str:
    """Content that is folded away until it is asked for."""
    return f"<details><summary>{escape(summary)}</summary>\n{content}\n</details>"
