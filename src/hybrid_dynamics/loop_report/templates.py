"""Bokeh's descriptions of the usual figures and its script, read from files: drawing them anew would load the library.

``templates.json`` is written by ``python -c "from hybrid_dynamics.loop_report.templates import keep; keep()"``: after a
change of a figure or of Bokeh's version; a test holds it to what the library makes. What it does not hold is drawn.
"""

from __future__ import annotations

import json
from functools import cache
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path
from typing import Any

from hybrid_dynamics.files import write_text
from hybrid_dynamics.loop_report.plots import drawn

#: Kinds that are kept: the torque, and laws over up to four runs.
KEPT = ("torque", "curve1", "curve2", "curve3", "curve4")
FILE = "templates.json"


def template(kind: str) -> dict[str, Any]:
    """Bokeh's JSON of a drawing of ``kind`` with blanks for its values."""
    kept = _kept()
    known = kind in kept and kept[kind]["version"] == distribution("bokeh").version
    return dict(kept[kind]) if known else drawn(kind)


def library() -> str:
    """Text of the script that draws."""
    return Path(str(distribution("bokeh").locate_file("bokeh/server/static/js/bokeh.min.js"))).read_text("utf-8")


@cache
def _kept() -> dict[str, Any]:
    return dict(json.loads(files("hybrid_dynamics.loop_report").joinpath(FILE).read_text("utf-8")))


def keep() -> None:
    """Write the file anew."""
    text = json.dumps({kind: drawn(kind) for kind in KEPT}, separators=(",", ":"))
    write_text(Path(__file__).with_name(FILE), text + "\n")
