"""Derivatives of a whole run, all columns of a row at the same instant and of the same bandwidth."""

from __future__ import annotations

from typing import Any

import numpy as np

from hybrid_dynamics.differentiate import butterworth
from hybrid_dynamics.differentiate.chain import derivatives
from hybrid_dynamics.differentiate.differences import central_difference
from hybrid_dynamics.differentiate.edges import transient_samples
from hybrid_dynamics.differentiate.registry import get_differentiator
from hybrid_dynamics.differentiate.settings import ZOH, DifferentiateSettings
from hybrid_dynamics.differentiate.spectrum import Spectrum, estimate_spectrum
from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array

#: Largest deviation of a time step from the mean step, as a share of it.
UNIFORM = 1e-3
#: Order of the motion's derivative whose error the cut-off minimises: torque needs the acceleration.
TARGET_DERIVATIVE = 2
MIN_ROWS = 16


def differentiate_trajectory(
    trajectory: Trajectory, settings: DifferentiateSettings
) -> tuple[Trajectory, dict[str, Any]]:
    """``q dq ddq dddq tau`` of ``trajectory`` and a report of what was chosen (JSON values).

    ``trajectory`` holds ``q tau`` and perhaps ``dq`` on a uniform grid. The report holds ``method``, ``dt`` [s],
    ``cutoff_hz``, per joint ``noise_std`` and ``bandwidth_hz`` of the signal that was differentiated (``source``: ``q``
    [rad] or ``dq`` [rad/s]), the method's ``parameter`` and, per derivative and joint, its ``parameters``, ``trim_s``
    and ``trim_rows`` at the start and end, ``torque_filter``.
    Raises :class:`InputError` for an uneven grid, a run that is too short, a missing velocity where it is needed.
    """
    steps = np.diff(trajectory.time)
    if len(steps) < MIN_ROWS:
        raise InputError(f"trajectory {trajectory.name}: {len(trajectory.time)} rows; expected more than {MIN_ROWS}")
    dt = float((trajectory.time[-1] - trajectory.time[0]) / len(steps))
    worst = int(np.argmax(np.abs(steps - dt)))
    if not dt > 0 or abs(steps[worst] - dt) > UNIFORM * dt:
        raise InputError(
            f"trajectory {trajectory.name}: time step {steps[worst]:g} s at row {worst + 1}, mean {dt:g} s; "
            "expected a uniform grid, resample the run first"
        )
    if settings.method == ZOH:
        return _zero_order_hold(trajectory, dt, settings)
    return _recorded(trajectory, dt, settings)


def _zero_order_hold(
    trajectory: Trajectory, dt: float, settings: DifferentiateSettings
) -> tuple[Trajectory, dict[str, Any]]:
    """Row k: torque held over [t_k, t_k + dt), the interval's mean state, ddq = (dq[k+1] - dq[k]) / dt.

    A row's time is the middle of its interval. Jerk is the central difference of ddq. T samples bound T - 1 intervals;
    the first and the last of these have no neighbour on one side and are dropped.
    """
    if "dq" not in trajectory:
        raise InputError(f"trajectory {trajectory.name}: method 'zoh' needs dq; choose another differentiate.method")
    q, dq = trajectory["q"], trajectory["dq"]
    ddq = np.diff(dq, axis=0) / dt
    out = Trajectory(
        trajectory.name,
        trajectory.split,
        (trajectory.time[:-1] + dt / 2)[1:-1],
        {
            "q": ((q[:-1] + q[1:]) / 2)[1:-1],
            "dq": ((dq[:-1] + dq[1:]) / 2)[1:-1],
            "ddq": ddq[1:-1],
            "dddq": (ddq[2:] - ddq[:-2]) / (2 * dt),
            "tau": trajectory["tau"][1:-2],
        },
    )
    extra = max(round(settings.trim_s / dt) - 1, 0) if settings.trim_s >= 0 else 0
    if 2 * extra >= len(out.time) - 1:
        raise InputError(
            f"trajectory {trajectory.name}: trimming {settings.trim_s} s at both ends leaves nothing of "
            f"{trajectory.time[-1] - trajectory.time[0]:.4g} s; set a smaller differentiate.trim_s"
        )
    out = out.rows(slice(extra, len(out.time) - extra))
    trim = [1 + extra, 2 + extra]
    report = {"method": ZOH, "dt": dt, "source": "dq", "trim_rows": trim, "trim_s": [dt * rows for rows in trim]}
    return out, {**report, "torque_filter": "none: torque is held over each interval"}


def choose_cutoff(spectra: list[Spectrum], dt: float, order: int, derivative: int) -> float:
    """Cut-off [Hz] that minimises the estimated error of the ``derivative``-th derivative, summed over the joints.

    Each joint's risk is divided by the variance of that derivative, so a joint that moves little counts as much. One
    cut-off serves all joints: torque of one joint depends on the motion of all.
    """
    top = 0.45 / dt
    cutoffs = np.geomspace(min(2 * spectra[0].frequency[1], top / 2), top, 120)
    total = np.zeros(len(cutoffs))
    for spectrum in spectra:
        scale = spectrum.signal_variance(derivative)
        if scale <= 0:
            continue
        for i, cutoff in enumerate(cutoffs):
            gain = butterworth.response(spectrum.frequency, cutoff, dt, order)
            total[i] += spectrum.risk(gain, derivative) / scale
    return float(cutoffs[np.argmin(total)])


def _recorded(trajectory: Trajectory, dt: float, settings: DifferentiateSettings) -> tuple[Trajectory, dict[str, Any]]:
    """Smooth and differentiate a recorded run; velocity is used where it is given."""
    source = "dq" if "dq" in trajectory else "q"
    order, cutoff = settings.order, settings.cutoff_hz
    if cutoff == 0:
        moving = [column for column in trajectory[source].T if np.ptp(column) > 0]
        if not moving:
            raise InputError(f"trajectory {trajectory.name}: no joint moves; give a run in motion, or set cutoff_hz")
        spectra = [estimate_spectrum(column, dt) for column in moving]
        cutoff = choose_cutoff(spectra, dt, order, TARGET_DERIVATIVE - (source == "dq"))
    tau = butterworth.lowpass(trajectory["tau"], dt, cutoff, order)
    signals, found = _motion(trajectory, dt, settings, source, cutoff)
    trim = max(found.pop("edge"), transient_samples(cutoff, dt))
    if settings.trim_s >= 0:
        trim = round(settings.trim_s / dt)
    rows = len(trajectory.time)
    if rows - 2 * trim < MIN_ROWS:
        raise InputError(
            f"trajectory {trajectory.name}: {rows} rows leave too few after {trim} are trimmed at each end; give a "
            "longer run, or set differentiate.trim_s or a higher differentiate.cutoff_hz"
        )
    whole = Trajectory(trajectory.name, trajectory.split, trajectory.time, {**signals, "tau": tau})
    report = {
        "method": settings.method,
        "dt": dt,
        "source": source,
        "cutoff_hz": cutoff,
        "order": order,
        **found,
        "trim_rows": [trim, trim],
        "trim_s": [trim * dt, trim * dt],
        "torque_filter": f"zero-phase Butterworth, order {order}, {cutoff:.3g} Hz",
    }
    return whole.rows(slice(trim, rows - trim)), report


def _motion(
    trajectory: Trajectory, dt: float, settings: DifferentiateSettings, source: str, cutoff: float
) -> tuple[dict[str, Array], dict[str, Any]]:
    """``q dq ddq dddq`` and what was chosen.

    ``butterworth`` sends every column through the low-pass of the torque, once (parallel filtering: what holds between
    torque and motion holds between the filtered ones, but for products of signals). Other methods choose their own
    smoothing per joint and derivative; the torque's low-pass then has the bandwidth best for the acceleration.
    """
    method = get_differentiator(settings.method)
    options = dict(settings.options)
    if method.name == butterworth.METHOD.name:
        for name in (method.parameter, "order"):
            if name in options:
                raise ConfigError(f"differentiate.options.{name}: set differentiate.{name} instead")
        options.update({method.parameter: cutoff, "order": settings.order})
        measured = trajectory[source]
        values = [butterworth.lowpass(measured, dt, cutoff, settings.order)]
        for _ in range(3 if source == "q" else 2):
            values.append(central_difference(values[-1], dt))
        spectra = [estimate_spectrum(column, dt) for column in measured.T]
        noise, bandwidth = [s.noise_std for s in spectra], [s.bandwidth for s in spectra]
        position = butterworth.lowpass(trajectory["q"], dt, cutoff, settings.order)
        parameters: list[Array] = []
    else:
        chain = derivatives(trajectory[source], dt, method, 3 if source == "q" else 2, **options)
        values, parameters = chain.values, chain.parameters
        noise, bandwidth = chain.noise_std.tolist(), chain.bandwidth.tolist()
        position = values[0]
        if source == "dq":
            own = {name: value for name, value in options.items() if name != method.parameter}
            position = derivatives(trajectory["q"], dt, method, 1, **own).values[0]
    names = ("q", "dq", "ddq", "dddq") if source == "q" else ("dq", "ddq", "dddq")
    edges = [method.edge(float(v), dt) for p in parameters for v in p]
    found = {
        "noise_std": noise,
        "bandwidth_hz": bandwidth,
        "parameter": method.parameter,
        "parameters": {n: p.tolist() for n, p in zip(names[1:], parameters, strict=False)},
        "edge": max(edges, default=0),
    }
    return {"q": position, **dict(zip(names, values, strict=True))}, found
