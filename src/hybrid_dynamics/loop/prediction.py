"""What a model predicts along a whole log: every row, at the log's own time stamps, at the loop's bandwidth.

The loop itself leaves out the ends of a run, where a filter knows one side only; whoever asks for a prediction wants
them. There the motion is continued by the cubic that fits its last stretch, so that position, speed and acceleration go
on smoothly (mirroring the signal, as filters do by default, bends it: the torque is then off several times as much).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from hybrid_dynamics.effects import family
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.process import END_PERIODS, ProcessSettings, derivative, hann_kernel
from hybrid_dynamics.loop.speeds import own_speeds
from hybrid_dynamics.loop.uncertainty import Uncertainty
from hybrid_dynamics.readers.clock import truer_stamps
from hybrid_dynamics.readers.glitches import repair, told
from hybrid_dynamics.readers.repeats import as_sampled
from hybrid_dynamics.readers.resample import NO_STRETCH, ResampleSettings, resample, uniform_step
from hybrid_dynamics.trajectory import Trajectory
from hybrid_dynamics.types import Array, Notify

RIGID_BODY = "rigid_body"
#: Ends of a run, in periods of the cut-off: how much the cubic is fitted to, and how far it is continued. Of windows
#: from half a period to two, and orders two and three, the best over sampling rates and encoder resolutions.
_FITTED, _REACH, _ORDER = 1.5, 3.0, 3


#: A torque that varies by this share of its size, or less, is constant.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Prediction:
    """Torque [N m] at the log's stamps ``time`` (T,) [s]; rows in a gap too long to bridge are NaN.

    ``tau`` (T, n); ``measured`` (T, n) as recorded, without its glitches, and ``measured_smooth`` (T, n) through the
    filter that ``tau`` has passed, both None where the log has no torque; ``parts`` maps the rigid body and each effect
    to its share (T, n): they add up to ``tau``; ``band`` (T, n) is the standard deviation of
    ``measured_smooth - tau`` to be expected. ``inside`` (T,) rows further from an end, or from a gap, than its filters
    reach: there the loop's own errors are taken.
    """

    time: Array
    tau: Array
    measured: Array | None = None
    measured_smooth: Array | None = None
    parts: Mapping[str, Array] = field(default_factory=dict)
    band: Array | None = None
    inside: NDArray[np.bool_] | None = None

    @property
    def covered(self) -> NDArray[np.bool_]:
        """(T,) rows that have a prediction."""
        return ~np.isnan(self.tau[:, 0])

    def rmse(self, smooth: bool = True, ends: bool = True) -> Array:
        """(n,) [N m] root mean square error, of the filtered torque or of the torque as recorded; with the ``ends``,
        where filters know one side only, or without."""
        truth, rows = self._compared(smooth, ends)
        return np.asarray(np.sqrt(np.mean((truth - self.tau)[rows] ** 2, axis=0)))

    def relative_rmse(self, smooth: bool = True, ends: bool = True) -> Array:
        """(n,) the same over the standard deviation of the torque; NaN where that does not vary, but for rounding."""
        truth, rows = self._compared(smooth, ends)
        errors, spread = self.rmse(smooth, ends), truth[rows].std(axis=0)
        varies = spread > ROUNDING * np.abs(truth[rows]).max(axis=0, initial=0.0)
        return np.asarray(np.divide(errors, spread, out=np.full_like(errors, np.nan), where=varies))

    def relative_error(self, smooth: bool = True, ends: bool = True) -> float:
        """Norm of the error over the norm of the torque, all joints together; NaN where that is zero."""
        truth, rows = self._compared(smooth, ends)
        size = float(np.linalg.norm(truth[rows]))
        return float(np.linalg.norm((truth - self.tau)[rows])) / size if size > 0 else float("nan")

    def _compared(self, smooth: bool, ends: bool) -> tuple[Array, NDArray[np.bool_]]:
        truth = self.measured_smooth if smooth else self.measured
        if truth is None:
            raise InputError("the log has no torque to compare the prediction with")
        # Of a log that is all ends they are all there is.
        inside = self.covered if ends or self.inside is None else self.covered & self.inside
        return truth, inside if inside.any() else self.covered


def predict(
    model: Model,
    log: Trajectory,
    settings: ProcessSettings | None = None,
    *,
    parts: bool = False,
    uncertainty: Uncertainty | None = None,
    notify: Notify | None = None,
) -> Prediction:
    """The torque ``model`` predicts along ``log`` (``q``, ``dq`` where it has it; its torque is only compared with).

    ``log`` has its own stamps, even or not. Single samples that stand alone are left out (interpolated) and told, as
    the loop leaves them out: one of them would spread over a filter's window; so is a ``dq`` that is worse than the
    derivative of ``q`` (:mod:`.speeds`). ``settings``: by default the bandwidth
    that the model was found at (:attr:`.Model.cutoff`). Whether the log can be of this robot is not asked here but by
    :func:`hybrid_dynamics.check.checked_log`, as the command does first. With ``parts`` the share of each effect is
    told, in the order of the model; with ``uncertainty`` the band. Raises :class:`InputError` where the log does not
    fit the robot.

    >>> from hybrid_dynamics import Model, Robot, predict, read_log
    >>> robot = Robot.from_urdf("robot.urdf")
    >>> log = read_log("test_1.parquet", robot.joint_names)
    >>> predict(Model(robot), log).rmse().round(1)  # N m: what the URDF alone leaves
    array([3.3, 1.5])
    """
    if log.n_joints != model.robot.n_joints:
        raise InputError(
            f"log {log.name}: holds {log.n_joints} joints; robot {model.robot.name} has {model.robot.n_joints}"
        )
    once = as_sampled(log, notify)
    repaired, glitches = repair(log)
    # A glitch that a logger wrote twice stands alone once its rows do.
    clean = repaired if once is log else repair(once)[0]
    log = repaired
    for line in told(glitches, model.robot.joint_names, len(log.time)):
        if notify is not None:
            notify(f"{log.name}: {line}")
    pieces = resample(clean, None, notify)
    if not pieces:
        raise InputError(f"log {log.name}: {NO_STRETCH}")
    settings = settings or (ProcessSettings() if model.cutoff is None else ProcessSettings(cutoff=model.cutoff))
    pieces, speeds = own_speeds(pieces, settings)
    if speeds is not None and notify is not None:
        notify(f"{log.name}: {speeds.line(model.robot.joint_names)}")
    shape = log["q"].shape
    tau, smooth = np.full(shape, np.nan), np.full(shape, np.nan)
    shares = {name: np.full(shape, np.nan) for name in (_names(model) if parts else ())}
    band = None if uncertainty is None else np.full(shape, np.nan)
    measured = log.signals.get("tau")
    inside = np.zeros(len(log.time), bool)
    for piece, rows in zip(pieces, _rows_of(pieces, log.time), strict=True):
        reach = END_PERIODS / settings.cutoff_at(piece.dt)
        inside[rows] = (log.time[rows] > piece.time[0] + reach) & (log.time[rows] < piece.time[-1] - reach)
        states = whole_states(piece, settings)
        low_pass = _smoother(piece, settings)
        put = _back_to(piece.time, _instants(piece, log.rows(rows)))
        tau[rows] = put(low_pass(model.predict(*states, piece.time)))
        if "tau" in piece:
            smooth[rows] = put(low_pass(piece["tau"]))
        for name, share in contributions(model, *states, piece.time).items() if parts else ():
            shares[name][rows] = put(low_pass(share))
        if uncertainty is not None and band is not None:
            band[rows] = put(uncertainty.standard_deviation(model, *states, piece.time, low_pass))
        for line in model.extrapolation_warnings(states[1]):
            if notify is not None:
                notify(line)
    return Prediction(log.time, tau, measured, None if measured is None else smooth, shares, band, inside)


def contributions(model: Model, q: Array, dq: Array, ddq: Array, time: Array | None = None) -> dict[str, Array]:
    """What the rigid body and then each effect adds (T, n) [N m]; the sum is ``model.predict``.

    An effect's share is the change of the prediction when it joins those before it. One kind of effect is one share,
    on however many joints it acts, and however often it was identified there.
    """
    out: dict[str, Array] = {}
    before = np.zeros_like(np.asarray(q, float))
    for k, name in enumerate(_names(model)):
        after = Model(model.robot, model.effects[:k]).predict(q, dq, ddq, time)
        out[name] = out.get(name, 0.0) + after - before
        before = after
    return out


def _names(model: Model) -> list[str]:
    """``rigid_body``, then the name that every effect adds to."""
    # A joint effect acts on its joint alone, perhaps for the second time; a link changes others too and needs its name.
    return [
        RIGID_BODY,
        *(e.effect if family(e.effect).scope != "link" else f"{e.effect}({e.joints[0]})" for e in model.effects),
    ]


def whole_states(piece: Trajectory, settings: ProcessSettings) -> tuple[Array, Array, Array]:
    """``q dq ddq`` (T, n) of a uniformly sampled run at the loop's bandwidth, ends included."""
    dt = piece.dt
    cutoff = settings.cutoff_at(piece.dt)
    fitted, reach = (int(np.ceil(periods / cutoff / dt)) for periods in (_FITTED, _REACH))
    sections = butter(4, cutoff, fs=1.0 / dt, output="sos")

    def filtered(x: Array) -> Array:
        return np.asarray(sosfiltfilt(sections, _continued(x, fitted, reach), axis=0))

    inside = slice(reach, reach + len(piece.time))
    q = filtered(piece["q"])
    dq = filtered(piece["dq"]) if "dq" in piece else derivative(q, dt)
    return q[inside], dq[inside], derivative(dq, dt)[inside]


def _continued(x: Array, fitted: int, reach: int) -> Array:
    """``x`` (T, n) with ``reach`` rows more at both ends, from a fit to the ``fitted`` rows beside each end."""
    return np.concatenate([_before(x, fitted, reach), x, _before(x[::-1], fitted, reach)[::-1]])


def _before(x: Array, fitted: int, reach: int) -> Array:
    """``reach`` rows before ``x`` (T, n): a cubic, and near the end what it leaves, by point reflection."""
    rows = min(fitted, len(x) - 1)
    head = x[: rows + 1]
    # Time in windows, so that the powers stay comparable.
    inside, outside = np.arange(rows + 1) / rows, np.arange(-reach, 0) / rows
    order = min(_ORDER, rows // 3)
    basis = np.vander(inside, order + 1, increasing=True)
    coefficients = np.linalg.lstsq(basis, head, rcond=None)[0]
    left = head - basis @ coefficients
    out = np.vander(outside, order + 1, increasing=True) @ coefficients
    near = min(rows, reach)
    out[reach - near :] += 2 * left[0] - left[near:0:-1]
    out[: reach - near] += 2 * left[0] - left[near]
    return out


def _smoother(piece: Trajectory, settings: ProcessSettings) -> Callable[[Array], Array]:
    """The loop's FIR for torque on (T, ...) arrays; at the ends the part of the window that there is."""
    kernel = hann_kernel(1.0 / settings.cutoff_at(piece.dt), piece.dt)
    half = len(kernel) // 2
    if len(piece.time) <= 2 * half:
        return lambda x: np.asarray(x, float)
    weight = np.convolve(np.ones(len(piece.time)), kernel, mode="same")

    def smooth(x: Array) -> Array:
        flat = np.asarray(x, float).reshape(len(x), -1)
        out = np.column_stack([np.convolve(column, kernel, mode="same") / weight for column in flat.T])
        return out.reshape(np.shape(x))

    return smooth


def _rows_of(pieces: Sequence[Trajectory], time: Array) -> list[NDArray[np.intp]]:
    """Rows of stamps ``time`` (T,) that belong to each of ``pieces``: also those beside its ends, which its clock may
    have moved, as far as no other piece is nearer."""
    starts, ends = (np.array([piece.time[k] for piece in pieces]) for k in (0, -1))
    reach = 2.0 * np.array([piece.dt for piece in pieces])
    between = (ends[:-1] + starts[1:]) / 2
    low = np.maximum(starts - reach, np.append(-np.inf, between))
    high = np.minimum(ends + reach, np.append(between, np.inf))
    return [np.flatnonzero((time >= first) & (time <= last)) for first, last in zip(low, high, strict=True)]


def _instants(piece: Trajectory, log: Trajectory) -> Array:
    """When the samples of ``log`` were taken that ``piece`` was made of: (T,) [s], as its reader has it."""
    if len(piece.time) == len(log.time) and np.array_equal(piece["q"], log["q"]):
        return piece.time
    uneven = uniform_step(log.time, ResampleSettings()) is None
    return truer_stamps(log.time, log["q"]) if uneven else log.time


def _back_to(grid: Array, stamps: Array) -> Callable[[Array], Array]:
    """From values on the even ``grid`` to those at ``stamps``."""
    if len(grid) == len(stamps) and np.abs(grid - stamps).max() < 0.05 * float(np.median(np.diff(grid))):
        return lambda x: np.asarray(x)
    inside = np.clip(stamps, grid[0], grid[-1])

    def put(x: Any) -> Array:
        return np.asarray(CubicSpline(grid, x, axis=0)(inside))

    return put
