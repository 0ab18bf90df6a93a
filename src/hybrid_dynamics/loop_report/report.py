"""``report.html`` of one loop: self-contained, opened without a server, the same bytes for the same result."""

from __future__ import annotations

from markupsafe import Markup

from hybrid_dynamics.loop.close import LoopResult
from hybrid_dynamics.loop_report.book import FigureBook
from hybrid_dynamics.loop_report.content import Content
from hybrid_dynamics.loop_report.details import LOOP_PAGE
from hybrid_dynamics.loop_report.gather import gather
from hybrid_dynamics.loop_report.html import Heading
from hybrid_dynamics.loop_report.page import render_page, render_section
from hybrid_dynamics.loop_report.sections import Answer
from hybrid_dynamics.loop_report.words import asked


def report_html(result: LoopResult) -> str:
    """The page of ``result`` as one string."""
    return content_html(gather(result))


def content_html(content: Content) -> str:
    """The page made from ``content``."""
    book = FigureBook()
    title = title_of(content)
    sections = [section for kind in LOOP_PAGE if (section := kind(content)).wanted]
    headings = [Heading(2, section.heading, section.anchor) for section in sections]
    parts = [Markup("<h1>{}</h1>\n").format(title)]
    for section in sections:
        parts.append(render_section(section, book, heading=not isinstance(section, Answer)))
    return render_page(title, parts, book, headings)


def title_of(content: Content) -> str:
    """What the page of one loop is called."""
    d = content.diagnosis
    return f"What has changed on {d['robot']}" if asked(d) else f"What the model of {d['robot']} lacks"
