"""The study's figures. Same data, same bytes: no dates, no random ids; the Agg canvas, no display, no pyplot state.

Every function takes arrays or tables and returns a :class:`matplotlib.figure.Figure`; :func:`save` writes it.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from hybrid_dynamics.files import atomic_path
from hybrid_dynamics.study.methods import label
from hybrid_dynamics.trajectory import Trajectory

#: Any, since matplotlib types every key of it.
STYLE: Any = {
    "font.family": ["DejaVu Sans", "sans-serif"],
    "font.size": 8.5,
    "axes.titlesize": 9.5,
    "axes.labelsize": 8.5,
    "axes.grid": True,
    "grid.color": "#e3e6ea",
    "grid.linewidth": 0.6,
    "axes.edgecolor": "#8a929c",
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.facecolor": "white",
    "svg.hashsalt": "hybrid_dynamics",
    "svg.fonttype": "none",
    "path.simplify": True,
}
#: One colour a joint (Okabe and Ito's palette and neighbours: told apart by colour-blind readers).
JOINT_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#444444", "#8c6d1f")
METHOD_COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#8c6d1f", "#444444")
MEASURED = "#b9c2cc"
WIDTH = 10.0
DPI = 96
#: Of the images in the page: lines and text stay sharp; the files in reports/figures are lossless.
WEBP_QUALITY = 40


def _subplots(rows: int, columns: int, height: float, **options: Any) -> tuple[Figure, Any]:
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def colour(joint: int) -> str:
    """Colour of ``joint`` (from 0) in every figure that draws all joints into one axis."""
    return JOINT_COLOURS[joint % len(JOINT_COLOURS)]


def rollout(trajectory: Trajectory, title: str) -> Figure:
    """References (dashed where known), positions, velocities and torques of one run: the paper's Fig. 2."""
    with matplotlib.rc_context(STYLE):
        panels = [("q", "position q [rad]"), ("dq", "velocity dq [rad/s]"), ("tau", "torque τ [N m]")]
        panels = [(signal, name) for signal, name in panels if signal in trajectory]
        figure, axes = _subplots(len(panels), 1, 2.3 * len(panels) + 0.5, sharex=True)
        for axis, (signal, name) in zip(axes[:, 0], panels, strict=True):
            for joint in range(trajectory.n_joints):
                axis.plot(trajectory.time, trajectory[signal][:, joint], color=colour(joint), label=f"{joint + 1}")
                if f"{signal}_ref" in trajectory:
                    reference = trajectory[f"{signal}_ref"][:, joint]
                    axis.plot(trajectory.time, reference, color="black", linestyle=(0, (3, 3)), linewidth=0.7)
            axis.set_ylabel(name)
        axes[-1, 0].set_xlabel("time [s]")
        dashed = "  (dashed: reference)" if "q_ref" in trajectory else ""
        axes[0, 0].set_title(f"{title}{dashed}", loc="left")
        figure.align_ylabels()
        _legend(figure, axes[0, 0], "joint ")
        return figure


def derivatives(trajectory: Trajectory, title: str) -> Figure:
    """Positions and estimated velocity, acceleration and jerk of one run: the paper's Fig. 3."""
    with matplotlib.rc_context(STYLE):
        panels = [
            ("q", "position q [rad]"),
            ("dq", "velocity dq [rad/s]"),
            ("ddq", "acceleration ddq [rad/s²]"),
            ("dddq", "jerk dddq [rad/s³]"),
        ]
        panels = [(signal, name) for signal, name in panels if signal in trajectory]
        figure, axes = _subplots(len(panels), 1, 2.0 * len(panels) + 0.5, sharex=True)
        for axis, (signal, name) in zip(axes[:, 0], panels, strict=True):
            for joint in range(trajectory.n_joints):
                axis.plot(
                    trajectory.time, trajectory[signal][:, joint], color=colour(joint), label=f"{joint + 1}", lw=0.9
                )
            axis.set_ylabel(name)
            low, high = np.quantile(trajectory[signal], (0.001, 0.999))
            if _set_range(axis, np.array([low, high]), trajectory[signal], margin=0.15):
                axis.text(0.995, 0.97, "(extremes leave the axis)", transform=axis.transAxes, ha="right", va="top")
        axes[-1, 0].set_xlabel("time [s]")
        axes[0, 0].set_title(title, loc="left")
        figure.align_ylabels()
        _legend(figure, axes[0, 0], "joint ")
        return figure


def predictions(table: pd.DataFrame, split: str, methods: Sequence[str], title: str) -> Figure:
    """Measured and predicted torque per joint on the first run of ``split``: the paper's Fig. 4.

    The vertical range follows the measured torque (a prediction that leaves it is cut, and its panel says so).
    """
    rows, run, n = _run(table, split)
    with matplotlib.rc_context(STYLE):
        columns = 2
        figure, axes = _subplots(-(-n // columns), columns, 1.55 * -(-n // columns) + 0.6, sharex=True)
        measured = rows[rows["method"] == rows["method"].iloc[0]]
        for joint, axis in enumerate(axes.flat):
            if joint >= n:
                axis.set_axis_off()
                continue
            tau = measured[f"tau{joint + 1}"].to_numpy()
            axis.plot(measured["time"], tau, color=MEASURED, lw=3.0, label="measured")
            outside = []
            for place, method in enumerate(methods):
                own = rows[rows["method"] == method]
                axis.plot(
                    own["time"],
                    own[f"tau_hat{joint + 1}"],
                    color=METHOD_COLOURS[place % len(METHOD_COLOURS)],
                    lw=0.9,
                    label=label(method),
                )
                outside.append(_set_range(axis, tau, own[f"tau_hat{joint + 1}"].to_numpy()))
            note = "  (prediction leaves the axis)" if any(outside) else ""
            axis.set_title(f"joint {joint + 1}{note}", loc="left", pad=2)
            axis.set_ylabel("τ [N m]")
        _time_axes(axes, n)
        figure.suptitle(f"{title}: {split} run {run}", x=0.01, ha="left", fontsize=9.5)
        _legend(figure, axes[0, 0], "")
        return figure


def residuals(table: pd.DataFrame, split: str, method: str, title: str) -> Figure:
    """What the rigid body misses per joint (measured - rigid body), and what is left after ``method``."""
    rows, run, n = _run(table, split)
    rigid = rows[rows["method"] == "rigid_body"]
    best = rows[rows["method"] == method]
    with matplotlib.rc_context(STYLE):
        columns = 2
        figure, axes = _subplots(-(-n // columns), columns, 1.55 * -(-n // columns) + 0.6, sharex=True)
        for joint, axis in enumerate(axes.flat):
            if joint >= n:
                axis.set_axis_off()
                continue
            tau, hat = f"tau{joint + 1}", f"tau_hat{joint + 1}"
            before = (rigid[tau] - rigid[hat]).to_numpy()
            axis.plot(rigid["time"], before, color="#9aa3ad", lw=1.2, label="measured − rigid body")
            after = (best[tau] - best[hat]).to_numpy()
            axis.plot(best["time"], after, color="#d55e00", lw=0.9, label=f"measured − {label(method)}")
            _set_range(axis, before, after)
            axis.set_title(f"joint {joint + 1}", loc="left", pad=2)
            axis.set_ylabel("residual [N m]")
        _time_axes(axes, n)
        figure.suptitle(f"{title}: {split} run {run}", x=0.01, ha="left", fontsize=9.5)
        _legend(figure, axes[0, 0], "")
        return figure


def fronts(table: pd.DataFrame, methods: Sequence[str], title: str) -> Figure:
    """Pareto fronts of symbolic regression per joint: first round (line) and the whole re-fitted expression (star)."""
    joints = sorted(table["joint"].unique())
    with matplotlib.rc_context(STYLE):
        columns = 4 if len(joints) > 3 else len(joints)
        figure, axes = _subplots(-(-len(joints) // columns), columns, 2.1 * -(-len(joints) // columns) + 0.5)
        for place, axis in enumerate(axes.flat):
            if place >= len(joints):
                axis.set_axis_off()
                continue
            for k, method in enumerate(methods):
                own = table[(table["joint"] == joints[place]) & (table["method"] == method)]
                first, final = _front_parts(own)
                shade = METHOD_COLOURS[k % len(METHOD_COLOURS)]
                style = {"marker": "o", "markersize": 2.8, "drawstyle": "steps-post"}
                axis.plot(first["complexity"], first["loss"], color=shade, label=label(method), **style)
                axis.plot(final["complexity"], final["loss"], "*", color=shade, markersize=9, markeredgecolor="white")
            axis.set_yscale("log")
            axis.set_title(f"joint {joints[place]}", loc="left", pad=2)
            if place % columns == 0:
                axis.set_ylabel("mean square error [N² m²]")
            if place + columns >= len(joints):
                axis.set_xlabel("complexity [nodes]")
        figure.suptitle(title, x=0.01, ha="left", fontsize=9.5)
        _legend(figure, axes[0, 0], "")
        return figure


def _front_parts(front: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Candidates of the first round, and the selected re-fitted expression (empty where the front names none)."""
    front = front.assign(loss=front["loss"].clip(lower=1e-16)).sort_values("complexity")
    kind = front["kind"] if "kind" in front else pd.Series("search", index=front.index)
    search = front[kind == "search"]
    refit = front[kind == "refit"]
    return search[search["round"] == search["round"].min()], refit[refit["round"] == refit["round"].max()]


def error_bars(table: pd.DataFrame, title: str) -> Figure:
    """Relative RMSE per joint (x) and method (marker) on a logarithmic scale; ``table`` is joints by methods."""
    with matplotlib.rc_context(STYLE):
        figure, axes = _subplots(1, 1, 3.0)
        axis = axes[0, 0]
        markers = "osD^vP*Xhpd<>"
        colours = (*JOINT_COLOURS, "#7a3fb0", "#b03f5d", "#3fb0a5", "#5d6b1f", "#1f3b6b")
        for k, method in enumerate(table.columns):
            offset = (k - (len(table.columns) - 1) / 2) * 0.055
            axis.plot(
                np.asarray(table.index, float) + offset,
                table[method],
                marker=markers[k % len(markers)],
                linestyle="none",
                markersize=5,
                color=colours[k % len(colours)],
                # After as many methods the marks come again: hollow.
                fillstyle="full" if k < len(markers) else "none",
                label=label(str(method)),
            )
        axis.axhline(1.0, color="#8a929c", lw=0.8, ls="--")
        axis.set_yscale("log")
        axis.set_xticks(list(table.index))
        axis.set_xlabel("joint")
        axis.set_ylabel("relative RMSE [–]")
        axis.set_title(f"{title}  (dashed: as bad as predicting the mean)", loc="left")
        handles, names = axis.get_legend_handles_labels()
        figure.legend(handles, names, loc="outside right center")
        return figure


def _run(table: pd.DataFrame, split: str) -> tuple[pd.DataFrame, str, int]:
    rows = table[table["split"] == split]
    run = str(rows["trajectory"].iloc[0])
    n = sum(column.startswith("tau_hat") for column in table.columns)
    return rows[rows["trajectory"] == run], run, n


def _set_range(axis: Axes, inside: np.ndarray, other: np.ndarray, margin: float = 0.35) -> bool:
    """Fit the axis to ``inside`` with a margin (share of the range); True where ``other`` leaves it."""
    low, high = float(np.min(inside)), float(np.max(inside))
    margin *= max(high - low, 1e-6)
    axis.set_ylim(low - margin, high + margin)
    return bool(np.min(other) < low - margin or np.max(other) > high + margin)


def _time_axes(axes: Any, n: int) -> None:
    """Name the time axis under the lowest panel of each column that is drawn."""
    columns = axes.shape[1]
    for joint, axis in enumerate(axes.flat):
        if joint < n <= joint + columns:
            axis.set_xlabel("time [s]")
            axis.tick_params(labelbottom=True)


def _legend(figure: Figure, axis: Axes, title: str) -> None:
    handles, names = axis.get_legend_handles_labels()
    names = [f"{title}{name}" for name in names]
    figure.legend(handles, names, loc="outside upper right", ncols=min(len(names), 8))


def to_bytes(figure: Figure, kind: str = "png") -> bytes:
    """The figure as ``png`` or ``svg`` bytes, free of dates and versions."""
    buffer = io.BytesIO()
    metadata: dict[str, Any] = {"Software": None} if kind == "png" else {"Date": None, "Creator": None}
    with matplotlib.rc_context(STYLE):
        figure.savefig(buffer, format=kind, dpi=DPI, metadata=metadata)
    return buffer.getvalue()


def save(figure: Figure, path: Path) -> bytes:
    """Write the figure atomically (format by suffix) and return it as a page embeds it: WebP, a quarter of a PNG."""
    kind = path.suffix.lstrip(".")
    content = to_bytes(figure, kind)
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
    if kind != "png":
        figure.set_layout_engine("none")  # it has its places; finding them takes as long as drawing
        content = to_bytes(figure)
    return webp(content)


def webp(png: bytes) -> bytes:
    """A PNG as WebP."""
    buffer = io.BytesIO()
    Image.open(io.BytesIO(png)).convert("RGB").save(buffer, "WEBP", quality=WEBP_QUALITY, method=4)
    return buffer.getvalue()
