"""Interactive figures of a page: collected while it is rendered, written once, with the library's script once.

The plots are Bokeh's: 1.3 MB of script, against 4.8 MB of plotly's, with zoom, pan and hover; it is inlined, so that
the page opens without a server or network. A figure is drawn when it comes into view.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

if TYPE_CHECKING:
    from bokeh.model import Model


@dataclass
class FigureBook:
    """Figures of one page, in order. ``data`` holds each as Bokeh's own JSON."""

    data: list[dict[str, Any]] = field(default_factory=list)

    def add(self, figure: Model, alt: str, height: int) -> Markup:
        """The place of ``figure`` in the page: what it shows in words, until (or where no) script draws it."""
        self.data.append(_plain(figure))
        number = len(self.data)
        return Markup(
            f'<div class="plot" id="plot-{number}" style="min-height:{height}px" role="img" '
            f'aria-label="{escape(alt, quote=True)}"></div>'
        )

    def script(self) -> Markup:
        """The library, the figures and what draws them; nothing where there is no figure."""
        if not self.data:
            return Markup("")
        from bokeh.resources import INLINE

        # "</script" would end the script element.
        library = str(INLINE.js_raw[0]).replace("</script", "<\\/script")
        data = json.dumps(self.data, separators=(",", ":")).replace("</", "<\\/")
        own = files("hybrid_dynamics.loop_report").joinpath("plots.js").read_text("utf-8")
        return Markup(
            f"<script>{library}</script>\n"
            f'<script type="application/json" id="plots">{data}</script>\n<script>\n{own}</script>\n'
        )


def _plain(figure: Model) -> dict[str, Any]:
    """Bokeh's JSON of ``figure`` with its ids counted from one, so that the same figure gives the same bytes."""
    from bokeh.document import Document

    document = Document()
    document.add_root(figure)
    value: dict[str, Any] = document.to_json(deferred=False)
    document.remove_root(figure)
    names: dict[str, str] = {}
    value = _renamed(value, names)
    return {"doc": value, "root_id": value["roots"][0]["id"], "version": value["version"]}


def _renamed(value: Any, names: dict[str, str]) -> Any:
    if isinstance(value, dict):
        return {
            key: names.setdefault(item, f"m{len(names) + 1}")
            if key == "id" and isinstance(item, str)
            else _renamed(item, names)
            for key, item in value.items()
        }
    if isinstance(value, list | tuple):
        return [_renamed(item, names) for item in value]
    return value
