"""Sections to HTML: one environment, one page shell, for the loop's page and the study's."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from hybrid_dynamics.loop_report.book import FigureBook
from hybrid_dynamics.loop_report.html import Heading
from hybrid_dynamics.loop_report.sections import Section


@cache
def environment() -> Environment:
    """Templates of this package; everything is escaped, a name that is missing is an error."""
    return Environment(
        loader=PackageLoader("hybrid_dynamics.loop_report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def render_section(section: Section, book: FigureBook, level: int = 2, heading: bool = True) -> Markup:
    """``section`` under a heading of ``level`` with its anchor; its figures go into ``book``."""
    body = environment().get_template(section.template).render(section.values(book), level=level)
    top = Markup("<h{0}>{1}</h{0}>\n").format(level, section.heading) if heading else Markup("")
    return (
        Markup('<section id="{}" class="{}">\n').format(section.anchor, section.name)
        + top
        + Markup(body + "</section>\n")
    )


def render_page(
    title: str, body: Iterable[str], book: FigureBook, headings: Iterable[Heading] = (), kind: str = "loop"
) -> str:
    """The whole document: ``body`` is ready HTML; the contents stand where :data:`CONTENTS` is, first otherwise."""
    css = files("hybrid_dynamics.loop_report").joinpath("report.css").read_text("utf-8")
    return (
        environment()
        .get_template("page.html")
        .render(
            title=title,
            css=Markup(css),
            parts=[Markup(part) for part in body],
            contents=_tree(headings),
            script=book.script(),
            kind=kind,
        )
    )


def _tree(headings: Iterable[Heading]) -> list[tuple[Heading, list[Heading]]]:
    """Chapters (level 2) with their sections (level 3)."""
    tree: list[tuple[Heading, list[Heading]]] = []
    for heading in headings:
        if heading.level == 2 or not tree:
            tree.append((heading, []))
        else:
            tree[-1][1].append(heading)
    return tree
