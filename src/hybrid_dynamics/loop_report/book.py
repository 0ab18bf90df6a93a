"""Interactive figures of a page: collected while it is rendered, written once, with the library's script once.

The plots are Bokeh's: 1.3 MB of script, against 4.8 MB of plotly's, with zoom, pan and hover; it is inlined, so that
the page opens without a server or network. A figure is drawn when it comes into view.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files

from markupsafe import Markup

from hybrid_dynamics.loop_report.bokeh_json import Drawing
from hybrid_dynamics.loop_report.templates import library, template


@dataclass
class FigureBook:
    """Figures of one page, in order."""

    drawings: list[Drawing] = field(default_factory=list)

    def add(self, drawing: Drawing, alt: str, height: int) -> Markup:
        """The place of ``drawing`` in the page: what it shows in words, until (or where no) script draws it."""
        self.drawings.append(drawing)
        number = len(self.drawings)
        return Markup(
            f'<div class="plot" id="plot-{number}" style="min-height:{height}px" role="img" '
            f'aria-label="{escape(alt, quote=True)}"></div>'
        )

    def script(self) -> Markup:
        """The library, the figures and what draws them; nothing where there is no figure."""
        if not self.drawings:
            return Markup("")
        # "</script" would end the script element.
        code = library().replace("</script", "<\\/script")
        kinds = list(dict.fromkeys(drawing.kind for drawing in self.drawings))
        value = {
            "templates": {kind: template(kind) for kind in kinds},
            "figures": [drawing.to_json() for drawing in self.drawings],
        }
        data = json.dumps(value, separators=(",", ":")).replace("</", "<\\/")
        own = files("hybrid_dynamics.loop_report").joinpath("plots.js").read_text("utf-8")
        return Markup(
            f"<script>{code}</script>\n"
            f'<script type="application/json" id="plots">{data}</script>\n<script>\n{own}</script>\n'
        )
