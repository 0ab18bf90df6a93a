"""The page's interactive figures, from its content: torque with its residual, laws over what explains them.

Each kind of figure is made once, with blanks; a drawing fills them, so that a page with a hundred figures holds their
numbers and not a hundred descriptions. Colours are Okabe and Ito's, told apart by colour-blind readers; marks differ in
shape or dash too.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from hybrid_dynamics.effects.units import on_a_slide
from hybrid_dynamics.loop_report.bokeh_json import Drawing, blank, plain
from hybrid_dynamics.loop_report.content import AXES, Curve, Trace
from hybrid_dynamics.loop_report.words import run_words
from hybrid_dynamics.types import Array

BEFORE, AFTER, BAND = "#d55e00", "#0072b2", "#56b4e9"
RUN_COLOURS = ("#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c6d1f", "#999999")
#: The same on the dark page, where the darker ones would drown.
RUN_COLOURS_DARK = ("#2fd6a3", "#e6a9ca", "#e69f00", "#56b4e9", "#cbaa52", "#bbbbbb")
RUN_MARKERS = ("circle", "square", "triangle", "diamond", "inverted_triangle", "hex")
#: Bins over which a law is drawn as a line with the span it covers.
BINS = 60
#: The band of noise in noise floors to either side: 19 of 20 samples where the noise is normal.
BAND_FLOORS = 2.0
#: More runs than this are drawn alike: a legend of ten names takes more room than the picture.
MOST_RUNS = 4
#: Share of the points that may lie beyond the picture at either side.
BEYOND = 0.01
CURVE_HEIGHT, TORQUE_HEIGHT, STRIP_HEIGHT = 300, 230, 120


def _figure(title: str, x: str, y: str, height: int, **options: Any) -> Any:
    from bokeh.models import PrintfTickFormatter
    from bokeh.models.annotations import Title
    from bokeh.plotting import figure

    made = figure(
        title=title,
        height=height,
        sizing_mode="stretch_width",
        tools="pan,box_zoom,wheel_zoom,reset,save",
        active_drag="box_zoom",
        active_scroll=None,
        toolbar_location="above",
        background_fill_alpha=0.0,
        border_fill_alpha=0.0,
        outline_line_alpha=0.0,
        min_border_left=58,
        min_border_right=6,
        **options,
    )
    made.toolbar.logo = None
    made.toolbar.autohide = True
    made.xaxis.axis_label, made.yaxis.axis_label = x, y
    for axis in (made.xaxis, made.yaxis):
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_text_font_size = "12px"
        # Four digits, and zero as 0: by itself a small axis reads 0.000e+0.
        axis.formatter = PrintfTickFormatter(format="%.4g")
    assert isinstance(made.title, Title)
    made.title.text_font_size = "13px"
    return made


def _blank_range() -> Any:
    """A range that the page sets: Bokeh takes no text for its ends."""
    from bokeh.models import Range1d

    return Range1d(start=0.0, end=1.0, tags=[blank("range")])


def _hover(made: Any, renderers: list[Any], tips: list[tuple[str, str]]) -> None:
    from bokeh.models import HoverTool

    made.add_tools(HoverTool(renderers=renderers, tooltips=tips))


def _legend(made: Any, columns: int = 3) -> None:
    """The legend below the plot, where it hides nothing; a click on a name hides its glyphs.

    Bokeh breaks no line of a legend by itself: ``columns`` names fit side by side on a telephone.
    """
    for legend in list(made.legend):
        made.center = [part for part in made.center if part is not legend]
        made.add_layout(legend, "below")
        legend.orientation, legend.ncols = "horizontal", columns
        legend.click_policy = "hide"
        legend.label_text_font_size = "11px"
        legend.spacing, legend.padding, legend.margin = 14, 4, 2
        legend.border_line_alpha = 0.0


def law_of(curve: Curve, bins: int = BINS) -> tuple[Array, Array, Array, Array]:
    """Bin centres, mean, least and largest of what the effects add [N m], over the curve's variable.

    Zero is an edge, so that a law that turns its sign there is not averaged across it.
    """
    x, added = np.array(curve.x), np.array(curve.added)
    low, high = float(x.min()), float(x.max())
    if low < 0 < high:
        width = (high - low) / bins
        below, above = max(round(-low / width), 1), max(round(high / width), 1)
        edges = np.concatenate([np.linspace(low, 0, below + 1), np.linspace(0, high, above + 1)[1:]])
    else:
        edges = np.linspace(low, max(high, low + 1e-12), bins + 1)
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    there = np.unique(place)
    parts = [(x[place == k], added[place == k]) for k in there]
    return (
        np.array([own.mean() for own, _ in parts]),
        np.array([values.mean() for _, values in parts]),
        np.array([values.min() for _, values in parts]),
        np.array([values.max() for _, values in parts]),
    )


def curve_figure(curve: Curve, runs: tuple[str, ...], title: str, slides: bool = False) -> Drawing:
    """What is missing without the group (points, one colour and shape a run), its law (line), and the noise (band).

    ``slides``: the joint is prismatic.
    """
    x, mean, low, high = law_of(curve)
    noise = BAND_FLOORS * curve.noise
    shown = _range(np.array(curve.missing), float((low - noise).min()), float((high + noise).max()))
    values: dict[str, Any] = {
        "range": shown,
        "title": ": ".join(filter(None, (title, _beyond(np.array(curve.missing), shown)))),
        "axis": _of_a_slide(AXES[curve.axis]) if slides else AXES[curve.axis],
        "effort": _effort(slides),
        "law_x": x,
        "law": mean,
        "low": low - noise,
        "high": high + noise,
    }
    owner, labels = np.array(curve.run), tuple(run_words(run) for run in runs)
    if len(runs) > MOST_RUNS:
        owner, labels, runs = np.zeros_like(owner), (f"{len(runs)} held-out runs",), ("any",)
    for k in range(len(runs)):
        mine = owner == k
        own = {"x": curve.x, "missing": curve.missing, "added": curve.added}
        values |= {f"{name}{k}": np.array(part)[mine] for name, part in own.items()}
        values |= {f"run{k}": runs[k], f"label{k}": labels[k]}
    return Drawing(f"curve{len(runs)}", values)


def _range(values: Array, low: float, high: float) -> tuple[float, float]:
    """Least and largest of the axis: ``low`` to ``high`` and all ``values``.

    Nearly all, where the rest (a knock, say) would take more than half of the picture and flatten what it is about.
    """
    ends = np.quantile(values, (0.0, BEYOND, 1 - BEYOND, 1.0))
    near = min(low, float(ends[1])), max(high, float(ends[2]))
    far = min(low, float(ends[0])), max(high, float(ends[3]))
    chosen = far if far[1] - far[0] <= 2 * (near[1] - near[0]) else near
    margin = 0.05 * max(chosen[1] - chosen[0], 1e-12)
    return chosen[0] - margin, chosen[1] + margin


def _beyond(values: Array, shown: tuple[float, float]) -> str:
    """How many of ``values`` lie outside the range ``shown``, in words; nothing where none does."""
    outside = int(np.sum((values < shown[0]) | (values > shown[1])))
    return f"{outside} of {len(values)} points lie beyond the picture" if outside else ""


@cache
def _curve_template(runs: int) -> dict[str, Any]:
    from bokeh.models import ColumnDataSource

    made = _figure(blank("title"), blank("axis"), blank("effort"), CURVE_HEIGHT, y_range=_blank_range())
    band = ColumnDataSource({"x": [blank("law_x")], "low": [blank("low")], "high": [blank("high")]})
    made.varea("x", "low", "high", source=band, fill_color=BAND, fill_alpha=0.3, legend_label="law ± noise")
    points = []
    for k in range(runs):
        source = ColumnDataSource({name: [blank(f"{name}{k}")] for name in ("x", "missing", "added")})
        own = k % len(RUN_COLOURS)
        drawn_points = made.scatter(
            "x",
            "missing",
            source=source,
            size=4,
            marker=RUN_MARKERS[k % len(RUN_MARKERS)],
            color=RUN_COLOURS[own],
            alpha=0.85,
            line_alpha=0.0,
            legend_label=blank(f"label{k}"),
            name=blank(f"run{k}"),
        )
        drawn_points.glyph.tags = ["run", RUN_COLOURS[own], RUN_COLOURS_DARK[own]]
        points.append(drawn_points)
    law = ColumnDataSource({"x": [blank("law_x")], "y": [blank("law")]})
    line = made.line("x", "y", source=law, color=AFTER, line_width=2.5, legend_label="law that was added")
    line.glyph.tags = ["after"]
    tips = [("run", "$name"), ("at", "@x{0.000}"), ("missing", "@missing"), ("added", "@added")]
    _hover(made, points, tips)
    _legend(made, 3 if runs == 1 else 2)
    return plain(made)


def _effort(slides: bool) -> str:
    return "force [N]" if slides else "torque [N m]"


def _of_a_slide(label: str) -> str:
    """``label`` of an axis at a prismatic joint."""
    return on_a_slide(label).replace("torque", "force")


def torque_figure(trace: Trace, noise: float, slides: bool = False) -> Drawing:
    """Measured torque and both models above; below, on the same time axis, what is left, with the band of noise."""
    time, measured = np.array(trace.time), np.array(trace.measured)
    left, band = measured - np.array(trace.after), BAND_FLOORS * noise
    return Drawing(
        "torque",
        {
            "title": f"{trace.joint}, {run_words(trace.run)}",
            "effort": _effort(slides),
            "rest": f"left [{'N' if slides else 'N m'}]",
            "time": time,
            "measured": measured,
            "before": np.array(trace.before),
            "after": np.array(trace.after),
            "left": left,
            "range": _range(left, -1.2 * band, 1.2 * band),
            "ends": time[[0, -1]],
            "low": np.full(2, -band),
            "high": np.full(2, band),
        },
    )


@cache
def _torque_template() -> dict[str, Any]:
    from bokeh.layouts import column
    from bokeh.models import ColumnDataSource

    names = ("time", "measured", "before", "after", "left")
    source = ColumnDataSource({name: [blank(name)] for name in names})
    upper = _figure(blank("title"), "", blank("effort"), TORQUE_HEIGHT)
    dashed = {"line_dash": [5, 3], "line_width": 1.2}
    upper.line("time", "before", source=source, color=BEFORE, legend_label="model before", **dashed)
    after = upper.line(
        "time", "after", source=source, color=AFTER, line_width=3.0, alpha=0.75, legend_label="model after"
    )
    after.glyph.tags = ["after"]
    shown = upper.line("time", "measured", source=source, line_width=1.0, legend_label="measured")
    shown.glyph.tags = ["ink"]
    tips = [("time [s]", "@time{0.00}"), ("measured", "@measured"), ("before", "@before"), ("after", "@after")]
    _hover(upper, [shown], tips)
    upper.xaxis.visible = False
    _legend(upper)
    strip = _figure("", "time [s]", blank("rest"), STRIP_HEIGHT, x_range=upper.x_range, y_range=_blank_range())
    strip.title.visible = False
    strip.toolbar_location = None
    edges = ColumnDataSource({"x": [blank("ends")], "low": [blank("low")], "high": [blank("high")]})
    strip.varea("x", "low", "high", source=edges, fill_color=BAND, fill_alpha=0.3)
    left = strip.line("time", "left", source=source, color=AFTER, line_width=1.0)
    left.glyph.tags = ["after"]
    return plain(column(upper, strip, sizing_mode="stretch_width"))


def drawn(kind: str) -> dict[str, Any]:
    """Bokeh's JSON of a drawing of ``kind`` with blanks for its values."""
    return _torque_template() if kind == "torque" else _curve_template(int(kind.removeprefix("curve")))
