"""The page's interactive figures, from its content: torque with its residual, laws over what explains them.

Colours are Okabe and Ito's, told apart by colour-blind readers; marks differ in shape or dash too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.loop_report.content import AXES, Curve, Trace

if TYPE_CHECKING:
    from bokeh.model import Model

Array = NDArray[np.float64]

BEFORE, AFTER, BAND = "#d55e00", "#0072b2", "#56b4e9"
RUN_COLOURS = ("#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c6d1f", "#999999")
RUN_MARKERS = ("circle", "square", "triangle", "diamond", "inverted_triangle", "hex")
#: Bins over which a law is drawn as a line with the span it covers.
BINS = 60
#: The band of noise in noise floors to either side: 19 of 20 samples where the noise is normal.
BAND_FLOORS = 2.0
CURVE_HEIGHT, TORQUE_HEIGHT, STRIP_HEIGHT = 300, 230, 120


def _figure(title: str, x: str, y: str, height: int, **options: Any) -> Any:
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
    made.title.text_font_size = "13px"
    return made


def _hover(made: Any, renderers: list[Any], tips: list[tuple[str, str]]) -> None:
    from bokeh.models import HoverTool

    made.add_tools(HoverTool(renderers=renderers, tooltips=tips))


def _legend(made: Any) -> None:
    """The legend below the plot, where it hides nothing; a click on a name hides its glyphs."""
    for legend in list(made.legend):
        made.center = [part for part in made.center if part is not legend]
        made.add_layout(legend, "below")
        legend.orientation, legend.ncols = "horizontal", "auto"
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


def curve_figure(curve: Curve, runs: tuple[str, ...], title: str) -> Model:
    """What is missing without the group (points, one colour and shape a run), its law (line), and the noise (band)."""
    from bokeh.models import ColumnDataSource

    made = _figure(title, AXES[curve.axis], "torque [N m]", CURVE_HEIGHT)
    x, mean, low, high = law_of(curve)
    noise = BAND_FLOORS * curve.noise
    band = ColumnDataSource({"x": _small(x), "low": _small(low - noise), "high": _small(high + noise)})
    made.varea("x", "low", "high", source=band, fill_color=BAND, fill_alpha=0.3, legend_label="law ± noise")
    owner = np.array(curve.run)
    points = []
    for k in np.unique(owner):
        mine = owner == k
        source = ColumnDataSource(
            {
                "x": _small(np.array(curve.x)[mine]),
                "missing": _small(np.array(curve.missing)[mine]),
                "added": _small(np.array(curve.added)[mine]),
            }
        )
        points.append(
            made.scatter(
                "x",
                "missing",
                source=source,
                size=4,
                marker=RUN_MARKERS[k % len(RUN_MARKERS)],
                color=RUN_COLOURS[k % len(RUN_COLOURS)],
                alpha=0.55,
                line_alpha=0.0,
                legend_label=f"run {runs[k]}",
                name=runs[k],
            )
        )
    made.line(_small(x), _small(mean), color=AFTER, line_width=2.5, legend_label="law that was added")
    _hover(
        made,
        points,
        [("run", "$name"), (AXES[curve.axis], "@x{0.000}"), ("missing [N m]", "@missing"), ("added [N m]", "@added")],
    )
    _legend(made)
    return made


def torque_figure(trace: Trace, noise: float) -> Model:
    """Measured torque and both models above; below, on the same time axis, what is left, with the band of noise."""
    from bokeh.layouts import column
    from bokeh.models import Band, ColumnDataSource

    time, measured = np.array(trace.time), np.array(trace.measured)
    left = measured - np.array(trace.after)
    source = ColumnDataSource(
        {
            "time": _small(time),
            "measured": _small(measured),
            "before": _small(np.array(trace.before)),
            "after": _small(np.array(trace.after)),
            "left": _small(left),
        }
    )
    upper = _figure(f"{trace.joint}, run {trace.run}", "", "torque [N m]", TORQUE_HEIGHT)
    upper.line(
        "time", "before", source=source, color=BEFORE, line_dash=[5, 3], line_width=1.2, legend_label="model before"
    )
    upper.line("time", "after", source=source, color=AFTER, line_width=3.0, alpha=0.75, legend_label="model after")
    shown = upper.line("time", "measured", source=source, line_width=1.0, legend_label="measured")
    shown.glyph.tags = ["ink"]
    _hover(
        upper,
        [shown],
        [("time [s]", "@time{0.00}"), ("measured [N m]", "@measured"), ("before", "@before"), ("after", "@after")],
    )
    upper.xaxis.visible = False
    _legend(upper)
    strip = _figure("", "time [s]", "left [N m]", STRIP_HEIGHT, x_range=upper.x_range)
    strip.title.visible = False
    strip.toolbar_location = None
    edges = ColumnDataSource(
        {"x": _small(time[[0, -1]]), "low": np.full(2, -BAND_FLOORS * noise), "high": np.full(2, BAND_FLOORS * noise)}
    )
    strip.add_layout(
        Band(base="x", lower="low", upper="high", source=edges, fill_color=BAND, fill_alpha=0.3, line_alpha=0.0)
    )
    strip.line("time", "left", source=source, color=AFTER, line_width=1.0)
    reach = max(float(np.quantile(np.abs(left), 0.995)), 2.5 * BAND_FLOORS * noise / 2) * 1.15 or 1.0
    strip.y_range.start, strip.y_range.end = -reach, reach
    return column(upper, strip, sizing_mode="stretch_width")


def _small(values: Array) -> NDArray[np.float32]:
    """Four bytes a number: finer than a screen, half the page."""
    return np.ascontiguousarray(values, dtype=np.float32)
