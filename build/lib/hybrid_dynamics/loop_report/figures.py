"""Figures of the loop's report: the residual against the variable that explains it, before and after, per joint."""

from __future__ import annotations

import io
from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hybrid_dynamics.effects import Effect, family
from hybrid_dynamics.loop.diagnosis import predict_run
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import Run

Array = NDArray[np.float64]

LABEL = {
    "q": "position [rad]",
    "dq": "speed [rad/s]",
    "ddq": "acceleration [rad/s²]",
    "time": "time [s]",
    "load": "rigid-body torque [N m]",
}
COLOURS = ("#b5482a", "#1f6f8b")
MAX_POINTS = 1200


def svg(figure: Figure) -> str:
    """The figure as inline SVG, the same bytes every time."""
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "hybrid-dynamics", "svg.fonttype": "path"}):
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})
    text = buffer.getvalue().decode("utf-8")
    return text[text.index("<svg") :]


def effect_figure(effect: Effect, before: Model, after: Model, runs: Sequence[Run]) -> str:
    """Residual on held-out runs before and after ``effect``, on its joint or on the three it changes most."""
    names = after.robot.joint_names
    residuals = [np.concatenate([run.tau - predict_run(model, run) for run in runs]) for model in (before, after)]
    change = np.sqrt(np.mean((residuals[0] - residuals[1]) ** 2, axis=0))
    known = family(effect.effect)
    single = effect.joints and known.scope == "joint"
    joints_drawn = [names.index(effect.joints[0])] if single else sorted(np.argsort(-change)[:3].tolist())
    kind = known.drawn_against
    figure = Figure(figsize=(3.6 * len(joints_drawn), 2.6), layout="constrained", dpi=110)
    for place, j in enumerate(joints_drawn):
        axes = figure.add_subplot(1, len(joints_drawn), place + 1)
        x = _run_time(runs) if kind == "time" else np.concatenate([_variable(after, run, kind)[:, j] for run in runs])
        thin = slice(None, None, max(len(x) // MAX_POINTS, 1))
        for values, colour, label in zip(residuals, COLOURS, ("before", "after"), strict=True):
            axes.plot(x[thin], values[thin, j], ".", color=colour, markersize=2, label=label, rasterized=True)
        axes.axhline(0, color="#888888", linewidth=0.6)
        axes.set_title(names[j], fontsize=9)
        axes.set_xlabel(LABEL[kind], fontsize=8)
        axes.set_ylabel("residual [N m]", fontsize=8)
        axes.tick_params(labelsize=7)
        if place == 0:
            axes.legend(fontsize=7, markerscale=4, frameon=False)
    return svg(figure)


def _variable(model: Model, run: Run, kind: str) -> Array:
    """State (K, n) of a run, or the rigid-body torque of ``model`` along it."""
    if kind == "load":
        return model.completed_robot.inverse_dynamics(run.q, run.dq, run.ddq)
    return np.asarray(getattr(run, kind))


def torque_figure(before: Model, after: Model, runs: Sequence[Run]) -> str:
    """Measured and predicted torque of the first held-out run, every joint."""
    run = runs[0]
    n = run.tau.shape[1]
    columns = 2
    rows = (n + 1) // columns
    figure = Figure(figsize=(10, 1.7 * rows), layout="constrained")
    hats = [predict_run(model, run) for model in (before, after)]
    thin = slice(None, None, max(len(run.time) // MAX_POINTS, 1))
    for j in range(n):
        axes = figure.add_subplot(rows, columns, j + 1)
        axes.plot(run.time[thin], run.tau[thin, j], color="#222222", linewidth=0.8, label="measured")
        for hat, colour, label in zip(hats, COLOURS, ("model before", "model after"), strict=True):
            axes.plot(run.time[thin], hat[thin, j], color=colour, linewidth=0.7, label=label)
        axes.set_title(after.robot.joint_names[j], fontsize=8)
        axes.set_ylabel("N m", fontsize=8)
        axes.tick_params(labelsize=7)
        if j == 0:
            axes.legend(fontsize=7, frameon=False, ncols=3)
    return svg(figure)


def _run_time(runs: Sequence[Run]) -> Array:
    """Time of all runs, one after the other."""
    start, parts = 0.0, []
    for run in runs:
        parts.append(run.time - run.time[0] + start)
        start = float(parts[-1][-1])
    return np.concatenate(parts)
