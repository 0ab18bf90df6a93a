"""Small pieces of HTML: tables, figures, the page around them. Knows nothing of the study.

The page is self-contained: inline style, images as data URIs, no script, no request to any network.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files

from hybrid_dynamics.trajectory import RECORDED, SIMULATED_TWIN

__all__ = ["Cell", "Heading", "badge", "details", "escape", "figure", "page", "slug", "table"]


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


def badge(provenance: str) -> str:
    """The provenance, impossible to overlook."""
    kind = {RECORDED: "recorded", SIMULATED_TWIN: "twin"}.get(provenance, "simulated")
    return f'<span class="badge {kind}">{escape(provenance)}</span>'


def table(heads: Sequence[str], rows: Iterable[Sequence[Cell | str]], caption: str = "", last: str = "") -> str:
    """A table from ready HTML; ``last`` is the CSS class of the last row. Plain strings are ready HTML too."""
    lines = []
    body = [[cell if isinstance(cell, Cell) else Cell(cell) for cell in row] for row in rows]
    for place, row in enumerate(body):
        kind = f' class="{last}"' if last and place == len(body) - 1 else ""
        cells = "".join(f"<td{_class(cell.kind)}>{cell.html}</td>" for cell in row)
        lines.append(f"<tr{kind}>{cells}</tr>")
    text = [body[0][k].kind == "text" if body and k < len(body[0]) else False for k in range(len(heads))]
    head = "".join(f"<th{_class('text' if text[k] else '')}>{name}</th>" for k, name in enumerate(heads))
    title = f"<caption>{caption}</caption>" if caption else ""
    return (
        f'<div class="scroll"><table>{title}<thead><tr>{head}</tr></thead>'
        f"<tbody>\n{chr(10).join(lines)}\n</tbody></table></div>"
    )


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""


def figure(content: bytes, caption: str, alt: str, kind: str = "png", css: str = "") -> str:
    """An image with its caption (ready HTML), embedded."""
    mime = "image/svg+xml" if kind == "svg" else f"image/{kind}"
    data = base64.b64encode(content).decode("ascii")
    return (
        f"<figure{_class(css)}><img alt={_quoted(alt)} src='data:{mime};base64,{data}'>"
        f"<figcaption>{caption}</figcaption></figure>"
    )


def _quoted(text: str) -> str:
    return f'"{escape(text, quote=True)}"'


def details(summary: str, content: str) -> str:
    """Content that is folded away until it is asked for."""
    return f"<details><summary>{escape(summary)}</summary>\n{content}\n</details>"


def page(title: str, body: str, headings: Sequence[Heading]) -> str:
    """The whole document around ``body`` (ready HTML that begins with the title and ends before the footer)."""
    css = files("hybrid_dynamics.loop_report").joinpath("report.css").read_text("utf-8")
    intro, _, rest = body.partition("<!-- contents -->")
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{css}</style>\n</head>\n<body>\n<main>\n"
        f"{intro}{_contents(headings)}{rest}\n</main>\n</body>\n</html>\n"
    )


def _contents(headings: Sequence[Heading]) -> str:
    items: list[str] = []
    for heading in headings:
        link = f'<a href="#{heading.anchor}">{escape(heading.title)}</a>'
        if heading.level == 2:
            items.append(f"</ul></li><li>{link}<ul>" if items else f"<li>{link}<ul>")
        else:
            items.append(f"<li>{link}</li>")
    return f"<nav><ul>{''.join(items)}</ul></li></ul></nav>" if items else ""
